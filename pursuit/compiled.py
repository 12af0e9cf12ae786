"""Compilation of kernels by Numba, with an on-disk cache that notices every change.

Numba's own cache looks at the file of the compiled function only. A kernel that inlines a function
of another file would go on running the old rules after an edit, silently. Here the cache entry is
stamped with the contents of the kernel's file *and* of the rule book, so the one law is: a kernel
calls kernels of its own file and of the rule books (the package `pursuit.rules`, and
`pursuit.reacher.rules`), and nothing else that is compiled.

Compiling is what a first use waits for, so nothing is compiled twice. What kernels call is neither
optimised nor made machine code by itself, only as a part of the kernels that it ends in (`_Part`);
it is compiled for one width of whole numbers; and a kernel is compiled once for a batch of one game
and for larger ones, whose arrays Numba would tell apart (`STRIDED`).
"""

from __future__ import annotations

import gc
import hashlib
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba import _dynfunc, types
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from pursuit.kernel_cache import cache_of

HERE = Path(__file__).parent

ANY_ORDER = {"reassoc", "contract"}
"""What LLVM may do with sums of floating-point numbers: take them in any order, and fuse them with
products."""
NO_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

STRIDED = {"position", "active", "event", "steps", "maze", "maze_of", "epsilon_of"}
"""Arguments that are columns of the games' memory: strided, but contiguous if there is one game."""

TRIED = numba.__version__.startswith("0.68.")
"""Whether this is a Numba whose inner workings are known here; with any other all is compiled as it
compiles by itself, which takes longer."""

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def source_stamp(path: str) -> str:
    """A fingerprint of the kernel file `path` together with the rule book and of this file."""
    digest = hashlib.sha256()
    books = (*sorted((HERE / "rules").glob("*.py")), *(HERE / "reacher").glob("rules.py"))
    books = (*books, *HERE.glob("kernel_cache.py"))
    for file in (Path(path), *books, Path(__file__)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


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
    dispatcher: Any = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    if dispatcher is function:  # as it is with NUMBA_DISABLE_JIT=1
        return function
    stamp = source_stamp(function.__code__.co_filename)
    if not TRIED:
        dispatcher._cache._cache_file._source_stamp = stamp
        return dispatcher
    dispatcher._cache._cache_file = cache_of(dispatcher, stamp)
    names = function.__code__.co_varnames
    strided = {at for at in range(function.__code__.co_argcount) if names[at] in STRIDED}
    compile_for = dispatcher.compile

    def compile_once(given: Any) -> Any:
        wanted = tuple(_strided(t) if at in strided else t for at, t in enumerate(given))
        entry = compile_for(wanted)
        if wanted != tuple(given):  # the same machine code serves both
            dispatcher._insert([t._code for t in given], entry, False)
        return entry

    dispatcher.compile = compile_once
    return dispatcher


def _part(function: Function, **options: Any) -> Function:
    options = {"_nrt": False, **NO_WRAPPERS, **options}
    if not TRIED:
        return _entry(function, **options)
    dispatcher: Any = numba.njit(
        nogil=True, error_model="numpy", pipeline_class=_PartCompiler, **options
    )(function)
    if dispatcher is not function:
        compile_for = dispatcher.compile
        dispatcher.compile = lambda given: compile_for(tuple(_widest(t) for t in given))
    return dispatcher


def _strided(given: Any) -> Any:
    """An array type without a promise that its items lie in a row."""
    return given.copy(layout="A") if isinstance(given, types.Array) else given


def _widest(given: Any) -> Any:
    """int64 for any signed whole number, or one that is written out; callers convert."""
    whole = isinstance(given, types.Integer) and given.signed
    return types.int64 if whole or isinstance(given, types.IntegerLiteral) else given


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
    """Says on stderr that the silence is compilation; on a terminal also what it is at.

    Python's search for garbage waits meanwhile: a tenth of the time, for none to be found.
    """

    def __init__(self) -> None:
        self.depth, self.count, self.seconds, self.began = 0, 0, 0.0, 0.0
        self.collects = self.announced = False

    def announce(self) -> None:
        """Say once that kernels are compiled."""
        if not self.announced:
            self.announced = True
            print("pursuit: compiling kernels, once, for some seconds ...", file=sys.stderr)

    def show(self, count: int, name: str, seconds: float) -> None:
        """On a terminal, the kernel that is compiled, and how long it has taken so far."""
        if sys.stderr.isatty():
            line = f"\r\x1b[Kkernel {count}, {name}: {seconds:.1f} s so far"
            print(line, end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Make room for whatever is told next."""
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def on_start(self, event: Any) -> None:
        """Called when Numba begins to compile (not when it loads from the cache)."""
        function = event.data["dispatcher"].py_func
        self.depth += 1
        if self.depth == 1:
            self.began, self.name, self.collects = (
                time.monotonic(),
                function.__name__,
                gc.isenabled(),
            )
            self.ours = function.__module__.split(".")[0] in ("pursuit", "scripted_agents", "train")
            gc.disable()
            if self.ours:
                self.announce()
            self.count += self.ours
        if self.ours:
            seconds = self.seconds + time.monotonic() - self.began
            self.show(self.count, self.name, seconds)

    def on_end(self, event: Any) -> None:
        """The line makes room for whatever is told next."""
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.monotonic() - self.began
            if self.collects:
                gc.enable()
            if self.ours:
                self.clear()


ANNOUNCER = Announcer()
event.register("numba:compile", ANNOUNCER)
