"""Compilation of kernels by Numba, with an on-disk cache that notices every change.

A kernel may call kernels of any file of the project: the stamp of its cache entry follows the
imports of its file (`pursuit.compilation.kernel_cache`). What kernels call is neither optimised nor
made machine code by itself, only as a part of the kernels that it ends in (`_Part`): that halves
the time of a first use.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba import _dynfunc
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from pursuit.compilation.kernel_cache import PACKAGES, KernelCache

ANY_ORDER = {"reassoc", "contract"}
"""What LLVM may do with sums of floating-point numbers: take them in any order, and fuse them with
products."""

TRIED = numba.__version__.startswith("0.68.")
"""Whether this is a Numba that `_PartCompiler` is written for; with any other, what kernels call is
compiled as Numba does, which takes twice as long."""

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` with Numba on first use and keep the machine code on disk.

    The kernel must not allocate: it works on the arrays that it is given, without Numba's reference
    counts (which, left in, took two thirds of the time of a step). See `allocating`.
    """
    return _entry(function, _nrt=False)


def summing(function: Function) -> Function:
    """`compiled`, where sums may be taken in any order, and so by vector instructions.

    What is not finite goes through as it is. The order is settled when the kernel is compiled: the
    same sums come out on the same processor.
    """
    return _entry(function, _nrt=False, fastmath=ANY_ORDER)


def merged_sums(function: Function) -> Function:
    """`inlined`, into kernels that are `summing`."""
    return _part(function, forceinline=True, fastmath=ANY_ORDER)


def subroutine(function: Function) -> Function:
    """`compiled`, for kernels to call, not for Python: it needs no wrapper, which takes seconds."""
    return _part(function)


def inlined(function: Function) -> Function:
    """A `subroutine` merged into every kernel that calls it, so that constants reach its loops."""
    return _part(function, forceinline=True)


def allocating(function: Function) -> Function:
    """Like `compiled`, for a kernel that makes arrays of its own, and so counts references.

    It must call nothing that returns arrays (`layout.world_of` and the like): kernels that do not
    count would hand it uncounted ones, which it would free.
    """
    return _entry(function)


def _entry(function: Function, **options: Any) -> Function:
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    if dispatcher is not function:  # as it is with NUMBA_DISABLE_JIT=1
        dispatcher._cache = KernelCache(function)
    return dispatcher


def _part(function: Function, **options: Any) -> Function:
    dispatcher: Any = numba.njit(
        nogil=True,
        error_model="numpy",
        _nrt=False,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=_PartCompiler if TRIED else Compiler,
        **options,
    )(function)
    return dispatcher


class _Part(JITCodeLibrary):
    """The code of a function that only kernels call: kept to be linked, as it was written.

    Numba would optimise it, with all that it calls, and make machine code of it, and do so again
    for each of its callers: two thirds of LLVM's time.
    """

    def _optimize_final_module(self) -> None:
        """The kernels that it ends in are optimised as a whole."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _PartCompiler(Compiler):
    """Numba's compiler up to where machine code is made."""

    def __init__(self, typing: Any, target: Any, library: Any, *settings: Any) -> None:
        super().__init__(typing, target, library, *settings)
        self.state.library = _Part(target.codegen(), "part")
        self.state.library.enable_object_caching()
        self.state.flags.no_compile = True

    def compile_extra(self, func: Any) -> Any:
        """What Numba knows of the function then, with an entry that nobody may call."""
        found = super().compile_extra(func)
        found.library.finalize()
        about, keep = found.fndesc, (found.library,)
        entry = _dynfunc.make_function(
            about.lookup_module(), func.__name__, "part of kernels", 0, found.environment, keep
        )
        found.target_context.insert_user_function(entry, about, keep)
        return found._replace(entry_point=entry)


class Announcer(event.Listener):
    """Says on stderr, once, that kernels are being compiled.

    Python's garbage collection pauses meanwhile: it takes a tenth of the time and finds nothing.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.collects = self.announced = False

    def on_start(self, event: Any) -> None:
        """Called when Numba begins to compile (not when it loads from the cache)."""
        self.depth += 1
        if self.depth == 1:
            self.collects = gc.isenabled()
            gc.disable()
        package = event.data["dispatcher"].py_func.__module__.split(".")[0]
        if not self.announced and package in PACKAGES:
            self.announced = True
            print("pursuit: compiling kernels, once, for some seconds ...", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        """Called when it has compiled."""
        self.depth -= 1
        if self.depth == 0 and self.collects:
            gc.enable()


event.register("numba:compile", Announcer())
