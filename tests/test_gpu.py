"""Games on a GPU, without one: kernels compile to PTX, and play as the CPU does in a simulator."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import device_games
import numba
import numpy as np
import pytest
from numba import cuda

from pursuit import rules
from pursuit.device import kernels, waiting
from pursuit.device.calls import Call
from pursuit.device.checks import check_task, choose_device
from pursuit.device.kernels import Batch, Launch
from pursuit.device.simulator import STEP_WORK
from pursuit.device.waiting import KEPT, Settings
from pursuit.maze_arrays import lay_out
from pursuit.rules import layout
from pursuit.rules.randomness import draw_uniform
from pursuit.simulator import Simulator
from pursuit.task import Rewards, Task, make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent, TablePolicy
from scripted_agents.table_kernels import play_pairs

SIMULATED = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore"}


def simulated(script: str, *arguments: str) -> None:
    """Run a script of this folder with Numba's simulator of a GPU, in a process of its own."""
    here = Path(__file__).parent
    paths = os.pathsep.join((str(here.parent), os.environ.get("PYTHONPATH", "")))
    process = subprocess.run(
        [sys.executable, str(here / script), *arguments],
        env={**os.environ, **SIMULATED, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert process.returncode == 0, process.stderr


@pytest.mark.parametrize(
    "names",
    [
        device_games.QUICK,
        pytest.param(
            [name for name in device_games.CASES if name not in device_games.QUICK],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_games_of_a_gpu_are_those_of_the_cpu_bit_for_bit(
    names: list[str], tmp_path: Path, without_tables: Callable[[], None]
) -> None:
    simulated("device_games.py", str(tmp_path / "games.npz"), *names)
    played = np.load(tmp_path / "games.npz")
    compared = 0
    for name in sorted(names, key=lambda name: -device_games.CASES[name].tables):  # these last
        if not device_games.CASES[name].tables:
            without_tables()
        for key, expected in device_games.play(name, "cpu").items():
            found = played[key]
            assert (found.dtype, found.shape) == (expected.dtype, expected.shape), key
            assert found.tobytes() == expected.tobytes(), key
            compared += 1
    assert compared == len(played.files)


# -- PTX -------------------------------------------------------------------------------------------


@pytest.fixture
def compiles(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """What compiles a call on games of a task for a GPU that is not there; gives the PTX."""
    pytest.importorskip("numba_cuda", reason="no numba-cuda; `pip install pursuit[gpu]`")
    from numba.cuda import compiler, dispatcher

    # A function compiled for the CPU that a kernel calls asks the device what it is capable of.
    device = SimpleNamespace(compute_capability=(9, 0))
    for module in (compiler, dispatcher):
        monkeypatch.setattr(module, "get_current_device", lambda: device)
    monkeypatch.setattr(kernels.cuda, "to_device", np.array)

    def compiled(
        task: Task, call: Call, of_seat: bool = False, of_member: bool = False, **late: Any
    ) -> str:
        memory = Simulator(task, 4)._kernel_arrays[: len(layout.Memory._fields)]
        batch = Batch(layout.Memory(*memory), lay_out(task.mazes), task.max_cells)
        launch = Launch(call, batch, of_seat=of_seat, chosen=of_member)
        given = {"actions": np.zeros((4, task.num_agents), np.int32), **late}
        signature = tuple(numba.typeof(value) for value in launch.arguments(**given))
        ptx, _ = cuda.compile_ptx(launch._kernel.py_func, signature, cc=(9, 0))
        assert ".target sm_90" in ptx and ".entry" in ptx
        return str(ptx)

    yield compiled


def call_of_step(task: Task) -> Call:
    numbers = {"numbers": task.numbers_for_kernels(), "pay": task.rewards_for_kernels()}
    return Call(rules.step_games_of(task.teams), numbers, "actions", STEP_WORK)


def test_a_step_compiles_to_ptx(compiles: Any) -> None:
    task = make_task("chase")
    compiles(task, call_of_step(task), auto_restart=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["maze", "race", "heist"])
def test_steps_and_starts_of_every_task_compile_to_ptx(compiles: Any, name: str) -> None:
    task = make_task(name, stay_action=True, move_order="chasers_first")
    step = call_of_step(task)
    compiles(task, step, auto_restart=False)
    start = Call(rules.start_games, step.given, "chosen", STEP_WORK)
    compiles(task, start, chosen=np.ones(4, dtype=bool))


@pytest.mark.slow
def test_every_agent_that_plays_on_a_gpu_compiles_to_ptx(compiles: Any) -> None:
    check_agents_compile(compiles, "3x3")


@pytest.mark.slow
def test_agents_that_search_by_landmarks_compile_to_ptx(
    compiles: Any, without_tables: Callable[[], None]
) -> None:
    without_tables()
    task = check_agents_compile(compiles, "5x5")
    assert not lay_out(task.mazes).tables.size
    step = call_of_step(task)
    compiles(task, step, auto_restart=False)
    start = Call(rules.start_games, step.given, "chosen", STEP_WORK)
    compiles(task, start, chosen=np.ones(4, dtype=bool))


def check_agents_compile(compiles: Any, maze: str) -> Task:
    task = make_task("chase", maze=maze)
    cells = task.max_cells
    table = TablePolicy(task.mazes[0], np.full((cells, cells, 4), 0.25))
    for seat, policy in ((0, AStarChaser()), (1, AStarEvader(0.1)), (1, RandomAgent()), (1, table)):
        call = policy.on_device(task, seat, lay_out(task.mazes))
        compiles(task, call, of_seat=True, seat=seat)
    task = make_task("maze", maze=maze)
    compiles(task, NearestGoalRunner().on_device(task, 0, lay_out(task.mazes)), of_seat=True)
    return task


@pytest.mark.slow
def test_what_waits_for_the_next_episodes_compiles_to_ptx(compiles: Any) -> None:
    task = make_task("heist", maze="3x3")
    settings = Settings(task, 3)
    given = {"numbers": settings.numbers, "shares": settings.shares}
    rows = np.zeros(4, dtype=np.int32)
    compiles(task, Call(waiting.take_settings, writes="rows"), rows=rows, **given)
    compiles(task, Call(waiting.take_seeds, writes="seeds"), seeds=np.zeros(4, dtype=np.int64))
    compiles(task, Call(waiting.take_epsilon, writes="shares"), shares=np.zeros((4, 2)))


@pytest.mark.slow
def test_the_opponents_of_a_pool_compile_to_ptx(compiles: Any) -> None:
    task = make_task("chase", maze="3x3")
    drawn, draws = np.zeros(4, dtype=np.int32), np.zeros(4)
    given = {"table_of": drawn, "draws": draws, "cumulative": np.zeros((3, 81, 4)), "seat": 1}
    tables = Call(play_pairs, {"num_cells": 9}, "actions", rows=("table_of", "draws"))
    compiles(task, tables, of_seat=True, **given)
    draw = Call(waiting.draw_where, {"stream": 2}, "numbers", rows=("wanted",))
    compiles(task, draw, wanted=np.ones(4, dtype=bool), numbers=draws)
    for policy in (AStarEvader(0.1), RandomAgent()):
        call = policy.on_device(task, 1, lay_out(task.mazes))
        compiles(task, call, of_seat=True, of_member=True, seat=1, drawn=drawn, member=2)
    compiles(task, Call(draw_uniform, {"stream": 2}, "numbers"), numbers=draws)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [{}, {"view_radius": 1, "unknown_maze": True}])
@pytest.mark.parametrize(
    "encoding", ["index", "one_hot", "positions", "cells", "walls", "planes", "window"]
)
def test_every_encoding_compiles_to_ptx(compiles: Any, encoding: str, limits: Any) -> None:
    task = make_task("heist", maze="3x3", **limits)
    encoder = Simulator(task).encoder(encoding)
    out = np.zeros((4, task.num_agents, *encoder.flat_shape), encoder.dtype)
    for call in encoder.calls():
        compiles(task, call, out=out, flat=out.reshape(4, task.num_agents, -1))


# -- what is refused -------------------------------------------------------------------------------


def test_without_a_gpu_the_error_says_so() -> None:
    if cuda.is_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ValueError, match=r"no GPU here; take device='cpu'"):
        Simulator(make_task("chase"), device="cuda")
    for name in ("tpu", "cuda1", "cuda:", "cuda:x"):
        with pytest.raises(ValueError, match="give cpu, cuda"):
            choose_device(name)


def test_a_task_that_a_gpu_would_pay_otherwise_is_refused() -> None:
    def paid(before: Any, actions: Any, after: Any) -> Any:
        return after.rewards

    check_task(make_task("chase", rewards="distance"))
    with pytest.raises(ValueError, match="function of Python"):
        check_task(make_task("chase", rewards=paid))
    # Found by trial: at distance 3 the sum lies between two numbers of float32.
    pay = Rewards(step=-1.6986417481574838, distance=0.8995472692540429)
    with pytest.raises(ValueError, match="rounded otherwise on a GPU at distance 3"):
        check_task(make_task("chase", rewards={"chaser": pay}))


# -- what waits for the next episodes --------------------------------------------------------------


def test_rows_of_settings_hold_what_a_simulator_would_be_told_and_nothing_else() -> None:
    task = make_task("heist", maze="5x5", num_goals=3)
    simulator, settings = Simulator(task, 4), Settings(task, 4)
    before = simulator.get_state()
    for told in (simulator, settings):
        told.configure([0, 2], epsilon=[0.25, 0.5], seat="chaser_0")
        told.configure(goal_radius=[1, 2, 3, 4], goals_around="start")
        with pytest.raises(ValueError, match="num_goals"):
            told.configure(num_goals=4)
    after, coming = simulator.get_state(), layout.NextEpisode._fields
    numbers = dict(zip(coming[:-1], settings.numbers, strict=True))
    for name, row in numbers.items():
        if name in ("goal_radius", "goals_around_marks"):
            np.testing.assert_array_equal(row, getattr(after, f"next_{name}"))
        else:
            assert (row == KEPT).all(), name
    np.testing.assert_array_equal(settings.shares, after.next_epsilon)
    assert (before.next_epsilon == layout.UNCHANGED).all()
    assert not settings.distances
    settings.configure(max_start_distance=2)
    assert settings.distances
