"""Calls: which kernel a policy or an encoding is, and what it is given, said without a GPU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pursuit.task import Task


@dataclass(frozen=True, eq=False)
class Call:
    """One kernel over a batch of games.

    Attributes:
        entry: the kernel, as it is compiled for the CPU. What it is told of games, streams, epsilon
            and mazes it gets by the names that all kernels have for them.
        given: its other arguments by name: numbers, tuples of numbers, None, and arrays.
        writes: the argument with a row for each game that it fills.
        work: the room to work that each game needs: whose it is, as calls of one name share it, and
            its layers.
        rows: further arguments with a row for each game.
    """

    entry: Any
    given: Mapping[str, Any] = field(default_factory=dict)
    writes: str = "actions"
    work: tuple[str, int] = ("", 0)
    rows: tuple[str, ...] = ()


def call_of(policy: Any, task: Task, seat: int, mazes: Any) -> Call:
    """By which kernel a policy plays.

    Raises:
        ValueError: it does not play on a GPU.
    """
    on_its_own = getattr(policy, "on_device", None)
    if on_its_own is None:
        raise ValueError(
            f"{policy!r} in the seat of {task.agent_names[seat]} does not play on a GPU; take a "
            "scripted agent of full sight, a table, or device='cpu'"
        )
    call: Call = on_its_own(task, seat, mazes)
    return call
