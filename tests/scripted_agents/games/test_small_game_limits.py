"""Small games: limits of enumeration, discounts near 1, values of odd kinds, and environments."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count, product, repeat
from typing import Any

import gymnasium
import numpy as np
import pytest

from pursuit import Recorder, chase_v0, memory
from pursuit.tasks.task import Task, make_task
from scripted_agents.games import (
    ParallelGame,
    SmallGameEnv,
    enumerate_game,
    game_of_task,
    respond,
    returns_of,
)
from scripted_agents.games import enumeration as enumeration_module
from scripted_agents.games.agents import uniform_table


class Table:
    """A game of one player from a table; attributes replace what its functions return."""

    players: Any = ("player",)

    def __init__(self, **returned: Any) -> None:
        self.returned, self.calls = returned, 0

    def starts(self) -> Any:
        return self.returned.get("starts", [(1.0, 0)])

    def legal_actions(self, state: Any, player: int) -> Any:
        return self.returned.get("actions", (0, 1))

    def transitions(self, state: Any, actions: Any) -> Any:
        self.calls += 1
        return self.returned.get("transitions", [(1.0, 0, (float(actions[0]),), False)])


# -- limits ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "returned",
    [
        {"starts": repeat((0.0, 0))},
        {"starts": ((0.5**n, n) for n in count(1))},
        {"actions": range(10**9)},
        {"actions": range(10**30)},
        {"actions": count()},
        {"transitions": repeat((0.0, 0, (0.0,), False))},
    ],
    ids=lambda returned: next(iter(returned)),
)
def test_endless_lists_are_refused(
    returned: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(enumeration_module, "MAX_SMALL_STATES", 100_000)
    with pytest.raises(ValueError, match="more than 100,000 entries; give a smaller game"):
        enumerate_game(Table(**returned), most_states=10)


def test_long_lists_within_the_limit_are_read_whole() -> None:
    for size in (2**16 - 1, 2**16, 2**16 + 1, 2**17):
        one = Table(transitions=[(1.0, None, (1.0,), True)])
        one.returned["starts"] = ((1.0 / size, 0) for _ in range(size))
        small = enumerate_game(one)
        assert small.start == pytest.approx([1.0]) and small.num_states == 1


@pytest.mark.parametrize("sizes", [(5000, 5000), (100_000, 1000), (7, 500_000)])
def test_joint_actions_are_counted_before_they_are_played(
    sizes: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Matrix(Table):
        players = ("row", "column")

        def legal_actions(self, state: Any, player: int) -> Any:
            return range(sizes[player])

    monkeypatch.setattr(memory, "free_memory", lambda: 100_000_000)
    game, number = Matrix(), sizes[0] * sizes[1]
    with pytest.raises(ValueError, match=f"{number:,} joint actions in 0 needs .* bytes of memory"):
        enumerate_game(game)
    assert game.calls == 0


class Growing(Table):
    """Many joint actions a state, and ever more states."""

    def legal_actions(self, state: Any, player: int) -> Any:
        return range(300)

    def transitions(self, state: Any, actions: Any) -> Any:
        after = (state + 1) * 300 + actions[0]
        return [(1.0, after % 300, (0.0,), False)]


def test_a_smaller_game_is_advised_once_where_enumeration_will_take_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first states tell: many joint actions each."""
    for progress, seconds, expected in ((True, 0.0, 1), (False, 0.0, 0), (True, 1e9, 0)):
        monkeypatch.setattr(enumeration_module, "LONG", seconds)
        assert len(enumerate_game(Growing(), progress=progress).states) == 300
        said = capsys.readouterr().err
        assert said.count("stop with Ctrl-C and give a smaller game") == expected
        assert said.count("about 300 joint actions a state") == expected


def test_messages_are_one_short_line() -> None:
    long = [(1e-5, n) for n in range(10_000)]
    with pytest.raises(ValueError, match=r"the probabilities .*\.\.\. add up to 0.1; give") as told:
        enumerate_game(Table(starts=long))
    assert len(str(told.value)) < 500


# -- values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rewards",
    [(1e308,), (-1e300,), (10**400,), ("1",), (1j,), (None,), (float("inf"),), "1", 1.0, b"1"],
    ids=lambda given: repr(given)[:12],
)
def test_rewards_whose_sums_are_no_numbers_are_refused(rewards: Any) -> None:
    with pytest.raises(ValueError, match="give one finite number for each of player"):
        enumerate_game(Table(transitions=[(1.0, 0, rewards, False)]))


def test_the_largest_rewards_have_finite_values() -> None:
    small = enumerate_game(Table(transitions=[(1.0, 0, (1e100,), False)]))
    even = {"player": np.array([0.5, 0.5])}
    assert returns_of(small, even, 0.999999)[0, 0] == pytest.approx(1e106)
    assert respond(small, "player", {}, 0.999999).mean == pytest.approx(1e106)


@pytest.mark.parametrize(
    "chance",
    ["1", 1 + 0j, np.complex128(1), None, 10**400, -(10**400), float("nan"), [1.0]],
    ids=lambda given: repr(given)[:12],
)
def test_probabilities_are_numbers_with_sum_one(chance: Any) -> None:
    outcome = dict.fromkeys([chance, 0]) if isinstance(chance, str) else (chance, 0)
    for returned in ({"starts": [outcome]}, {"transitions": [(chance, 0, (0.0,), False)]}):
        with pytest.raises(ValueError, match=r"the probabilities .*(are not numbers|with sum 1)"):
            enumerate_game(Table(**returned))


def test_probabilities_are_divided_by_their_sum() -> None:
    """Sums of 1 + 1e-10 are accepted; with discounts near 1 they would make values infinite."""
    third = (1.0 + 1e-10) / 3
    small = enumerate_game(Table(transitions=[(third, n, (1.0,), False) for n in range(3)]))
    assert np.abs(small.following.sum(axis=1) - 1.0).max() < 1e-15
    even = {"player": np.full(6, 0.5)}
    assert returns_of(small, even, 1.0 - 1e-10)[0, 0] == pytest.approx(1e10, rel=1e-4)


class Walk:
    """Random transitions and rewards of two players; no end, or one with a small probability."""

    players = ("a", "b")

    def __init__(self, seed: int, ends: float) -> None:
        random, states = np.random.default_rng(seed), range(4)
        self.rows = {
            key: random.dirichlet(np.ones(4)).tolist()
            for key in product(states, range(2), range(2))
        }
        self.rewards = {key: random.normal(size=2).tolist() for key in self.rows}
        self.ends = ends

    def starts(self) -> Any:
        return [(0.25, state) for state in range(4)]

    def legal_actions(self, state: Any, player: int) -> Any:
        return (0, 1)

    def transitions(self, state: Any, actions: Any) -> Iterator[Any]:
        rewards = self.rewards[state, *actions]
        yield self.ends, None, rewards, True
        for after, chance in enumerate(self.rows[state, *actions]):
            yield (1.0 - self.ends) * chance, after, rewards, False

    def solve(self, first: Any, second: Any, discount: float) -> Any:
        """[states, players]: the values of pure actions per state, by a dense linear solve."""
        keys = [(state, first[state], second[state]) for state in range(4)]
        matrix = np.array([self.rows[key] for key in keys]) * (1.0 - self.ends)
        rewards = np.array([self.rewards[key] for key in keys])
        return np.linalg.solve(np.eye(4) - discount * matrix, rewards)


@pytest.mark.parametrize("discount", [0.99, 0.9999, 0.99999999])
@pytest.mark.parametrize("ends", [0.0, 1e-4])
def test_discounts_near_one_are_solved_by_linear_equations(discount: float, ends: float) -> None:
    """Against dense solves of all pure policies."""
    game = Walk(3, ends)
    small = enumerate_game(game)
    assert small.states == [0, 1, 2, 3]
    mine = (0, 1, 1, 0)
    fixed = np.array([[action == 0, action == 1] for action in mine], dtype=float).ravel()
    pure = list(product(range(2), repeat=4))
    known = [game.solve(policy, mine, discount)[:, 0] for policy in pure]
    found = respond(small, "a", {"b": fixed}, discount)
    np.testing.assert_allclose(found.values, np.max(known, axis=0), rtol=1e-6)
    reached = returns_of(small, {"a": found.tables["a"], "b": fixed}, discount)
    np.testing.assert_allclose(reached[:, 0], found.values, rtol=1e-6)
    both = {"a": fixed, "b": fixed}
    np.testing.assert_allclose(
        returns_of(small, both, discount), game.solve(mine, mine, discount), rtol=1e-6
    )


# -- environments ----------------------------------------------------------------------------------


def test_what_restore_leaves_out_is_found() -> None:
    """A step after `restore` would start from another state."""
    env = chase_v0.parallel_env(maze="2x2", max_steps=10**6, observation="positions")

    def save(env: Any) -> Any:
        return tuple(env.simulator.positions[0].tolist())

    def restore(env: Any, state: Any) -> None:
        env.reset(seed=0, options={"positions": [state[1], state[0]]})

    with pytest.raises(ValueError, match=r"after restore\(env, (\(.*\))\) save\(env\) returns"):
        enumerate_game(ParallelGame(env, save, restore, seeds=range(9)))


def test_an_episode_is_terminated_or_truncated_never_both() -> None:
    task = make_task("chase", maze="2x2", rewards="zero_sum")
    small = game_of_task(task)
    others = {"evader_0": uniform_table(small, "evader_0")}
    env = SmallGameEnv(small, "chaser_0", others, max_steps=3)
    ends = set()
    for episode in range(200):
        env.reset(seed=episode)
        over, steps = False, 0
        while not over:
            legal = np.flatnonzero(env.action_masks())
            _, _, terminated, truncated, _ = env.step(legal[episode % len(legal)])
            over, steps = terminated or truncated, steps + 1
            assert not (terminated and truncated) and (steps < 3 or over)
        ends.add((terminated, steps))
    assert {(True, 3), (False, 3)} <= ends


def test_an_index_that_is_no_whole_number_is_refused() -> None:
    env = SmallGameEnv(enumerate_game(Table()), "player", {})
    env.reset(seed=0)
    for wrong in (0.9, 1.0, True, "1", None, [0, 1], -1, 2, np.array([0.0]), 1j, np.eye(2)):
        with pytest.raises(ValueError, match=r"action=.*player are numbers from 0 to 1"):
            env.step(wrong)
    assert env.steps == 0
    for right in (1, np.int64(1), np.array(1), np.array([1])):
        assert env.step(right)[1] == 1.0


@pytest.mark.parametrize("name", ["chase", "race", "heist"])
def test_episodes_of_a_task_are_recorded(name: str) -> None:
    """The replay plays the same cells and rewards; its check plays them in the simulator."""
    task: Task = make_task(name, maze="3x3-tree", **({} if name == "chase" else {"num_goals": 1}))
    small = game_of_task(task)
    own, other = task.agent_names
    env = SmallGameEnv(small, own, {other: uniform_table(small, other)}, max_steps=30)
    recorder = Recorder(gymnasium.wrappers.RecordEpisodeStatistics(env))
    random, played = np.random.default_rng(0), []
    for episode in range(20):
        recorder.reset(seed=episode)
        states, total, over = [env.state], 0.0, False
        while not over:
            action = random.choice(np.flatnonzero(env.action_masks()))
            _, reward, terminated, truncated, _ = recorder.step(action)
            states, total, over = [*states, env.state], total + reward, terminated or truncated
        played.append((small.states[states[0]], len(states) - 1, total, terminated, truncated))
    replay = recorder.stop()
    assert replay.check() == [] and replay.seed == 19
    assert len(replay.episodes) == 20
    for recorded, (start, steps, total, terminated, truncated) in zip(
        replay.episodes, played, strict=True
    ):
        assert (tuple(recorded.start["positions"]), tuple(recorded.start["goals"])) == start
        assert len(recorded.actions) == steps
        assert float(recorded.rewards[:, 0].sum()) == pytest.approx(total, rel=1e-5, abs=1e-6)
        assert (recorded.terminated, recorded.truncated) == (terminated, truncated)


def test_a_game_without_a_task_cannot_be_recorded() -> None:
    env = SmallGameEnv(enumerate_game(Table()), "player", {})
    with pytest.raises(ValueError, match="a SmallGameEnv only of game_of_task"):
        Recorder(env)
