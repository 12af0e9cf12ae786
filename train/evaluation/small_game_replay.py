"""Episodes of small games for the viewer."""

from __future__ import annotations

from collections.abc import Mapping
from operator import getitem

import numpy as np

from pursuit.replays.viewer.data import Builder
from pursuit.validation import text_of
from scripted_agents.games.episodes import values_along
from scripted_agents.games.game import Action, Game
from scripted_agents.games.rendering import drawn_state
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from scripted_agents.games.solve import respond
from train.files import Plain
from train.settings.checks import EVALUATION_SEED


def add_small_game(
    builder: Builder,
    task: GameTask,
    policies: Mapping[str, StatePolicy],
    games: Mapping[str, int],
    discount: float,
    labels: Mapping[str, str],
) -> None:
    """Play episodes of a small game and add them to a page.

    They have the exact values of their states, and the probabilities of actions by the policies and
    by the best response of each player to the others; within `max_steps` if there is no discount.

    Args:
        builder: of the page.
        task: the game.
        policies: by player.
        games: the numbers of the episodes, which are those of evaluations, by label.
        discount: of values and best responses.
        labels: the names of the policies by player.

    Raises:
        ValueError: the game's `draw` failed.
    """
    game, horizon = task.game, task.max_steps if discount == 1.0 else None
    played, best = {name: own.table(task) for name, own in policies.items()}, {}
    for name in game.players:
        others = {other: table for other, table in played.items() if other != name}
        best[name] = respond(game, name, others, discount, horizon).policies[name]
    items = [_played(task, policies, number) for number in games.values()]
    visits = [item["states"] for item in items]
    along = values_along(game, played, visits, discount, horizon)
    offsets = [game.offsets(seat) for seat in range(len(game.players))]

    def described(state: int) -> Plain:
        choices = []
        for seat, name in enumerate(game.players):
            legal = slice(*offsets[seat][state : state + 2])
            shares = {"played": played[name][legal], "best": best[name][legal]}
            actions = [text_of(action) for action in game.actions[seat][state]]
            rounded = {key: np.round(row, 5).tolist() for key, row in shares.items()}
            choices.append({"actions": actions, **rounded})
        given = game.states[state]
        return {"text": text_of(given), "drawing": drawn_state(task, given), "choices": choices}

    how = "sum of rewards" if horizon else f"return discounted by {discount:g} per step"
    left = f" in what is left of {horizon} steps" if horizon else ""
    shown = np.unique(np.concatenate(visits))
    world: Plain = {
        "kind": "game",
        "agents": [{"name": name} for name in game.players],
        "states": [described(state) for state in shown.tolist()],
        "legend": f"Action and reward: of the last step; rewards are expected ones. Value: exact "
        f"expected {how} from this state on{left}, if all play their policies. Best response: to "
        f"the policies of the others{', in step 1' * bool(horizon)}; first of equal actions.",
    }
    builder.worlds.append(world)
    for name, item, values in zip(games, items, along, strict=True):
        values[-1] *= not item["terminated"]
        item |= {
            "name": name,
            "world": len(builder.worlds) - 1,
            "states": np.searchsorted(shown, item["states"]).tolist(),
            "values": np.round(values, 5).tolist(),
            "players": [labels[player] for player in game.players],
        }
        if (end := item.pop("end")) is not None:
            item["states"][-1], item["shows_end"] = len(world["states"]), True
            world["states"].append(end)
        builder.items.append(item)


def _end(task: GameTask, state: int, actions: tuple[Action, ...]) -> Plain | None:
    """The state after a last step; None if chance chose it."""
    source = task.game.source
    if not isinstance(source, Game):
        return None
    outcomes = source.transitions(task.game.states[state], actions)
    ends = {after for chance, after, _, over in outcomes if over and chance > 0.0}
    if len(ends) != 1 or None in ends:
        return None
    (after,) = ends
    # Games need not draw what is never played.
    drawing = drawn_state(task, after, warns=False)
    return {"text": text_of(after), "drawing": drawing, "choices": []}


def _played(task: GameTask, policies: Mapping[str, StatePolicy], number: int) -> Plain:
    """One episode; "states" has the state before each step and that after the last, or if the game
    has ended again that before it; "end" is the state in which it has ended, if that is known."""
    games = GameSimulator(task, 1, EVALUATION_SEED, number, auto_restart=False)
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    states, chosen, rewards = [int(games.state[0])], list[list[str]](), list[list[float]]()
    while not games.ended.any():
        games.act([policies[name] for name in task.agent_names], actions)
        games.step(actions)
        taken = tuple(map(getitem, task.game.action_lists, actions[0].tolist()))
        chosen.append([text_of(action) for action in taken])
        rewards.append(np.round(games.rewards[0].astype(float), 5).tolist())
        states.append(int(games.state[0]))
    return {
        "end": _end(task, states[-1], taken) if games.terminated[0] else None,
        "length": len(chosen),
        "terminated": bool(games.terminated[0]),
        "truncated": bool(games.truncated[0]),
        "rewards": np.transpose(rewards).tolist(),
        "states": states,
        "actions": chosen,
    }
