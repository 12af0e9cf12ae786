"""What is no value of its kind is a ValueError with the value and the rule; nothing is changed."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated import TASKS

from pursuit.simulator import Simulator

# -- the simulator ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bad",
    [
        *({"num_games": wrong} for wrong in (0, -1, 2.0, "3", None, True, [1], 2**70)),
        *({"seed": wrong} for wrong in (-1, 2**64, 1.5, "1", None, False, [1], float("nan"))),
        *({"first_game": wrong} for wrong in (-1, 0.0, "a", None, 2**70)),
        *({"auto_restart": wrong} for wrong in (0, None, "yes")),
    ],
    ids=str,
)
def test_a_simulator_refuses_bad_counts_and_seeds(bad: dict[str, Any]) -> None:
    name, value = next(iter(bad.items()))
    with pytest.raises(ValueError, match=re.escape(f"{name}={value!r}"[:30])):
        Simulator(TASKS["chase"], **bad)


def test_a_batch_beyond_memory_is_refused_with_its_bytes() -> None:
    with pytest.raises(ValueError, match=r"=1000000000 needs \d+,000,000,000 bytes.*fewer"):
        Simulator(TASKS["chase"], 10**9)


@pytest.mark.parametrize(
    "wrong",
    [
        {"positions": np.full((3, 2), 25, dtype=np.int32)},
        {"positions": np.full((3, 2), -1, dtype=np.int32)},
        {"positions": np.zeros((3, 2))},
        {"goals": np.zeros((3, 1), dtype=np.int32)},
        {"maze_index": np.full(3, -1, dtype=np.int32)},
        {"maze_index": np.full(3, 1, dtype=np.int32)},
        {"steps": np.full(3, -1, dtype=np.int32)},
        {"epsilon": np.full((3, 2), np.inf)},
        {"next_epsilon": np.full((3, 2), 2.0)},
        {"next_maze": np.full(3, 1, dtype=np.int32)},
        {"next_num_goals": np.full(3, 1, dtype=np.int32)},
        {"next_goals_around_marks": np.full(3, 2, dtype=np.int32)},
        {"next_min_start_distance": np.full(3, 11, dtype=np.int32)},
        {"next_max_start_distance": np.full(3, 1, dtype=np.int32)},
        {"streams": np.zeros((3, 2), dtype=np.uint64)},
        {"terminated": None},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_a_state_that_cannot_be_is_refused_and_changes_nothing(wrong: dict[str, Any]) -> None:
    simulator = Simulator(TASKS["chase"], 3, seed=1)
    before = simulator.get_state()
    with pytest.raises(ValueError):
        simulator.set_state(replace(before, **wrong))
    after = simulator.get_state()
    for name in vars(before):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
