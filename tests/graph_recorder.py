"""A recorder that captures as a CUDA graph does, on the CPU: a `train.algorithms.graphs.Graphs`.

While it captures it notes every operation of torch and every kernel of Numba's simulator of a GPU,
with the very memory and the very numbers that it was called with. A replay does the same operations
again, on that memory. As with a CUDA graph

- numbers of Python are those of the capture for ever;
- capturing changes nothing: memory is put back to what it was, the generator too, and what was made
  in the capture holds rubbish until the first replay;
- whatever would wait for the GPU, or read or copy anything on the CPU, is an error;
- memory that the graph reads and that nobody else keeps any more is an error in a replay (a GPU
  would read what lies there then).

What it cannot know: where tensors of a GPU and of the CPU meet, as all are on the CPU here, and how
a real capture goes about streams and memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest import mock

import numpy as np
import torch
from numba import config, cuda
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes
from torch.utils._pytree import tree_leaves, tree_map

from pursuit.device.kernels import Launch

WAITS = {
    "_local_scalar_dense",
    "bincount",
    "equal",
    "is_nonzero",
    "item",
    "masked_select",
    "nonzero",
    "unique_consecutive",
    "unique_dim",
    "_unique2",
    "lift_fresh",  # torch.tensor(...): numbers of the CPU
}
ON_THE_CPU = ("numpy", "tolist", "item", "cpu", "pin_memory", "__array__", "__bool__", "__float__")
RUBBISH = 0x5A
numpy_of = torch.Tensor.numpy


class Refused(RuntimeError):
    """What a capture may not do."""


class Recorder:
    """See above.

    Attributes:
        graphs: captured so far.
    """

    def __init__(self) -> None:
        self.graphs: list[Recording] = []

    def run(self, function: Callable[[], Any]) -> tuple[Any, str | None]:
        return function(), None

    def capture(self, function: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
        recording, drawn = Recording(), torch.get_rng_state()
        try:
            with recording, only_on_the_gpu(recording):
                found = function()
        finally:
            torch.set_rng_state(drawn)
            recording.put_back()
        self.graphs.append(recording)
        return recording.replay, found

    def random_state(self) -> torch.Tensor:
        return torch.get_rng_state()

    def set_random_state(self, state: torch.Tensor) -> None:
        torch.set_rng_state(state)


def bytes_of(one: torch.Tensor) -> torch.Tensor:
    """All bytes of the memory that a tensor lies in, shared."""
    whole = torch.empty(0, dtype=torch.uint8)
    return whole.set_(one.untyped_storage(), 0, (one.untyped_storage().nbytes(),))


class Recording(TorchDispatchMode):
    """One graph: operations in their order.

    Attributes:
        replays: so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.replays = 0
        self.steps: list[Callable[[], None]] = []
        self._kept: dict[int, torch.Tensor] = {}  # by address of memory: its bytes
        self._own: set[int] = set()  # memory that was made in the capture
        self._ours: dict[
            int, int
        ] = {}  # of memory from outside: how many tensors of ours are there
        self._before: dict[int, torch.Tensor] = {}  # of memory from outside that is written to
        self._arrays: dict[int, tuple[Any, np.ndarray]] = {}

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        kwargs = kwargs or {}
        self._check(func, args, kwargs)
        given = [one for one in tree_leaves((args, kwargs)) if isinstance(one, torch.Tensor)]
        for one in given:
            self._know(one)
        for argument, value in self._by_argument(func, args, kwargs):
            if argument.alias_info is not None and argument.alias_info.is_write:
                for one in tree_leaves(value):
                    if isinstance(one, torch.Tensor):
                        self._save(one)
        found = func(*args, **kwargs)
        theirs = {one.untyped_storage().data_ptr() for one in given}
        made = []
        for one in tree_leaves(found):
            address = one.untyped_storage().data_ptr() if isinstance(one, torch.Tensor) else 0
            fresh = isinstance(one, torch.Tensor) and address not in theirs
            if fresh:
                self._own.add(address)
                self._kept[address] = bytes_of(one)
            made.append(one.detach() if fresh else None)
        writes = any(
            a.alias_info is not None and a.alias_info.is_write for a in func._schema.arguments
        )
        if writes or any(one is not None for one in made):
            args, kwargs = tree_map(self._alias, (args, kwargs))
            self.steps.append(lambda: self._again(func, args, kwargs, made))
        return found

    @staticmethod
    def _again(func: Any, args: Any, kwargs: Any, made: list[torch.Tensor | None]) -> None:
        again = tree_leaves(func(*args, **kwargs))
        for old, new in zip(made, again, strict=True):
            if old is not None:
                old.copy_(new)

    @staticmethod
    def _by_argument(func: Any, args: Any, kwargs: Any) -> Iterator[tuple[Any, Any]]:
        for number, argument in enumerate(func._schema.arguments):
            if number < len(args):
                yield argument, args[number]
            elif argument.name in kwargs:
                yield argument, kwargs[argument.name]

    def _check(self, func: Any, args: Any, kwargs: Any) -> None:
        name = func._schema.name.removeprefix("aten::")
        if name in WAITS:
            raise Refused(f"{name} waits for the GPU, or copies to it")
        if kwargs.get("generator") is not None:
            raise Refused(f"{name} draws from a generator that is not the default one")
        if name.startswith(("index", "_index_put", "_unsafe_index")) and name != "index_select":
            for one in tree_leaves(args[1]):
                if isinstance(one, torch.Tensor) and one.dtype in (torch.bool, torch.uint8):
                    raise Refused(f"{name} by a mask waits for the GPU")

    def _know(self, one: torch.Tensor) -> None:
        """Keep the memory of a tensor from being taken for another."""
        storage = one.untyped_storage()
        if storage.data_ptr() in self._own:
            return
        # Two storages may share memory: tensors over one array of NumPy.
        ours = self._ours.setdefault(storage._cdata, [storage, 0])
        if storage.data_ptr() not in self._kept:
            self._kept[storage.data_ptr()] = bytes_of(one)
            ours[1] += 1

    def _alias(self, one: Any) -> Any:
        """A tensor of ours in the same memory, which does not keep the caller's alive."""
        if not isinstance(one, torch.Tensor):
            return one
        storage = one.untyped_storage()._cdata
        if storage in self._ours:
            self._ours[storage][1] += 1
        return one.detach()

    def _save(self, one: torch.Tensor) -> None:
        address = one.untyped_storage().data_ptr()
        if address not in self._own and address not in self._before:
            self._before[address] = self._kept[address].clone()

    def launch(self, launch: Launch, late: dict[str, Any]) -> None:
        """A kernel, with all that it is given now."""
        arguments = launch.arguments(**late)
        for one in arguments:
            if isinstance(one, np.ndarray):
                raise Refused("a kernel is given an array of the CPU")
            if hasattr(one, "_ary") and id(one) not in self._arrays:
                self._arrays[id(one)] = one, one._ary.copy()
                # Where torch wrote to it before, that was noted already.
                address = one._ary.__array_interface__["data"][0]
                if address in self._before:
                    saved = numpy_of(self._before[address])[: one._ary.nbytes]
                    self._arrays[id(one)][1][...] = saved.view(one._ary.dtype).reshape(
                        one._ary.shape
                    )
        threads = min(128, launch._batch.num_games)
        blocks = -(-launch._batch.num_games // threads)
        kernel = launch._kernel[blocks, threads]
        kernel(*arguments)
        self.steps.append(lambda: kernel(*arguments))

    def put_back(self) -> None:
        """As if nothing had been done: a capture runs nothing."""
        for address, before in self._before.items():
            self._kept[address].copy_(before)
        for array, before in self._arrays.values():
            array._ary[...] = before
        for address in self._own:
            self._kept[address].fill_(RUBBISH)
        self._before, self._arrays = {}, {}

    @torch.no_grad()
    def replay(self) -> None:
        self.replays += 1
        for storage, ours in self._ours.values():
            # The object `storage` keeps the memory as well.
            others = torch._C._storage_Use_Count(storage._cdata) - ours - 1
            assert others > 0, "the graph reads memory that nobody keeps any more"
        for step in self.steps:
            step()


@contextmanager
def only_on_the_gpu(recording: Recording) -> Iterator[None]:
    """Refuse whatever reads, copies or waits on the CPU, and note kernels."""

    def refused(name: str) -> Any:
        def refuse(*_: Any, **__: Any) -> Any:
            raise Refused(f"{name} reads or copies on the CPU")

        return refuse

    def launched(self: Launch, **late: Any) -> None:
        with _disable_current_modes():
            recording.launch(self, late)

    refusals: list[tuple[Any, tuple[str, ...]]] = [
        (torch.Tensor, ON_THE_CPU),
        (torch, ("from_numpy", "as_tensor")),
    ]
    if config.ENABLE_CUDASIM:
        array = type(cuda.to_device(np.zeros(1)))
        refusals += [
            (cuda, ("synchronize", "to_device")),
            (array, ("copy_to_host", "copy_to_device")),
        ]
    with ExitStack() as around:
        for of, names in refusals:
            around.enter_context(mock.patch.multiple(of, **{name: refused(name) for name in names}))
        around.enter_context(mock.patch.object(Launch, "__call__", launched))
        yield
