"""The same text of the rules compiles for a GPU; none is needed to see that."""

from types import SimpleNamespace

import numba
import numpy as np
import pytest

from pursuit.rules import layout
from pursuit.rules.step import step
from pursuit.simulator import Simulator
from pursuit.task import make_task

pytest.importorskip("numba_cuda", reason="numba-cuda is not installed; `pip install pursuit[gpu]`")
from numba import cuda
from numba.cuda import compiler, dispatcher


def kernel(
    agents, goals, clocks, coming, reals, flags, rewards, streams, numbers, pay, mazes, neighbors,
    facts, tables, scratch, actions,
):  # fmt: skip
    """A step of every game, one game a thread, each with room of its own for its plan."""
    game = cuda.grid(1)
    if game < actions.shape[0]:
        memory = layout.Memory(agents, goals, clocks, coming, reals, flags, rewards, streams)
        rules = layout.rules_of(layout.teams_of(numbers), numbers, pay)
        world = layout.world_of(mazes, neighbors, facts, tables)
        games, outcome = layout.games_of(memory), layout.outcome_of(memory)
        step(games, game, actions, rules, world, layout.plan_of(scratch[game]), outcome)


def test_a_kernel_that_calls_the_step_compiles_to_ptx(monkeypatch: pytest.MonkeyPatch) -> None:
    # A function compiled for the CPU that a kernel calls asks the device what it is capable of.
    device = SimpleNamespace(compute_capability=(9, 0))
    for module in (compiler, dispatcher):
        monkeypatch.setattr(module, "get_current_device", lambda: device)
    simulator = Simulator(make_task("heist"))
    *arrays, scratch = simulator._kernel_arrays
    arguments = (*arrays, scratch[None], np.zeros((1, 2), dtype=np.int32))
    signature = tuple(numba.typeof(argument) for argument in arguments)
    ptx, _ = cuda.compile_ptx(kernel, signature, cc=(9, 0))
    assert ".target sm_90" in ptx and ".entry" in ptx
