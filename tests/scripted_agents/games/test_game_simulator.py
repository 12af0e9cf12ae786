"""Copies of enumerated games stepped by tables, against plain loops and exact values."""

from __future__ import annotations

import copy
import pickle
from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from small_games import GAMES, Doors, Nim, RandomGame, legal_actions, random_tables

from pursuit import memory
from pursuit.tasks.task import make_task
from scripted_agents.games import (
    GameSimulator,
    GameTask,
    TableAgent,
    enumerate_game,
    game_of_task,
    returns_of,
)
from scripted_agents.games.agents import named_agent, uniform_table
from scripted_agents.games.tables import row_sums, step_tables


def random_legal(simulator: GameSimulator, random: np.random.Generator) -> np.ndarray[Any, Any]:
    """Random legal actions, chosen in Python."""
    game = simulator.task.game
    rows = [
        [random.choice(legal_actions(game, state, seat)) for seat in range(len(game.players))]
        for state in simulator.state.tolist()
    ]
    return np.array(rows, dtype=np.int32)


def everything(simulator: GameSimulator) -> dict[str, Any]:
    """Copies of all arrays of a simulator."""
    names = (
        "streams", "state", "steps", "rewards", "returns", "terminated", "truncated",
        "episode_returns", "episode_lengths", "final_state", "epsilon", "next_epsilon",
    )  # fmt: skip
    return {name: getattr(simulator, name).copy() for name in names}


def same(one: dict[str, Any], other: dict[str, Any], games: Any = slice(None)) -> None:
    for name, values in one.items():
        np.testing.assert_array_equal(values[games], other[name], err_msg=name)


# -- against a plain loop --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "game",
    [
        RandomGame(2, outcomes=1, seed=1),
        RandomGame(3, outcomes=1, seed=2),
        RandomGame(1, outcomes=1, seed=3, ends=0.0),
        Nim(),
    ],
)
@pytest.mark.parametrize("auto_restart", [True, False])
def test_games_without_chance_are_those_of_a_plain_loop(game: Any, auto_restart: bool) -> None:
    small = enumerate_game(game)
    simulator = GameSimulator(GameTask(small, max_steps=6), 40, seed=5, auto_restart=auto_restart)
    random, players = np.random.default_rng(0), len(small.players)
    starts = {state for _, state in game.starts()}
    states = [small.states[number] for number in simulator.state]
    assert {*states} <= starts and len({*states}) > 1
    steps, totals, over = [0] * 40, np.zeros((40, players)), [False] * 40
    ends: Counter[str] = Counter()
    for _ in range(30):
        actions = random_legal(simulator, random)
        simulator.step(actions)
        for i in range(40):
            if over[i] and not auto_restart:
                assert small.states[simulator.state[i]] == states[i]
                assert not simulator.rewards[i].any()
                continue
            chosen = tuple(
                small.action_lists[seat][number] for seat, number in enumerate(actions[i])
            )
            ((chance, after, rewards, ended),) = game.transitions(states[i], chosen)
            steps[i], totals[i] = steps[i] + 1, totals[i] + rewards
            assert abs(chance - 1.0) < 1e-9 and simulator.rewards[i].tolist() == list(rewards)
            assert simulator.terminated[i] == ended
            assert simulator.truncated[i] == (not ended and steps[i] == 6)
            over[i] = bool(simulator.ended[i])
            kept = states[i] if ended else after
            if over[i]:
                ends["terminated" if ended else "truncated"] += 1
                assert simulator.episode_returns[i].tolist() == totals[i].tolist()
                assert simulator.episode_lengths[i] == steps[i]
                assert small.states[simulator.final_state[i]] == kept
            if over[i] and auto_restart:
                states[i], steps[i] = small.states[simulator.state[i]], 0
                totals[i] = 0.0
                assert states[i] in starts
            else:
                states[i] = kept
            assert small.states[simulator.state[i]] == states[i]
            assert simulator.steps[i] == steps[i]
            assert simulator.returns[i].tolist() == totals[i].tolist()
    assert ends["truncated"] if small.players == ("p0",) else ends["terminated"]


@pytest.mark.parametrize("name", ["chance", "three", "masks"])
def test_games_with_chance_do_only_what_their_transitions_allow(name: str) -> None:
    small = GAMES[name]()
    simulator = GameSimulator(GameTask(small, max_steps=9), 60, seed=2, auto_restart=False)
    random = np.random.default_rng(1)
    for _ in range(12):
        before, over = simulator.state.copy(), simulator.ended
        actions = random_legal(simulator, random)
        simulator.step(actions)
        for i in np.flatnonzero(~over):
            state = small.states[before[i]]
            chosen = tuple(
                small.action_lists[seat][number] for seat, number in enumerate(actions[i])
            )
            outcomes = [row for row in small.source.transitions(state, chosen) if row[0] > 0.0]
            if simulator.terminated[i]:
                assert any(row[3] for row in outcomes)
            else:
                now = small.states[simulator.state[i]]
                assert now in {row[1] for row in outcomes if not row[3]}
            mean = sum(row[0] * np.array(row[2]) for row in outcomes)
            np.testing.assert_allclose(simulator.rewards[i], mean, rtol=1e-6, atol=1e-7)
        assert not (simulator.terminated & simulator.truncated).any()
    assert simulator.ended.all() and set(simulator.episode_lengths) <= {*range(1, 10)}


class Urn:
    """One step to one of three balls or to the end, from four starts."""

    players = ("drawer",)
    chances = (0.5, 0.25, 0.05, 0.2)

    def starts(self) -> Any:
        return [(0.1, "a"), (0.2, "b"), (0.3, "c"), (0.4, "d")]

    def legal_actions(self, state: Any, player: int) -> Any:
        return ("draw",)

    def transitions(self, state: Any, actions: Any) -> Any:
        if state in ("red", "blue", "green"):
            return [(1.0, state, (0.0,), False)]
        balls = zip(self.chances, ("red", "blue", "green", "end"), strict=True)
        return [(chance, ball, (0.0,), ball == "end") for chance, ball in balls]


def test_chance_has_its_probabilities() -> None:
    small, count = enumerate_game(Urn()), 200_000
    simulator = GameSimulator(GameTask(small), count, seed=3, auto_restart=False)
    drawn = Counter(small.states[number] for number in simulator.state.tolist())
    expected = {state: chance for chance, state in Urn().starts()}
    first = simulator.state.copy()
    simulator.step(np.zeros((count, 1), dtype=np.int32))
    ended = simulator.terminated
    balls = Counter(small.states[number] for number in simulator.state[~ended].tolist())
    balls["end"] = int(ended.sum())
    known = dict(zip(("red", "blue", "green", "end"), Urn.chances, strict=True))
    for found, wanted in ((drawn, expected), (balls, known)):
        assert sum(found.values()) == count and found.keys() == wanted.keys()
        for key, chance in wanted.items():
            sigma = (count * chance * (1 - chance)) ** 0.5
            assert abs(found[key] - count * chance) < 4.5 * sigma, key
    # What is drawn does not depend on the start.
    for start in range(4):
        share = ended[first == start].mean()
        assert abs(share - 0.2) < 4.5 * (0.16 / (first == start).sum()) ** 0.5


# -- seeds, batches, copies ------------------------------------------------------------------------


@pytest.mark.parametrize("name", GAMES)
def test_a_game_does_not_depend_on_its_batch(name: str) -> None:
    task = GameTask(GAMES[name](), max_steps=5)
    agents = [named_agent("uniform", task, player) for player in task.agent_names]
    batches = [(0, 7), (0, 3), (3, 4), (5, 1)]
    simulators = [GameSimulator(task, size, seed=9, first_game=first) for first, size in batches]
    for simulator in simulators:
        actions = np.zeros((simulator.num_games, task.num_agents), dtype=np.int32)
        for _ in range(23):
            simulator.act(agents, actions)
            simulator.step(actions)
    whole = everything(simulators[0])
    for (first, size), simulator in zip(batches, simulators, strict=True):
        same(whole, everything(simulator), slice(first, first + size))
    other = GameSimulator(task, 7, seed=10)
    assert not (other.streams == GameSimulator(task, 7, seed=9).streams).any()


@pytest.mark.parametrize(
    ("copied", "auto_restart"),
    [
        (copy.copy, True),
        (copy.deepcopy, False),
        (lambda each: pickle.loads(pickle.dumps(each)), True),
    ],
)
def test_copies_and_restored_states_go_on_alike(copied: Any, auto_restart: bool) -> None:
    task = GameTask(GAMES["masks"](), max_steps=5)
    simulator = GameSimulator(task, 6, seed=1, auto_restart=auto_restart)
    random = np.random.default_rng(0)
    simulator.configure(epsilon=0.25, seat="p1")
    for _ in range(4):
        simulator.step(random_legal(simulator, random))
    state, twin = simulator.get_state(), copied(simulator)
    same(everything(simulator), everything(twin))
    restored = GameSimulator(task, 6, seed=77, auto_restart=auto_restart)
    restored.set_state(state)
    assert twin.last_seed is None and restored.last_seed is None
    for _ in range(9):
        actions = random_legal(simulator, random)
        for each in (simulator, twin, restored):
            each.step(actions)
        same(everything(simulator), everything(twin))
        for name in ("state", "steps", "rewards", "returns", "terminated", "streams", "epsilon"):
            np.testing.assert_array_equal(getattr(simulator, name), getattr(restored, name))
    simulator.reset(games=[2])
    assert (simulator.streams[2] != twin.streams[2]).any()  # no shared memory
    other = simulator.get_state([0, 3])
    simulator.set_state(other, [4, 5])
    assert simulator.state[[4, 5]].tolist() == simulator.state[[0, 3]].tolist()
    for name, wrong in (("state", task.game.num_states), ("state", -1), ("steps", 6)):
        broken = simulator.get_state()
        getattr(broken, name)[1] = wrong
        before = everything(simulator)
        with pytest.raises(ValueError, match=name):
            simulator.set_state(broken)
        same(before, everything(simulator))


def test_a_policy_plays_in_a_copy_of_its_simulator() -> None:
    task = GameTask(GAMES["masks"]())
    agent = TableAgent(task, "p0", random_tables(task.game, 0)["p0"])
    simulator = GameSimulator(task, 5)
    twin = copy.deepcopy(simulator)
    assert agent.act(twin.view(0)).tolist() == agent.act(simulator.view(0)).tolist()


def test_seeds_of_starts_and_of_single_games() -> None:
    task = GameTask(GAMES["chance"]())
    simulator = GameSimulator(task, 50, seed=4)
    first, streams = simulator.state.copy(), simulator.streams.copy()
    simulator.reset(seed=4)
    assert (simulator.state == first).all() and (simulator.streams == streams).all()
    simulator.reset()
    assert (simulator.streams[:, 0] != streams[:, 0]).all()
    assert (simulator.streams[:, 1:] == streams[:, 1:]).all()
    simulator.seed_starts(None, 8)
    simulator.reset()
    assert len({*simulator.state.tolist()}) == 1
    simulator.reset(seed=4, games=[3])
    assert simulator.state[3] == first[3]


# -- ends, illegal actions -------------------------------------------------------------------------


def test_ended_games_stay_as_they_are_until_a_reset() -> None:
    simulator = GameSimulator(GameTask(GAMES["turns"]()), 30, seed=0, auto_restart=False)
    random = np.random.default_rng(0)
    while not simulator.ended.all():
        simulator.step(random_legal(simulator, random))
    before = everything(simulator)
    simulator.step(np.full((30, 2), -1, dtype=np.int32))
    after = everything(simulator)
    assert not after.pop("rewards").any()
    same({name: before[name] for name in after}, after)
    simulator.reset(games=[4])
    assert not simulator.ended[4] and simulator.steps[4] == 0 and not simulator.returns[4].any()
    simulator.reset()
    assert not simulator.ended.any()


def test_an_illegal_action_is_refused_and_no_game_moves() -> None:
    small = enumerate_game(Nim())
    simulator = GameSimulator(GameTask(small), 4, seed=0)
    none = small.action_lists[1].index(None)
    assert small.action_lists == ((1, 2, 3, None), (1, 2, 3, None)) and none == 3
    lists = pickle.loads(pickle.dumps(small.action_lists))
    assert lists["second"] == lists[1] == lists[-1] and lists == small.action_lists
    with pytest.raises(ValueError, match="player 'third'; the players are first, second"):
        lists["third"]
    before = everything(simulator)
    for wrong in ([3, 3], [0, 0], [-1, 3], [4, 3], [2**31 - 1, 3], [2**40, 3], [-(2**40), 3]):
        actions: Any = [[0, 3]] * 4
        actions[2] = wrong
        with pytest.raises(
            ValueError, match=r"of (first|second) in game 2 is not legal in \(\d, 0"
        ):
            simulator.step(actions)
        same(before, everything(simulator))
    with pytest.raises(ValueError, match=r"second in game 0 .*the legal ones are \{3: None\}"):
        simulator.step(np.zeros((4, 2), dtype=np.int32))
    for wrong in ([[0, 3]], [0, 3] * 4, np.full((4, 2), 0.0), [["0", "3"]] * 4, None, np.eye(3)):
        with pytest.raises(ValueError, match="actions"):
            simulator.step(wrong)
        same(before, everything(simulator))
    other = copy.deepcopy(simulator)
    simulator.step(np.array([[0, 3]] * 4, dtype=np.uint8))
    other.step(np.array([[0, 3]] * 4, dtype=np.int32, order="F"))
    same(everything(simulator), everything(other))


def test_an_illegal_action_after_a_restart_is_refused() -> None:
    """The flags of the last episode are still set then."""
    simulator = GameSimulator(GameTask(enumerate_game(Nim(1, 1))), 1)
    simulator.step([[0, 0]])
    assert simulator.terminated[0] and simulator.steps[0] == 0
    before = everything(simulator)
    for wrong in ([1, 0], [-1, 0], [0, 1]):
        with pytest.raises(ValueError, match="is not legal"):
            simulator.step([wrong])
    same(before, everything(simulator))


# -- policies --------------------------------------------------------------------------------------


@pytest.mark.parametrize("epsilon", [0.0, 0.3])
@pytest.mark.parametrize("name", GAMES)
def test_mean_returns_of_tables_are_the_exact_ones(name: str, epsilon: float) -> None:
    small, count, steps = GAMES[name](), 20_000, 6
    task = GameTask(small, max_steps=steps)
    tables = random_tables(small, 1)
    agents = [TableAgent(task, player, tables[player], epsilon) for player in small.players]
    played = {agent.agent: agent.table(task) for agent in agents}
    known = small.start @ returns_of(small, played, 1.0, steps)
    simulator = GameSimulator(task, count, seed=7, auto_restart=False)
    actions = np.zeros((count, task.num_agents), dtype=np.int32)
    for _ in range(steps):
        simulator.act(agents, actions)
        simulator.step(actions)
    assert simulator.ended.all()
    found = simulator.episode_returns
    assert (np.abs(found.mean(axis=0) - known) < 4.5 * found.std(axis=0) / count**0.5).all()
    if epsilon:
        plain = small.start @ returns_of(small, tables, 1.0, steps)
        assert np.abs(plain - known).max() > 0.02


def test_actions_of_a_table_have_its_probabilities() -> None:
    small, count = GAMES["masks"](), 100_000
    task = GameTask(small)
    table = random_tables(small, 5)["p1"]
    agent, simulator = TableAgent(task, "p1", table), GameSimulator(task, count, seed=1)
    simulator.configure(epsilon=[0.0] * 50_000 + [1.0] * 50_000, seat="p1")
    assert np.isnan(simulator.epsilon).all()  # from the next restart on
    simulator.reset()
    assert np.isnan(simulator.epsilon[:, 0]).all() and simulator.epsilon[:, 1].mean() == 0.5
    chosen, offsets = agent.act(simulator.view("p1")), small.offsets(1)
    for state in range(3):
        names = small.actions[1][state]
        for half, wanted in (
            (slice(0, 50_000), table[offsets[state] : offsets[state + 1]]),
            (slice(50_000, None), np.full(len(names), 1 / len(names))),
        ):
            here = chosen[half][simulator.state[half] == state]
            for name, chance in zip(names, wanted, strict=True):
                share = (here == small.action_lists[1].index(name)).mean()
                assert abs(share - chance) < 4.5 * (chance * (1 - chance) / len(here)) ** 0.5 + 1e-9
    # NaN: the epsilon of the policy again.
    simulator.configure(epsilon=np.nan)
    simulator.reset()
    assert np.isnan(simulator.epsilon).all() and (simulator.next_epsilon == -1.0).all()
    assert np.array_equal(
        TableAgent(task, "p1", table, 1.0).table(task), uniform_table(small, "p1")
    )


def test_settings_of_the_next_episode_are_checked() -> None:
    task = GameTask(GAMES["masks"]())
    simulator = GameSimulator(task, 4)
    simulator.configure([1, 2], epsilon=[[0.1, 0.2], [0.3, 0.4]])
    assert simulator.next_epsilon.tolist() == [[-1, -1], [0.1, 0.2], [0.3, 0.4], [-1, -1]]
    for games, settings in (
        (None, {"epsilon": 1.5}),
        (None, {"epsilon": -0.5}),
        (None, {"epsilon": [0.1, 0.2]}),
        (None, {"epsilon": "0.1"}),
        (None, {"epsilon": 0.1, "seat": "p2"}),
        (None, {"epsilon": 0.1, "seat": 2}),
        ([4], {"epsilon": 0.1}),
    ):
        with pytest.raises(ValueError, match=r"epsilon|player|games"):
            simulator.configure(games, **settings)
        assert (simulator.next_epsilon[[0, 3]] == -1).all()
    agent = TableAgent(task, "p0", uniform_table(task.game, "p0"))
    for view in (simulator.view(1), GameSimulator(GameTask(GAMES["masks"]()), 2).view(0)):
        with pytest.raises(ValueError, match="is a policy of p0 in game 'game'; use it there"):
            agent.act(view)


def test_a_view_shows_the_games_of_a_player() -> None:
    simulator = GameSimulator(GameTask(GAMES["turns"]()), 6, seed=2)
    view = simulator.view("second")
    assert view is simulator.view(1) and view.num_games == 6
    part = view.select(np.array([5, 1]))
    assert part.state.tolist() == simulator.state[[5, 1]].tolist()
    assert part.observe("observe").tolist() == simulator.observe("observe", 1)[[5, 1]].tolist()
    streams = simulator.streams.copy()
    drawn = view.uniform()
    assert ((drawn >= 0) & (drawn < 1)).all() and len({*drawn}) == 6
    changed = simulator.streams != streams
    assert changed[:, 3].all() and not changed[:, :3].any()


# -- observations ----------------------------------------------------------------------------------


def test_observations_are_those_of_the_states() -> None:
    small = enumerate_game(Nim())
    task = GameTask(small, max_steps=7)
    simulator = GameSimulator(task, 9, seed=3)
    random = np.random.default_rng(0)
    for _ in range(9):
        for seat in range(2):
            index = simulator.observe("index", seat)
            assert index.dtype == np.int32 and (index[:, 0] == simulator.state).all()
            hot = simulator.observe("one_hot", seat)
            assert hot.dtype == np.float32 and hot.shape == (9, small.num_states)
            assert (hot.argmax(axis=1) == simulator.state).all() and (hot.sum(axis=1) == 1).all()
            seen = simulator.observe("observe", seat)
            wanted = [Nim().observe(small.states[number], seat) for number in simulator.state]
            assert seen.dtype == np.float32 and seen.tolist() == np.array(wanted, float).tolist()
            for name in ("index", "one_hot", "observe"):
                every = task.observations(seat, name)
                assert (every[simulator.state] == simulator.observe(name, seat)).all()
        kept = simulator.observe("index"), simulator.state.copy()
        simulator.step(random_legal(simulator, random))
        assert (kept[0][:, 0] == kept[1]).all()  # a new array
    assert task.legal("first").sum(axis=1).tolist() == [len(row) for row in small.actions[0]]
    for seat in range(2):
        waits = [row == (None,) for row in small.actions[seat]]
        assert task.waiting[seat].tolist() == waits and any(waits)


@pytest.mark.parametrize(
    ("observe", "problem"),
    [
        (lambda state, player: [0.0] * (state[0] % 2 + 1), "in the first state; return arrays of"),
        (lambda state, player: [[1.0], [2.0, 3.0]], "return an array of numbers"),
        (lambda state, player: None, "return an array of numbers"),
        (lambda state, player: "text", "return an array of numbers"),
        (lambda state, player: [1j], "return an array of numbers"),
        (lambda state, player: [np.nan], "numbers that are not finite"),
        (lambda state, player: [1e39], "numbers that are not finite"),
        (lambda state, player: [1 / (state[0] - 3)], "raised ZeroDivisionError.*; mend it"),
        (lambda state, player: [np.inf if state[0] == 2 else 0.0], r"observe\(\(2, "),
        (None, "no function observe"),
    ],
)
def test_wrong_observations_are_refused(observe: Any, problem: str) -> None:
    game = Nim()
    game.observe = observe  # type: ignore[method-assign]
    simulator = GameSimulator(GameTask(enumerate_game(game)), 2)
    with pytest.raises(ValueError, match=problem) as raised:
        simulator.observe("observe", "second")
    assert "\n" not in str(raised.value)
    with pytest.raises(ValueError, match="unknown observation 'planes'"):
        simulator.observe("planes")
    assert simulator.observe("index").shape == (2, 1)


def test_one_hot_of_many_states_needs_memory_for_the_games_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Line:
        players = ("p",)

        def starts(self) -> Any:
            return [(1.0, 0)]

        def legal_actions(self, state: Any, player: int) -> Any:
            return (0,)

        def transitions(self, state: Any, actions: Any) -> Any:
            return [(1.0, state + 1, (0.0,), state == 20_000)]

    simulator = GameSimulator(GameTask(enumerate_game(Line())), 2)
    monkeypatch.setattr(memory, "free_memory", lambda: 1_000_000_000)
    assert simulator.observe("one_hot").shape == (2, 20_001)
    with pytest.raises(ValueError, match="one_hot of 20,001 states"):
        simulator.task.observations(0, "one_hot")


# -- tables ----------------------------------------------------------------------------------------


def test_sums_of_rows_are_those_of_each_row_alone() -> None:
    random = np.random.default_rng(0)
    sizes = random.integers(0, 6, 1000)
    begins = np.concatenate([[0], np.cumsum(sizes)])
    values = random.random(begins[-1]) * 10.0 ** random.integers(0, 9, begins[-1])
    found = row_sums(values, begins)
    for first, last in pairwise(begins.tolist()):
        assert found[first:last].tolist() == np.cumsum(values[first:last]).tolist()
    assert row_sums(np.zeros(0), np.zeros(1, dtype=int)).shape == (0,)


def test_tables_that_do_not_fit_are_refused_with_their_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small = GAMES["chance"]()
    tables = step_tables(small)
    room = sum(array.nbytes for array in (tables.places, tables.after, tables.rewards, tables.sums))
    monkeypatch.setattr(memory, "SMALL", 0)
    monkeypatch.setattr(memory, "free_memory", lambda: room - 1)
    with pytest.raises(ValueError, match=r"needs [0-9,]+ bytes of memory"):
        step_tables(small)


def test_the_actions_of_a_task_are_the_moves_of_its_simulator() -> None:
    small = game_of_task(make_task("chase", maze="2x2-tree"))
    places = step_tables(small).places
    for seat in range(2):
        for state in range(small.num_states):
            wanted = legal_actions(small, state, seat)
            assert np.flatnonzero(places[seat, state] >= 0).tolist() == wanted


def test_what_cannot_be_stepped_is_refused() -> None:
    class Large(Urn):
        def legal_actions(self, state: Any, player: int) -> Any:
            return range(40_000) if state == "a" else (0,)

        def transitions(self, state: Any, actions: Any) -> Any:
            return [(1.0, "end", (self.reward,), True)]

        reward = 1.0

    task = GameTask(enumerate_game(Large()))
    with pytest.raises(ValueError, match="a player has 40,000 different actions"):
        GameSimulator(task)
    Large.reward, Large.legal_actions = 1e39, Urn.legal_actions  # type: ignore[method-assign]
    with pytest.raises(ValueError, match=r"a reward of 1e\+39 does not fit into float32"):
        GameSimulator(GameTask(enumerate_game(Large())))
    small = enumerate_game(Doors())
    for wrong in (small, None, "doors", Doors()):
        with pytest.raises(ValueError, match="give a GameTask"):
            GameSimulator(wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="give enumerate_game"):
        GameTask(Doors())  # type: ignore[arg-type]
    for settings in ({"max_steps": 0}, {"max_steps": 1.5}, {"max_steps": None}):
        with pytest.raises(ValueError, match="max_steps"):
            GameTask(small, **settings)  # type: ignore[arg-type]
    for settings in ({"num_games": 0}, {"seed": -1}, {"first_game": -1}, {"auto_restart": 1}):
        with pytest.raises(ValueError, match=next(iter(settings))):
            GameSimulator(GameTask(small), **settings)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="take fewer games"):
        GameSimulator(GameTask(small), 2**50)
    for wrong in ("robber", 2, -1, True, None):
        with pytest.raises(ValueError, match="player"):
            GameTask(small).seat(wrong)  # type: ignore[arg-type]
