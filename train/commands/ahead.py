"""Kernels are compiled ahead, by processes of their own, while a run imports torch.

The first run on a machine compiles for ten seconds of processor time, on one core, and imports
torch for some seconds before. With two cores two processes (`rehearsal`) begin at once, and the run
finds their work on disk, or waits for it. Whatever they do not do, it does itself: nothing depends
on them. Only on Linux, where this was tried.
"""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from pursuit import kernel_cache
from pursuit.compiled import ANNOUNCER, is_new
from pursuit.rules import start_games

UNKNOWN = {"-h", "--help", "--resume", "reacher", "--task=reacher"}
"""Arguments after which no game is played, or none that they tell, or another world's."""
MOST_SECONDS = 300.0
"""Who takes longer is not waited for."""
POLL = 0.02


class Ahead:
    """Processes that compile ahead: a first one, and whatever that forks.

    Args:
        command: of the first one, which ends last, and with them; they say on its standard output
            which kernels they compile.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self.began, self.count, self.name = time.monotonic(), 0, ""
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # closed when this process ends, however it ends
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # what it cannot do, the run does or refuses
            env=surroundings(),
            start_new_session=True,  # Ctrl-C is for the run alone
        )
        assert self.process.stdout is not None
        os.set_blocking(self.process.stdout.fileno(), False)

    def wait(self) -> bool:
        """Wait a moment, and say what is compiled; whether anything still is."""
        ANNOUNCER.announce()
        self._hear()
        seconds = time.monotonic() - self.began
        if self.process.poll() is not None or seconds > MOST_SECONDS:
            self.close()
            return False
        if self.name:
            ANNOUNCER.show(self.count, self.name, seconds)
        time.sleep(POLL)
        ANNOUNCER.clear()  # the kernel that is waited for may be there: then others speak
        return True

    def _hear(self) -> None:
        assert self.process.stdout is not None
        names = (self.process.stdout.read() or b"").decode(errors="replace").split()
        self.count += len(names)
        self.name = names[-1] if names else self.name

    def close(self) -> None:
        """End whoever still compiles; nobody waits any more."""
        if kernel_cache.elsewhere == self.wait:
            kernel_cache.elsewhere = None
        atexit.unregister(self.close)
        if self.process.poll() is None:  # else nobody is left: whoever is forked hears of it
            os.killpg(self.process.pid, signal.SIGKILL)
        with self.process:  # its pipes, and its exit status
            pass


def surroundings() -> dict[str, str]:
    """The environment of a process that compiles: one core, and our packages, installed or not."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    found, root = {**os.environ, **single}, Path(__file__).parents[2]
    if "site-packages" not in root.parts:
        found["PYTHONPATH"] = os.pathsep.join(filter(None, (found.get("PYTHONPATH"), str(root))))
    return found


def is_worth_it(arguments: Sequence[str]) -> bool:
    """Whether a run with these arguments will compile what a rehearsal does, and cores are free."""
    if not sys.platform.startswith("linux") or len(os.sched_getaffinity(0)) < 2:
        return False
    # Every run begins games. Where some were begun, little is left to compile.
    told = {*arguments, *(argument.partition("=")[0] for argument in arguments)}
    return is_new(start_games) and not UNKNOWN & told


def compile_ahead(arguments: Sequence[str]) -> Ahead | None:
    """Begin to compile what a run with these arguments will ask for, where that saves time."""
    if not is_worth_it(arguments):
        return None
    # -P: files where the user happens to be must not stand in for ours.
    ahead = Ahead([sys.executable, "-P", "-m", "train.commands.rehearsal", *arguments])
    kernel_cache.elsewhere = ahead.wait
    atexit.register(ahead.close)
    return ahead
