"""Numba's compiler, as `pursuit.compilation.compiled` uses it; importing it imports Numba.

Functions that only kernels call are not optimised or compiled to machine code separately, but as
part of the calling kernels (`_Part`). This halves the compilation time.
"""

from __future__ import annotations

import gc
import sys
from time import perf_counter, process_time
from typing import Any, ClassVar

import numba
import numpy as np
from numba import _dynfunc, types
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.typed_passes import InlineOverloads, NopythonRewrites
from numba.core.untyped_passes import InlineClosureLikes

from pursuit.compilation.kernel_cache import KernelCache
from pursuit.siblings import is_ours

TRIED = numba.__version__.startswith("0.68.")
"""Whether this is a version of Numba that `_PartCompiler` supports. With other versions Numba's own
compiler is used, which takes twice as long."""

CLOCKS = {"wall": perf_counter, "processor": process_time}


def entry(function: Any, **options: Any) -> Any:
    """Numba's dispatcher of a kernel that Python calls; the function itself without compilation."""
    dispatcher = numba.njit(nogil=True, error_model="numpy", **options)(function)
    if dispatcher is function:  # NUMBA_DISABLE_JIT=1; NumPy warns where random numbers overflow
        return np.errstate(over="ignore")(function)
    dispatcher._cache = KernelCache(function)
    return dispatcher


def part(function: Any, **options: Any) -> Any:
    """Numba's dispatcher of a function that only kernels call."""
    dispatcher = numba.njit(
        nogil=True,
        error_model="numpy",
        _nrt=False,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=_PartCompiler if TRIED else Compiler,
        **options,
    )(function)
    if dispatcher is not function:
        of = dispatcher.get_call_template
        dispatcher.get_call_template = lambda args, kws: of([_wide(each) for each in args], kws)
    return dispatcher


def _wide(kind: types.Type) -> types.Type:
    """int64 for integers with a sign and for constants, so that a part is compiled once."""
    kind = types.unliteral(kind)
    return types.int64 if isinstance(kind, types.Integer) and kind.signed else kind


class _Part(JITCodeLibrary):
    """The unoptimised code of a function that only kernels call, to be linked into kernels.

    Numba would optimise and compile it with all functions that it calls, and again in each of its
    callers, which takes two thirds of LLVM's time.
    """

    def _optimize_final_module(self) -> None:
        """Skipped: the calling kernels are optimised as a whole."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _Flags(Flags):
    """Flags of the compiler, which it compares at every call of a function in a kernel."""

    DEFAULTS: ClassVar = {name: option.default for name, option in Flags.options.items()}

    def values(self) -> dict[str, Any]:
        """The values by name, without the property of each, which takes ten times as long."""
        return self.DEFAULTS | self._values


class _PartCompiler(Compiler):
    """Numba's compiler without the generation of machine code and without `UNUSED`, the passes for
    closures, overloads that are inlined and expressions with whole arrays."""

    UNUSED: ClassVar = {InlineClosureLikes, InlineOverloads, NopythonRewrites}

    def __init__(
        self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, kinds: Any
    ) -> None:
        super().__init__(typing, target, library, args, result, _Flags(flags), kinds)
        self.state.library = _Part(target.codegen(), "part")
        self.state.library.enable_object_caching()
        self.state.flags.no_compile = True

    def define_pipelines(self) -> Any:
        """Numba's passes that parts need."""
        for each in (found := super().define_pipelines()):
            each.passes = [step for step in each.passes if step[0] not in self.UNUSED]
        return found

    def compile_extra(self, func: Any) -> Any:
        """Compile the function; the entry point in the result cannot be called from Python."""
        found = super().compile_extra(func)
        found.library.finalize()
        about, keep = found.fndesc, (found.library,)
        entry = _dynfunc.make_function(
            about.lookup_module(), func.__name__, "part of kernels", 0, found.environment, keep
        )
        found.target_context.insert_user_function(entry, about, keep)
        return found._replace(entry_point=entry)


USUAL = (
    {
        "all_distances": 0.3, "step_games": 3.7, "fill_greedy_table": 0.6, "choose_actions": 1.1,
        "list_entities": 0.4, "draw_actions": 0.4, "below_heads": 0.2, "clipped_loss": 0.6,
        "first_layer_gradient": 0.2, "evaluate_rows": 0.4, "respond_rows": 1.0, "choose": 0.4,
    },
    {"fill_store": 4.6, "fill_games": 0.5, "fill_numbers": 0.4, "sweep": 1.0},
)  # fmt: skip
"""Kernels that take long to compile, and how many seconds on an AMD EPYC of 2.6 GHz: those of a
first training, and those of exact solutions with options of the rules or several agents."""


class Announcer(event.Listener):
    """Prints to stderr, before a group of `USUAL` kernels is compiled, the seconds that it takes.

    It also pauses Python's garbage collection during compilation, which takes a tenth of the time.

    Attributes:
        spent: seconds of compilation so far, by clock.
        names: of the compiled kernels.
        muted: whether nothing is printed.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.spent = dict.fromkeys(CLOCKS, 0.0)
        self.began = dict(self.spent)
        self.names: set[str] = set()
        self.collects = self.muted = False

    def on_start(self, event: Any) -> None:
        """Called when Numba starts to compile (not when it loads from the cache)."""
        self.depth += 1
        if self.depth > 1:
            return
        self.began = {name: clock() for name, clock in CLOCKS.items()}
        self.collects = gc.isenabled()
        gc.disable()
        function = event.data["dispatcher"].py_func
        if not is_ours(function.__module__):
            return
        first = not self.names
        group = next((each for each in USUAL[1:] if function.__name__ in each), USUAL[0])
        if not self.muted and (first or (group is not USUAL[0] and not self.names & {*group})):
            # Not all kernels of the group may be needed, and some may be on disk already.
            print(
                "pursuit: compiling kernels (once per machine and kind of game), up to about "
                f"{sum(group.values()) * self.slowness():.0f} s remain ...",
                file=sys.stderr,
            )
        self.names.add(function.__name__)

    def slowness(self) -> float:
        """The time of compilation so far as a multiple of that in `USUAL`; 1 at the beginning."""
        usual = sum(group[name] for group in USUAL for name in self.names & {*group})
        return self.spent["wall"] / usual if usual > 1.0 else 1.0

    def on_end(self, event: Any) -> None:
        """Called after compilation."""
        self.depth -= 1
        if self.depth == 0:
            for name, clock in CLOCKS.items():
                self.spent[name] += clock() - self.began[name]
            if self.collects:
                gc.enable()


ANNOUNCER = Announcer()
event.register("numba:compile", ANNOUNCER)


def now_without_compilation(clock: str) -> float:
    """The seconds of a clock, "wall" or "processor" (of this process), which stands still while
    kernels are compiled."""
    return CLOCKS[clock]() - ANNOUNCER.spent[clock]
