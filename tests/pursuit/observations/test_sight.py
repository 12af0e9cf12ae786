"""Limited views: exactly the entities out of view are absent from every observation."""

from __future__ import annotations

import pickle
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pursuit import chase_v0
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from pursuit.replays.adapters import ADAPTERS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from pursuit.tasks.visibility import visible_cells
from tests.random_mazes import any_maze, connected_maze, seeds
from tests.reference_observations import Seen, cells_seen, check_observations

HALL = Maze.from_text("+-+-+-+-+\n|     | |\n+ +-+ + +\n| |#|   |\n+ +-+ + +\n|   |   |\n+-+-+-+-+")
LIMITS: dict[str, dict[str, Any]] = {
    "radius": {"view_radius": 2},
    "line": {"line_of_sight": True, "unknown_maze": True},
    "mixed": {
        "view_radius": {"chaser": 1, "evader_1": None, "evader": 3},
        "line_of_sight": ("chaser_1", "runner"),
        "unknown_maze": ("chaser", "runner"),
    },
    "blind": {"view_radius": {"chaser": 0, "evader_0": 0, "runner": 1}, "unknown_maze": True},
}
CROWD = {"num_chasers": 2, "num_evaders": 2, "num_runners": 2, "num_goals": 3, "max_steps": 20}


@given(any_maze, st.none() | st.integers(0, 9), st.booleans())
@settings(max_examples=60, deadline=None)
def test_cells_in_view_are_those_of_a_flood_and_of_walks(
    maze: Maze, radius: int | None, in_line: bool
) -> None:
    seen = visible_cells(maze, radius, in_line)
    for own in range(maze.num_cells):
        assert set(np.flatnonzero(seen[own])) == cells_seen(maze, own, radius, in_line)
    assert np.array_equal(seen, seen.T)
    assert seen.diagonal().all()


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n in ("radius", "line"))) for n in LIMITS],
)
def test_observations_hide_what_is_not_in_view(name: str) -> None:
    task = Task(maze=(HALL, "3x3"), **CROWD, **LIMITS[name])
    assert check_observations(task, seed=1, games=4, steps=8)[0] > 100


@given(seeds, st.integers(2, 5), st.none() | st.integers(0, 4), st.booleans(), st.booleans())
@settings(max_examples=15, deadline=None)
def test_observations_in_random_mazes_hide_what_is_not_in_view(
    seed: int, width: int, radius: int | None, in_line: bool, unknown: bool
) -> None:
    maze = connected_maze(seed, 4, width)
    task = make_task(
        "heist", maze=maze, num_goals=1, view_radius=radius, line_of_sight=in_line,
        unknown_maze=unknown,
    )  # fmt: skip
    check_observations(task, seed, games=2, steps=4)


@pytest.mark.parametrize("encoding", [*ENCODINGS[:-1], "window:3"])
def test_all_settings_of_full_views_are_equivalent(encoding: str) -> None:
    plain = Task(maze=(HALL, "3x3"), **CROWD)
    seen = Simulator(plain, 16, seed=3).observe(encoding)
    for same in ({"unknown_maze": True}, {"view_radius": {"chaser": None}}):
        np.testing.assert_array_equal(
            Simulator(replace(plain, **same), 16, seed=3).observe(encoding), seen
        )
    far = Simulator(replace(plain, view_radius=99), 16, seed=3).observe(encoding)
    np.testing.assert_array_equal(
        far[:, :, :10] if encoding in ("planes", "window:3") else far, seen
    )


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_limited_observations_of_one_agent_and_of_an_end_are_the_same(encoding: str) -> None:
    task = make_task("chase", maze="3x3", num_evaders=2, max_steps=9, **LIMITS["radius"])
    batch = Simulator(task, 5, seed=4)
    stopped = Simulator(task, 5, seed=4, auto_restart=False)
    rng, ended = np.random.default_rng(0), 0
    for _ in range(20):
        seen = batch.observe(encoding)
        for seat in range(3):
            np.testing.assert_array_equal(batch.observe(encoding, seat), seen[:, seat])
        stopped.set_state(batch.get_state())
        actions = rng.integers(4, size=(5, 3)).astype(np.int32)
        for each in (batch, stopped):
            each.step(actions)
        over = np.flatnonzero(batch.ended)
        ended += len(over)
        final = batch.observe_final(encoding, games=over)
        np.testing.assert_array_equal(final, stopped.observe(encoding)[over])
    assert ended > 3


class Cells:
    """A custom observation: 1 + cell of every agent, 0 for agents out of view."""

    def space(self, task: Task) -> Any:
        import gymnasium

        return gymnasium.spaces.Box(-99, 99, (task.num_agents + task.num_goals,), np.int32)

    def encode(self, task: Task, games: Any, seats: Any) -> NDArray[Any]:
        assert (games.events[games.positions < 0] == 0).all()
        cells = np.concatenate([(games.positions + 1) * games.active, games.goals + 1], axis=1)
        assert ((games.positions < 0) <= (games.active == 0)).all()
        return np.repeat(cells[:, None], len(seats), axis=1)


def test_custom_observations_get_no_agents_out_of_view() -> None:
    task = Task(maze=(HALL, "3x3"), **CROWD, **LIMITS["mixed"])
    simulator = Simulator(task, 8, seed=2)
    rng = np.random.default_rng(3)
    for _ in range(6):
        simulator.step(rng.integers(4, size=(8, 6)))
        encoded = simulator.observe(Cells())  # type: ignore[arg-type]
        for game, seat in np.ndindex(8, 6):
            seen = Seen(simulator, game, seat)
            cells = [*simulator.positions[game] * simulator.active[game], *simulator.goals[game]]
            plays = [*simulator.active[game], *(simulator.goals[game] >= 0)]
            expected = [
                c + 1 if p and c in seen.view else 0 for c, p in zip(cells, plays, strict=True)
            ]
            assert encoded[game, seat].tolist() == expected


def test_task_sees_returns_the_visible_cells() -> None:
    task = Task(maze=(HALL, "3x3"), **CROWD, **LIMITS["mixed"])
    for seat, name in enumerate(task.agent_names):
        radius, in_line, _ = task.sight.limits[seat]
        for number, maze in enumerate(task.mazes):
            seen = task.sees(name, number)
            np.testing.assert_array_equal(seen, visible_cells(maze, radius, in_line))
            assert not seen.flags.writeable
    assert task.sees("evader_1").all()
    assert [limit.view_radius for limit in task.sight.limits] == [1, 1, 3, None, None, None]
    with pytest.raises(ValueError, match="maze_number=2"):
        task.sees(0, 2)


def test_all_forms_of_view_settings_are_stored_alike() -> None:
    by_name = make_task("chase", view_radius={"chaser": 2, "evader_0": None})
    assert by_name == make_task("chase", view_radius="chaser=2, evader_0=none")
    assert hash(by_name) == hash(pickle.loads(pickle.dumps(by_name)))
    assert make_task("chase", view_radius="2") == make_task("chase", view_radius=np.int64(2))
    assert make_task("chase", line_of_sight="all") == make_task("chase", line_of_sight=True)
    assert make_task("chase", unknown_maze="") == make_task("chase")
    assert make_task("chase", line_of_sight="evader,chaser_0") == make_task(
        "chase", line_of_sight=["chaser_0", "evader"]
    )
    assert asdict(by_name)["view_radius"] == {"chaser": 2, "evader_0": None}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"view_radius": -1}, "view_radius=-1; it is at least 0"),
        ({"view_radius": True}, "view_radius=True; give a path distance"),
        ({"view_radius": 1.5}, "view_radius=1.5; give a path distance"),
        ({"view_radius": "two"}, "view_radius='two'; give a path distance"),
        ({"view_radius": {"chaser": "x"}}, "view_radius of chaser='x'"),
        ({"view_radius": "chaser=1,chaser=2"}, "view_radius='chaser=1,chaser=2'; .* given twice"),
        ({"view_radius": "chaser="}, "view_radius='chaser='; give a role or agent and"),
        ({"view_radius": {"runner": 2}}, "view_radius of unknown agent 'runner'; one of"),
        ({"line_of_sight": 1}, "line_of_sight=1; give True for all"),
        ({"line_of_sight": "chaser,"}, "give True for all"),
        ({"unknown_maze": ("chaser", "evader_1")}, "unknown_maze of unknown agent 'evader_1'"),
        ({"maze": "HUGE", "view_radius": 2}, "at most 4096"),
    ],
)
def test_invalid_view_settings_are_refused(given: dict[str, Any], said: str) -> None:
    if given.get("maze") == "HUGE":
        walls = np.ones((64, 64), bool), np.ones((65, 63), bool)
        given = {**given, "maze": Maze(np.ones((65, 64), bool), *walls)}
    with pytest.raises(ValueError, match=said):
        make_task("chase", **given)


def test_replays_store_view_settings() -> None:
    world = ADAPTERS["maze"]
    task = Task(maze=(HALL, "3x3"), **CROWD, **LIMITS["mixed"])
    assert world.task(world.settings(task)).sight.limits == task.sight.limits
    assert "view_radius" not in world.settings(make_task("chase"))


@pytest.mark.parametrize("name", ["window:", "window:x", "window:-1", "window:1.5", "window:²"])
def test_invalid_windows_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"'{name}'; give window:R with a number R from 0"):
        chase_v0.parallel_env(maze="3x3", observation=name)
