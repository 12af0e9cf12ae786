"""Compilation of kernels by Numba, with an on-disk cache that detects every change.

A kernel may call functions of any file of the project: the stamp of its cache entry covers the
imports of its file (`pursuit.compilation.kernel_cache`). Numba is imported when a kernel is first
called: help texts and errors of options need none, and its import takes as long as all of theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, update_wrapper
from threading import RLock
from typing import Any, TypeVar, cast

ANY_ORDER = {"reassoc", "contract"}
"""Fast-math flags of LLVM: reorder floating-point sums, and fuse them with products."""

MAKING = RLock()
"""Held while a dispatcher is made, as threads may call a kernel for the first time together."""

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile `function` with Numba on first use and keep the machine code on disk.

    The kernel must not allocate arrays, as Numba's reference counting is switched off (it took two
    thirds of the time of a step). For kernels that allocate see `allocating`.
    """
    return _later(function, False, _nrt=False)


def summing(function: Function) -> Function:
    """Like `compiled`, but sums may be reordered, which allows vector instructions.

    Infinities and NaN are handled as usual. The order is fixed at compilation, so results are
    reproducible on the same processor.
    """
    return _later(function, False, _nrt=False, fastmath=ANY_ORDER)


def merged_sums(function: Function) -> Function:
    """Like `inlined`, for kernels that are `summing`."""
    return _later(function, True, forceinline=True, fastmath=ANY_ORDER)


def subroutine(function: Function) -> Function:
    """Compile a function for calls from kernels only, without wrappers for calls from Python."""
    return _later(function, True)


def inlined(function: Function) -> Function:
    """A `subroutine` that is inlined into its callers, so that constants propagate to its loops."""
    return _later(function, True, forceinline=True)


def allocating(function: Function) -> Function:
    """Like `compiled`, with reference counting, for kernels that allocate arrays.

    The kernel must not call functions that return arrays (such as `layout.games_of`): without
    reference counting in those functions it would free arrays that are in use.
    """
    return _later(function, False)


def _later(function: Function, is_part: bool, **options: Any) -> Function:
    enclosed = (each.cell_contents for each in function.__closure__ or ())
    if not is_part and any(isinstance(each, Kernel) for each in enclosed):
        raise TypeError(
            f"{function.__name__}: name compiled functions in the module, as a kernel "
            "that encloses them is not found again on disk"
        )
    kernel: Any = Kernel(lambda *args, **named: kernel.dispatcher(*args, **named))
    kernel.py_func, kernel.is_part, kernel.options = function, is_part, options
    return cast(Function, update_wrapper(kernel, function))


class Kernel(partial[Any]):
    """Calls Numba's dispatcher of a function, made on first use.

    A `partial` of the dispatcher, as a method `__call__` would add a tenth of a microsecond.
    """

    @property
    def dispatcher(self) -> Any:
        """Numba's dispatcher; the function itself with NUMBA_DISABLE_JIT=1."""
        from pursuit.compilation.compiler import entry, part  # slow to import

        with MAKING:
            if "made" not in vars(self):
                self.made = (part if self.is_part else entry)(self.py_func, **self.options)
                self.__setstate__((self.made, (), {}, vars(self)))
        return self.made

    @property
    def _numba_type_(self) -> Any:
        """How Numba takes this object in kernels."""
        return self.dispatcher._numba_type_

    def __getattr__(self, name: str) -> Any:
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> str:
        return self.__qualname__
