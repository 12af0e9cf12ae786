"""Work that is the same every time, captured once as a CUDA graph and then replayed.

A graph launches kernels again with the memory and the numbers that they had when it was captured.
So what is captured is a function of nothing that

- finds what differs from call to call in tensors that stay where they are (`Inputs`),
- waits for nothing, and reads nothing on the CPU,
- gives tensors, which the next replay overwrites.

Nobody could run this on a GPU yet. So a graph is used only after its first replay has done what the
function itself does from the same memory and random numbers; and whatever stands against it, the
function goes on to be called, with a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import torch
from torch.utils._pytree import tree_leaves, tree_map

Function = Callable[[], Any]
"""Gives tensors in dicts, lists and tuples."""

APART = 0.1
"""Of what a function changes, how far a replay may be from it: sums are taken in another order."""
FEW = 0.02
"""The share of whole numbers that may be others: where rounding changed which action was drawn."""
MOST_NEW = 4
"""Memory that is new so many times in a row is never going to stay."""
WAITED = "called a synchronizing CUDA operation"
"""How torch says so, where it is asked to (`torch.cuda.set_sync_debug_mode`)."""
PROTOTYPE = "Synchronization debug mode is a prototype"
"""What it says of that."""


class Graphs(Protocol):
    """Who captures; the tests have one that needs no GPU."""

    def run(self, function: Function) -> tuple[Any, str | None]:
        """Call it as it is; what it gives, and what in it waited for the GPU, if anything did."""

    def capture(self, function: Function) -> tuple[Callable[[], None], Any]:
        """Capture it, which runs nothing: what replays it, and the tensors that this fills.

        Any exception where it cannot be captured.
        """

    def random_state(self) -> Any:
        """Of the generator that is drawn from."""

    def set_random_state(self, state: Any) -> None:
        """Put it back."""


class CudaGraphs:
    """CUDA graphs by torch, on one GPU; a `Graphs`."""

    def __init__(self, device: str) -> None:
        self._device = torch.device(device)

    @cached_property
    def _side(self) -> torch.cuda.Stream:
        return torch.cuda.Stream(self._device)  # type: ignore[no-untyped-call]

    def run(self, function: Function) -> tuple[Any, str | None]:
        """As `Graphs`: in the stream that it will be captured in.

        Libraries take the room that they need when they are first called in a stream.
        """
        here, mode = torch.cuda.current_stream(self._device), torch.cuda.get_sync_debug_mode()
        self._side.wait_stream(here)
        with warnings.catch_warnings(record=True) as noted, torch.cuda.stream(self._side):
            warnings.simplefilter("always")
            torch.cuda.set_sync_debug_mode("warn")
            try:
                found = function()
            finally:
                torch.cuda.set_sync_debug_mode(mode)
        here.wait_stream(self._side)
        waited = None
        for one in noted:
            if WAITED in str(one.message):
                waited = waited or f"it waits for the GPU ({one.filename}:{one.lineno})"
            elif PROTOTYPE not in str(one.message):
                warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)
        return found, waited

    def capture(self, function: Function) -> tuple[Callable[[], None], Any]:
        """As `Graphs`."""
        from pursuit.device.checks import nothing_freed

        graph, side, cached = torch.cuda.CUDAGraph(), self._side, torch.is_autocast_cache_enabled()
        # Weights that were cast before would be those of that time in every replay.
        torch.set_autocast_cache_enabled(False)
        try:
            # Where a capture breaks off, torch leaves its stream the current one.
            with nothing_freed(), torch.cuda.stream(side), torch.cuda.graph(graph, stream=side):
                found = function()
        except Exception:
            self._mend_generator()
            raise
        finally:
            torch.set_autocast_cache_enabled(cached)
        return graph.replay, found

    def _mend_generator(self) -> None:
        """A capture that breaks off may leave the generator as if it still went on."""
        try:
            torch.rand(1, device=self._device)
        except RuntimeError:
            current = self._device.index
            number = torch.cuda.current_device() if current is None else current
            generator = torch.cuda.default_generators[number]
            generator.graphsafe_set_state(generator.clone_state())

    def random_state(self) -> torch.Tensor:
        """As `Graphs`."""
        return torch.cuda.get_rng_state(self._device)

    def set_random_state(self, state: torch.Tensor) -> None:
        """As `Graphs`."""
        torch.cuda.set_rng_state(state, self._device)


class Inputs:
    """Tensors by name that stay where they are, for what differs from call to call."""

    def __init__(self) -> None:
        self.columns: dict[str, torch.Tensor] = {}

    def take(self, columns: Mapping[str, torch.Tensor]) -> None:
        """Copy these in. Of other names, shapes or types than before the tensors are new."""
        if forms_of(columns) != forms_of(self.columns):
            self.columns = {name: column.clone() for name, column in columns.items()}
            return
        for name, column in columns.items():
            self.columns[name].copy_(column)


def forms_of(columns: Mapping[str, torch.Tensor]) -> dict[str, tuple[torch.Size, torch.dtype]]:
    """The shapes and types of columns."""
    return {name: (column.shape, column.dtype) for name, column in columns.items()}


class Repeated:
    """A function of nothing, called once as it is, and from the second call on as a graph.

    Args:
        name: of the work, for the warning where it has no graph.
        function: the work.
        changes: all tensors that it changes, beside what it gives.
        depends: what else its launches depend on; with anything new it is captured anew. What this
            is, is asked before every call.
        graphs: who captures.

    Attributes:
        refused: why there is no graph and will be none; None as long as there may be one.
        replays: so far.
    """

    def __init__(
        self,
        name: str,
        function: Function,
        changes: Callable[[], Sequence[torch.Tensor]],
        depends: Callable[[], Hashable],
        graphs: Graphs,
    ) -> None:
        self.name, self._function = name, function
        self._changes, self._depends, self._graphs = changes, depends, graphs
        self.refused: str | None = None
        self.replays = self._new = 0
        self._key: Hashable = None
        self._replay: Callable[[], None] | None = None
        self._found: Any = None

    def refuse(self, reason: str) -> None:
        """Call the function as it is from now on."""
        self.refused, self._replay, self._found = reason, None, None
        warnings.warn(f"{self.name} goes on without CUDA graphs: {reason}", stacklevel=2)

    def __call__(self) -> Any:
        """What the function gives; tensors that the next call may overwrite."""
        if self.refused is not None:
            return self._function()
        if self._key is None or self._key != self._now():
            return self._run()
        if self._replay is None:
            return self._begin()
        self._replay()
        self.replays += 1
        return self._found

    def _now(self) -> Hashable:
        return tuple(one.data_ptr() for one in self._changes()), self._depends()

    def _run(self) -> Any:
        """Call it as it is, for the first time with this memory."""
        self._replay, self._found = None, None
        found, waited = self._graphs.run(self._function)
        self._key, self._new = self._now(), self._new + 1
        if waited is not None:
            self.refuse(waited)
        elif self._new >= MOST_NEW:
            self.refuse("what it works on does not stay the same")
        return found

    def _begin(self) -> Any:
        """Call it, and capture it, and see that a replay does the same."""
        graphs, changes = self._graphs, self._changes()
        before, drawn = copied(changes), graphs.random_state()
        expected = tree_map(copy_of, self._function())
        after, drawn_after = copied(changes), graphs.random_state()
        put(changes, before)
        graphs.set_random_state(drawn)
        try:
            replay, found = graphs.capture(self._function)
            replay()
            given = [one for one in tree_leaves(expected) if isinstance(one, torch.Tensor)]
            filled = [one for one in tree_leaves(found) if isinstance(one, torch.Tensor)]
            blank = [torch.zeros_like(one) for one in given]
            reason = None
            if not same([*before, *blank], [*after, *given], [*changes, *filled]):
                reason = "a replay does not do what was captured"
        except Exception as error:  # whatever it is, training can go on
            reason = told(error)
        if reason is None:
            self._replay, self._found, self._new = replay, found, 0
            self.replays += 1
            return found
        put(changes, after)
        graphs.set_random_state(drawn_after)
        self.refuse(reason)
        return expected


def told(error: BaseException) -> str:
    """The error that came first, in a line: a capture that broke off raises others after it."""
    while error.__context__ is not None:
        error = error.__context__
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def copy_of(one: Any) -> Any:
    """Of a tensor a copy, of anything else itself."""
    return one.detach().clone() if isinstance(one, torch.Tensor) else one


def copied(tensors: Sequence[torch.Tensor]) -> list[torch.Tensor]:
    """Copies of all of them."""
    return [copy_of(one) for one in tensors]


@torch.no_grad()
def put(tensors: Sequence[torch.Tensor], copies: Sequence[torch.Tensor]) -> None:
    """Write copies back."""
    for one, copy in zip(tensors, copies, strict=True):
        one.copy_(copy)


@torch.no_grad()
def same(
    before: Sequence[torch.Tensor], after: Sequence[torch.Tensor], found: Sequence[torch.Tensor]
) -> bool:
    """Whether what was `before` became as good as what it became otherwise, `after`.

    Numbers may be APART from it, and FEW whole ones be others; NaN is the same as NaN alone.
    """
    near = [len(after) == len(found)]
    for old, one, other in zip(before, after, found, strict=False):
        differs = (one != other) & ~(one.isnan() & other.isnan())
        if one.is_floating_point():
            apart = torch.where(differs, other - one, 0.0).double().norm()
            changed = torch.where(old != one, old - one, 0.0).double().nan_to_num().norm()
            near.append(bool(apart <= APART * changed))
        else:
            near.append(bool(differs.sum() <= FEW * one.numel()))
    return all(near)
