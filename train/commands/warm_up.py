"""`pursuit warm-up`: compiles kernels before they are needed, for images and clusters."""

from __future__ import annotations

import contextlib
import io
import multiprocessing
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from pursuit.validation import check
from train.commands.main import run_command
from train.commands.parse import parse
from train.settings.checks import Settings

OUT = "--out OUT"
FEW = f"--frames 400 --num-games 8 --episodes 2 --no-report {OUT}"
ROLLOUTS = f"--rollout-steps 5 --minibatch-size 40 {FEW}"
TINY = f"--maze 2x2 {ROLLOUTS}"
CHASE = {"train": f"--frames 2000 {OUT}"}
OTHERS = {
    "self-play --game rock_paper_scissors": f"--frames 400 --no-report {OUT}",
    "train --task reacher": ROLLOUTS,
    "train --algorithm cross_entropy": f"--maze 2x2 --population 4 --elite-share 0.5 {FEW}",
    "train --algorithm q_learning": f"--maze 2x2 {FEW}",
    "train --algorithm ippo --num-chasers 2": TINY,
    "train --task maze --num-goals 2": TINY,
    "train --task escape": TINY,
    "self-play --snapshots 2": TINY,
    "train --slip 0.1 --collisions block --capture adjacent --stay-action": TINY,
    "train --role evader": TINY,
    "train --view-radius 1 --observation planes": TINY,
    "train --move-order turns --stay-action --observation one_hot": TINY,
    "train --task race --num-goals 2": TINY,
    "train --task heist --num-goals 2": TINY,
    "train --observation positions": TINY,
    "train --observation cells": TINY,
    "train --observation walls": TINY,
    "train --observation window:2": TINY,
    "demo": "--out OUT.html",
    "solve": "--maze 2x2 --out OUT.png",
    "baseline --task maze": "--maze 3x3 --episodes 2",
    "baseline --num-chasers 2 --num-evaders 2": "--maze 3x3 --episodes 2",
    "baseline --task heist --num-chasers 2": "--maze 2x2 --num-goals 1 --episodes 2",
}
"""Commands, and settings with which they take little time beside compilation. Those that have few
kernels in common with `CHASE` come first, as two run at the same time."""


@dataclass(frozen=True)
class WarmUpCommand(Settings):
    """Compile kernels into the cache on disk, so that later commands begin at once.

    The cache is in the folder NUMBA_CACHE_DIR, else in __pycache__ beside the installed files, else
    in Numba's cache folder in the home directory.
    """

    all: bool = False
    """Also those of the other tasks, options, learners, exact solvers, teams and small games, and
    of self-play; by default those of `pursuit train` in a chase. Two processes compile."""


def warm_up(arguments: Sequence[str]) -> None:
    """`pursuit warm-up`."""
    commands = CHASE | (OTHERS if parse(WarmUpCommand, arguments, "warm-up").all else {})
    from numba.core import config  # slow to import

    check(
        not config.DISABLE_JIT, "NUMBA_DISABLE_JIT=1: nothing is compiled; unset it for the warm-up"
    )
    print(f"cache: {cache_folder()}", flush=True)
    began, total = perf_counter(), 0
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(2, len(commands)), spawn) as pool:
        found = pool.map(compile_for, commands, commands.values())
        for command, (count, seconds) in zip(commands, found, strict=True):
            total += count
            print(f"{seconds:6.1f} s  {count:4d} functions  pursuit {command}", flush=True)
    print(f"compiled {total} functions in {perf_counter() - began:.0f} s")


def cache_folder() -> str:
    """Where kernels are saved; ValueError if they cannot be saved, or not where the user says."""
    from numba.core import config  # slow to import

    from pursuit.compilation.kernel_cache import ROOT, KernelCache

    named, folder = config.CACHE_DIR, Path()
    with contextlib.suppress(RuntimeError):  # of Numba: no folder can be written
        folder = Path(KernelCache(compile_for).cache_path)
    check(
        folder.parent == Path(named) if named else folder != Path(),
        f"NUMBA_CACHE_DIR={named}: compiled kernels cannot be saved there; give a folder that can "
        "be written",
    )
    beside = folder.name == "__pycache__" and not named
    return str(ROOT / "**" / "__pycache__" if beside else folder.parent)


def compile_for(command: str, settings: str) -> tuple[int, float]:
    """Run a command with its files in a temporary folder: functions compiled, and seconds."""
    from numba.core import event  # slow to import

    began, said, recorder = perf_counter(), io.StringIO(), event.RecordingListener()
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(said),
        contextlib.redirect_stderr(said),
        event.install_listener("numba:compile", recorder),
    ):
        parts = f"{command} {settings}".split()
        run_command([part.replace("OUT", f"{folder}/run") for part in parts])
    starts = [each for _, each in recorder.buffer if each.is_start]
    return len(starts), perf_counter() - began
