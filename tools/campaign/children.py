"""Execution of commands in forked processes, which saves the time of imports."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import traceback
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from time import monotonic, sleep

import matplotlib
import torch

from train.commands.main import COMMANDS, main

STATUSES = {0: "done", 1: "diverged", 2: "refused", 130: "SIGINT", 141: "SIGPIPE", 143: "SIGTERM"}


WARM = (
    "baseline --task chase --maze 3x3 --episodes 20",
    "baseline --task maze --maze 3x3 --num-goals 2 --episodes 20",
    "baseline --task heist --maze 3x3 --num-goals 1 --episodes 20",
    "solve --maze 2x2 --out s.png",
    "train --maze 3x3 --frames 600 --max-steps 40 --num-games 16 --threads 1 --minibatch-size 64"
    " --episodes 20 --out r",
)


def prepare(folder: Path) -> None:
    """Import all commands and load compiled functions before forking.

    Torch has one thread, as a process with more cannot be forked.
    """
    torch.set_num_threads(1)
    matplotlib.use("Agg")
    for name in COMMANDS:
        import_module(f"train.commands.{name.replace('-', '_')}")
    here = Path.cwd()
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        os.chdir(folder)
        for command in WARM:
            main(command.split())
        os.chdir(here)


@dataclass(frozen=True)
class Outcome:
    """The result of a command.

    Attributes:
        status: its exit status; minus the signal that killed it; None after the time limit.
        out, err: its output.
        seconds: its duration.
    """

    status: int | None
    out: str
    err: str
    seconds: float

    def faults(self, allowed: tuple[int, ...] = tuple(STATUSES)) -> list[str]:
        """The faults: a traceback, a status that is not allowed, or the time limit."""
        found = []
        if self.status is None:
            found.append(f"did not end within {self.seconds:.0f} s")
        elif self.status not in allowed:
            found.append(f"exit status {self.status}")
        if "Traceback (most recent call last)" in self.out + self.err:
            found.append("a traceback")
        if self.status == 2:
            lines = [line for line in self.err.splitlines() if line.strip()]
            if not any(line.startswith("pursuit: error: ") for line in lines[-1:]):
                found.append("status 2 without an error line")
            if "| None" in self.err or ".part" in self.err or "[Errno" in self.err:
                found.append("an internal message of Python")
        return found

    def last_line(self) -> str:
        """The last line of its output."""
        return (self.err.strip() or self.out.strip() or "(nothing)").splitlines()[-1]


def call(
    arguments: list[str],
    folder: Path,
    limit: float = 30.0,
    kill: tuple[float, int] | None = None,
) -> Outcome:
    """`pursuit ARGUMENTS` in `folder`.

    Args:
        arguments: of the command.
        folder: its working directory.
        limit: time limit in seconds.
        kill: seconds until a signal is sent, and the signal.
    """
    began = monotonic()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if child == 0:
            _run_and_exit(arguments, folder, out.fileno(), err.fileno())
        status, sent = None, False
        while monotonic() - began < limit:
            ended, code = os.waitpid(child, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
                break
            if kill is not None and not sent and monotonic() - began >= kill[0]:
                os.kill(child, kill[1])
                sent = True
            sleep(0.005)
        if status is None:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode("utf-8", "replace"))
    return Outcome(status, *texts, monotonic() - began)


def _run_and_exit(arguments: list[str], folder: Path, out: int, err: int) -> None:
    """Run the command in this process, and exit."""
    status = 1
    try:
        os.setsid()
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(out, 1)
        os.dup2(err, 2)
        sys.argv = ["pursuit", *arguments]
        main(arguments)
        status = 0
    except SystemExit as ending:
        status = ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
