"""Compilation of kernels by Numba, with an on-disk cache that notices every change.

Numba's own cache looks at the file of the compiled function only. A kernel that inlines a function
of another file would go on running the old rules after an edit, silently. Here the cache entry is
stamped with the contents of the kernel's file *and* of the rule book, so the one law is: a kernel
calls kernels of its own file and of the rule books (the package `pursuit.rules`, and
`pursuit.reacher.rules`), and nothing else that is compiled.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import event

HERE = Path(__file__).parent

NO_WRAPPERS = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

Function = TypeVar("Function", bound=Callable[..., Any])


@cache
def source_stamp(path: str) -> str:
    """A fingerprint of the kernel file `path` together with the rule book and of this file."""
    digest = hashlib.sha256()
    books = (*sorted((HERE / "rules").glob("*.py")), *(HERE / "reacher").glob("rules.py"))
    for file in (Path(path), *books, Path(__file__)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def compiled(function: Function) -> Function:
    """Compile `function` with Numba on first use and keep the machine code on disk.

    The kernel must not allocate: it works on the arrays that it is given, without Numba's reference
    counts (which, left in, took two thirds of the time of a step). See `allocating`.
    """
    return _compile(function, _nrt=False)


def subroutine(function: Function) -> Function:
    """`compiled`, for kernels to call, not for Python: it needs no wrapper, which takes seconds."""
    return _compile(function, _nrt=False, **NO_WRAPPERS)


def inlined(function: Function) -> Function:
    """A `subroutine` merged into every kernel that calls it, so that constants reach its loops."""
    return _compile(function, _nrt=False, forceinline=True, **NO_WRAPPERS)


def allocating(function: Function) -> Function:
    """Like `compiled`, for a kernel that makes arrays of its own, and so counts references.

    It must call nothing that returns arrays (`layout.world_of` and the like): kernels that do not
    count would hand it uncounted ones, which it would free.
    """
    return _compile(function)


def _compile(function: Function, **options: bool) -> Function:
    dispatcher = numba.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    if dispatcher is not function:  # as it is with NUMBA_DISABLE_JIT=1
        dispatcher._cache._cache_file._source_stamp = source_stamp(function.__code__.co_filename)
    return dispatcher


class _Announcer(event.Listener):
    """Says once a process, on stderr, that the silence is compilation."""

    def __init__(self) -> None:
        self.said = False

    def on_start(self, event: Any) -> None:
        """Called when Numba begins to compile (not when it loads from the cache)."""
        module = event.data["dispatcher"].py_func.__module__.split(".")[0]
        if not self.said and module in ("pursuit", "scripted_agents", "train"):
            self.said = True
            print("pursuit: compiling kernels, once, for some seconds ...", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        """Nothing to say when it is over."""


event.register("numba:compile", _Announcer())
