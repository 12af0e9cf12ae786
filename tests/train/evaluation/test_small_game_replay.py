"""Episodes of small games on pages: values and best responses by recursion over the rules."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import numpy as np
import pytest
from drawn_games import HOSTILE, MOVES, Corridor, Hostile, Three

from pursuit.replays.viewer.data import Builder
from scripted_agents.games.agents import TableAgent, uniform_table
from scripted_agents.games.enumeration import enumerate_game
from scripted_agents.games.simulator import GameTask
from train.evaluation.small_game_contest import SmallGameContest
from train.evaluation.small_game_replay import add_small_game

Shares = dict[str, dict[Any, dict[Any, float]]]


def described(task: GameTask, discount: float, seed: int = 0) -> tuple[Any, Builder, Shares]:
    """The page of random policies, and the policies by player, state and action."""
    rng, policies, shares = np.random.default_rng(seed), {}, Shares()
    for seat, name in enumerate(task.game.players):
        rows = {}
        for state, actions in zip(task.game.states, task.game.actions[seat], strict=True):
            rows[state] = dict(zip(actions, rng.dirichlet(np.ones(len(actions))), strict=True))
        shares[name] = rows
        policies[name] = TableAgent(task, name, rows.__getitem__)
    builder = Builder()
    games = {f"game {number}": number for number in range(6)}
    labels = dict.fromkeys(task.game.players, "random")
    add_small_game(builder, task, policies, games, discount, labels)
    return builder.worlds[0], builder, shares


def recursion(
    game: Any, shares: Shares, discount: float, left: int, responder: int | None = None
) -> Any:
    """By state and joint action the expected returns within the steps left; the responder, if
    there is one, plays what is best for it."""
    memory: dict[Any, Any] = {}

    def value(state: Any, left: int) -> np.ndarray:
        if left == 0:
            return np.zeros(len(game.players))
        if (state, left) not in memory:
            by_action: dict[Any, Any] = {}
            every = [game.legal_actions(state, seat) for seat in range(len(game.players))]
            for joint in product(*every):
                chance = 1.0
                for seat, name in enumerate(game.players):
                    chance *= 1.0 if seat == responder else shares[name][state][joint[seat]]
                own = None if responder is None else joint[responder]
                by_action.setdefault(own, 0.0)
                by_action[own] = by_action[own] + chance * action_value(state, joint, left)
            best = (
                by_action[None]
                if responder is None
                else max(by_action.values(), key=lambda found: found[responder])
            )
            memory[state, left] = best, by_action
        return memory[state, left][0]

    def action_value(state: Any, joint: Any, left: int) -> np.ndarray:
        found = np.zeros(len(game.players))
        for chance, after, rewards, over in game.transitions(state, joint):
            later = 0.0 if over else discount * value(after, left - 1)
            found = found + chance * (np.array(rewards) + later)
        return found

    value_of: Any = value
    value_of.memory = memory
    return value_of


@pytest.mark.parametrize(("source", "steps"), [(Corridor(), 7), (Three(), 9)], ids=["two", "three"])
def test_values_and_best_responses_are_those_of_the_rules(source: Any, steps: int) -> None:
    task = GameTask(enumerate_game(source), "any", steps)
    world, builder, shares = described(task, 1.0)
    value, by_text = recursion(source, shares, 1.0, steps), {str(s): s for s in task.game.states}
    for item in builder.items:
        for step in range(item["length"]):
            state = by_text[world["states"][item["states"][step]]["text"]]
            assert item["values"][step] == pytest.approx(value(state, steps - step), abs=1e-5)
        assert item["values"][-1] == [0.0] * len(source.players)
        assert item["terminated"] != item["truncated"]
        assert not item["truncated"] or item["length"] == steps
    for seat, name in enumerate(source.players):
        respond = recursion(source, shares, 1.0, steps, seat)
        for entry in (each for each in world["states"] if each["choices"]):
            state, choice = by_text[entry["text"]], entry["choices"][seat]
            respond(state, steps)
            best, by_action = respond.memory[state, steps]
            legal = [str(action) for action in source.legal_actions(state, seat)]
            assert choice["actions"] == legal
            played = [shares[name][state][a] for a in source.legal_actions(state, seat)]
            assert choice["played"] == pytest.approx(played, abs=1e-5)
            chosen = source.legal_actions(state, seat)[choice["best"].index(1.0)]
            assert sum(choice["best"]) == 1.0
            assert by_action[chosen][seat] == pytest.approx(best[seat], abs=1e-9)


def test_with_a_discount_values_are_those_of_endless_games() -> None:
    source = Three()
    task = GameTask(enumerate_game(source), "three", 3)
    world, builder, shares = described(task, 0.5)
    value = recursion(source, shares, 0.5, 40)
    for item in builder.items:
        for number, found in zip(item["states"][:-1], item["values"], strict=False):
            state = int(world["states"][number]["text"])
            assert found == pytest.approx(value(state, 40), abs=1e-5)
        if item["truncated"]:  # such a game goes on, so its last state has a value
            state = int(world["states"][item["states"][-1]]["text"])
            assert item["values"][-1] == pytest.approx(value(state, 40), abs=1e-5)
    assert {item["truncated"] for item in builder.items} == {True, False}


@pytest.mark.parametrize("source", [Corridor(), Three()], ids=["two", "three"])
def test_episodes_follow_the_rules(source: Any) -> None:
    task = GameTask(enumerate_game(source), "any", 12)
    world, builder, _ = described(task, 1.0)
    by_text = {str(state): state for state in task.game.states}
    for item in builder.items:
        texts = [world["states"][number]["text"] for number in item["states"]]
        states = [by_text.get(text, text) for text in texts]
        assert states[0] in {state for _, state in source.starts()}
        assert len(states) == item["length"] + 1 == len(item["actions"]) + 1
        for step, named in enumerate(item["actions"]):
            state = states[step]
            joint = tuple(
                {str(a): a for a in source.legal_actions(state, seat)}[name]
                for seat, name in enumerate(named)
            )
            outcomes = source.transitions(state, joint)
            rewards = sum(chance * np.array(gained) for chance, _, gained, _ in outcomes)
            assert [row[step] for row in item["rewards"]] == pytest.approx(rewards, abs=1e-5)
            last = item["terminated"] and step == item["length"] - 1
            assert any(over if last else states[step + 1] == s for _, s, _, over in outcomes)


def test_drawings_are_text_or_svg_and_without_draw_the_text_of_the_state() -> None:
    beginnings = {"text": "<G...T>\n=======", "svg": "<svg viewBox=", "none": "(0, 4)"}
    for form, beginning in beginnings.items():
        task = GameTask(enumerate_game(Corridor(form)), form, 5)
        world, _, _ = described(task, 1.0)
        entry = next(each for each in world["states"] if each["text"] == "(0, 4)")
        assert entry["drawing"].startswith(beginning)


def test_the_end_of_a_game_is_shown_where_it_is_known() -> None:
    task = GameTask(enumerate_game(Corridor()), "corridor", 100)
    world, builder, _ = described(task, 1.0)
    for item in builder.items:
        before, end = (world["states"][number] for number in item["states"][-2:])
        guard, thief = eval(before["text"])  # a pair of whole numbers
        guard, thief = (
            at + MOVES[action]
            for at, action in zip((guard, thief), item["actions"][-1], strict=True)
        )
        assert item["terminated"] and item["shows_end"] and end["text"] == str((guard, thief))
        assert end["drawing"] == Corridor().text((guard, thief))
    _, builder, _ = described(GameTask(enumerate_game(Three()), "three", 100), 0.9)
    for item in builder.items:  # of chance, and without a state after the end
        assert item["terminated"] and "shows_end" not in item
        assert item["states"][-1] == item["states"][-2]


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("raises", r"raised KeyError \(drawn_games.py:\d+\)"),
        ("number", "returned a value of type int, not a text"),
        ("broken", "returned SVG that is not well-formed"),
    ],
)
def test_what_cannot_be_drawn_is_shown_as_text_with_one_warning(form: str, message: str) -> None:
    with pytest.warns(UserWarning) as noted:
        world, _, _ = described(GameTask(enumerate_game(Corridor(form)), form, 5), 1.0)
    (text,) = {str(each.message) for each in noted}
    expected = rf"draw\(state\) of Corridor {message}; such states are shown as text"
    assert re.fullmatch(expected, text)
    assert all(state["drawing"] == state["text"] for state in world["states"])
    assert len(world["states"]) > 3


def test_texts_that_no_file_can_have_are_shown_with_other_characters() -> None:
    game: Any = Corridor()
    game.draw = lambda state: f"\ud800 {state}"
    world, _, _ = described(GameTask(enumerate_game(game), "corridor", 5), 1.0)
    assert {state["drawing"] for state in world["states"]} >= {"? (0, 4)", "? (1, 4)"}


def test_animations_show_the_text_of_states() -> None:
    task = GameTask(enumerate_game(Corridor()), "corridor", 5)
    uniform = {n: TableAgent(task, n, uniform_table(task.game, n)) for n in task.game.players}
    contest = SmallGameContest(task, "guard", {"thief": uniform["thief"]})
    scenes = contest.scenes(uniform["guard"], 2)
    texts = [scene.text() for scene in scenes]
    assert texts[0].startswith(("<G...T>\n", "<.G..T>\n")) and "step 0 / 5" in texts[0]
    pictures = [scene.draw() for scene in scenes]
    assert len({picture.shape for picture in pictures}) == 1
    assert len({picture.tobytes() for picture in pictures}) > len(set(texts)) / 2 > 2


def test_hostile_texts_reach_the_page_as_data_only() -> None:
    task = GameTask(enumerate_game(Hostile()), HOSTILE, 3)
    world, builder, _ = described(task, 0.9)
    assert world["states"][0]["drawing"] == f"{HOSTILE}<svg>"
    assert HOSTILE in builder.items[0]["actions"][0] + builder.items[1]["actions"][0]
