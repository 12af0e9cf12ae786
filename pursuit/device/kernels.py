"""Kernels for the GPU, made of those for the CPU: one text.

A kernel of the CPU is a loop over a batch of games. Game i does not depend on the batch that it is
in; so a thread of the GPU calls the same kernel with game i as a batch of one, by views of the
arrays. What is written here is that call, put together by the names of the kernel's arguments (a
kernel of the GPU cannot take `*args`); numba-cuda compiles it with all that it calls.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numba import cuda

from pursuit.device.calls import Call
from pursuit.maze_arrays import MazeArrays
from pursuit.rules import layout
from pursuit.rules.layout import Memory

THREADS = 128
"""Threads of a block."""

OF_GAMES = {name: f"games.{name}" for name in layout.Games._fields}
OF_MEMORY = {name: f"own.{name}" for name in Memory._fields}
OF_GAME = {
    **OF_GAMES,
    "maze_of": "games.maze",
    **OF_MEMORY,
    "goals_": "own.goals",
    "epsilon_of": "own.reals[:, EPSILON]",
    "scratch": "scratch[:, :, game]",
}
"""What a thread gives for the arguments of these names, which mean the same in all kernels."""

TEXT = """
def kernel({parameters}):
    game = cuda.grid(1)
    if game < num_games{condition}:
        own = Memory(
            agents[game:game + 1], goals[game:game + 1], clocks[game:game + 1],
            coming[:, game:game + 1], reals[game:game + 1], flags[:, game:game + 1],
            rewards[game:game + 1], streams[game:game + 1],
        )
        games = {games}
        {call}
"""


@lru_cache(maxsize=256)
def parts_of(
    entry: Any,
    written: str,
    absent: frozenset[str],
    final: bool,
    of_each: tuple[str, ...] = (),
    chosen: bool = False,
) -> tuple[Any, tuple[str, ...]]:
    """The function of a thread that calls `entry`, and its parameters after those of the games.

    Args:
        entry: a kernel of the CPU. One that has `columns`, those of the actions of all agents that
            it fills, finds those of a seat by itself.
        written: the argument that has a row for each game; of one seat's actions "seat's actions".
        absent: arguments that are None.
        final: whether the games are those that have ended, as they ended.
        of_each: further arguments that have a row for each game.
        chosen: whether only the games are meant whose `drawn` is `member`.
    """
    function = getattr(entry, "py_func", entry)
    names = list(inspect.signature(function).parameters)
    of_seat = written == "seat's actions" and "columns" not in names
    written = written.removeprefix("seat's ")
    column = ", seat]" if of_seat else "]"
    meanings = {
        **OF_GAME,
        **{name: f"{name}[game:game + 1]" for name in of_each},
        written: f"{written}[game:game + 1{column}",
        **dict.fromkeys(absent, "None"),
    }
    known = {*OF_GAMES, *OF_MEMORY, "maze_of", "goals_", "epsilon_of", *absent} - {written}
    rest = tuple(name for name in names if name not in known)
    call = f"entry({', '.join(meanings.get(name, name) for name in names)})"
    if function.__annotations__.get("return") == "int":  # what happened, which is OK, or is noted
        call = f"found = {call}\n        if found != 0:\n            notes[found] = 1"
        rest = (*rest, "notes")
    if chosen:
        rest = (*rest, "drawn", "member")
    parameters = ", ".join(("num_games", *Memory._fields, *rest))
    games = "outcome_of(own).final" if final else "games_of(own)"
    scope = {
        "cuda": cuda,
        "entry": entry,
        "Memory": Memory,
        "games_of": layout.games_of,
        "outcome_of": layout.outcome_of,
        "EPSILON": layout.EPSILON,
        "__name__": __name__,
    }
    condition = " and drawn[game] == member" if chosen else ""
    text = TEXT.format(parameters=parameters, condition=condition, games=games, call=call)
    exec(compile(text, f"<{function.__name__}, one game a thread>", "exec"), scope)
    return scope["kernel"], rest


@lru_cache(maxsize=256)
def _compiled(*what: Any) -> Any:
    function, rest = parts_of(*what)
    return cuda.jit(function), rest


class Batch:
    """The arrays of a batch of games on the device, and what kernels are given beside them.

    Args:
        memory: of the games, on the host; copied.
        mazes: likewise.
        room: the width of the room to work that a game has.

    Attributes:
        memory: on the device.
        stream: of the device, in which all kernels run; 0 is the default one.
        notes: [codes] int32 on the device, 1 where a kernel returned that code for any game.
    """

    def __init__(self, memory: Memory, mazes: MazeArrays, room: int) -> None:
        self.num_games = len(memory.clocks)
        self.memory = Memory(*(cuda.to_device(array) for array in memory))
        self.mazes = {name: cuda.to_device(array) for name, array in mazes._asdict().items()}
        self.notes = cuda.to_device(np.zeros(3, dtype=np.int32))
        self.stream: Any = 0
        self._room, self._scratch = room, dict[tuple[str, int], Any]()

    def scratch(self, work: tuple[str, int]) -> Any:
        """Room to work, [layers, room, games] int32, -1 at first; one for each `Call.work`.

        Neighbouring threads find theirs side by side.
        """
        if work not in self._scratch:
            room = np.full((work[1], self._room, self.num_games), -1, dtype=np.int32)
            self._scratch[work] = cuda.to_device(room)
        return self._scratch[work]


class Launch:
    """A `Call` on one batch: what it is given lies on the device, and it can be run at any time.

    Args:
        call: what to run.
        batch: on what.
        final: whether on the games that have ended, as they ended.
        of_seat: whether "actions" are those of all agents, of which it fills the seat's.
        chosen: whether only on the games whose `drawn` ([games] int32) is `member`, which are said
            at each call.
    """

    def __init__(
        self,
        call: Call,
        batch: Batch,
        final: bool = False,
        of_seat: bool = False,
        chosen: bool = False,
    ) -> None:
        absent = frozenset(name for name, value in call.given.items() if value is None)
        written = f"seat's {call.writes}" if of_seat else call.writes
        self._kernel, names = _compiled(call.entry, written, absent, final, call.rows, chosen)
        self._batch, self._names = batch, names
        known: dict[str, Any] = {**batch.mazes, "notes": batch.notes}
        if call.work[1]:
            known["scratch"] = batch.scratch(call.work)
        for name, value in call.given.items():
            known[name] = cuda.to_device(value) if isinstance(value, np.ndarray) else value
        self._known: Mapping[str, Any] = known

    def arguments(self, **late: Any) -> tuple[Any, ...]:
        """All that the kernel takes; `late` is what is said at each call."""
        batch, given = self._batch, {**self._known, **late}
        return (batch.num_games, *batch.memory, *(given[name] for name in self._names))

    def __call__(self, **late: Any) -> None:
        """Run it, in the stream of the batch; nobody waits for it."""
        batch = self._batch
        threads = min(THREADS, batch.num_games)
        blocks = -(-batch.num_games // threads)
        self._kernel[blocks, threads, batch.stream](*self.arguments(**late))
