"""Execution of one run of a study, in a separate process.

The process exits when its parent has ended for any reason. The folder of a run is locked, so that
only one process executes it at a time.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import time
import traceback
from collections.abc import Mapping
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any

from filelock import FileLock

from pursuit.plugins import environment
from train.experiments.runs import ERROR, PROGRESS, status_of
from train.files import write_text
from train.kinds import open_run
from train.runs.folder import load_final
from train.runs.loop import Run

LOG = "log.txt"
SECONDS_TO_SAVE = 60.0
"""Time to save before the process of a run exits, after its parent has ended."""


def perform(folder: Path) -> None:
    """Execute or resume the run in `folder`, and evaluate the trained policy."""
    with FileLock(folder / ".worker.lock"):  # a worker of a killed study may still be saving
        if status_of(folder) != "complete":
            train(folder)


def train(folder: Path) -> None:
    """As `perform`, without its lock; the lock of the run is released at the end."""
    run = open_run(folder)

    def report(run: Run, row: dict[str, float]) -> None:
        if row:  # the checkpoint and its files have been written
            write_text(folder / PROGRESS, str(run.progress))

    if run.progress < 1.0:
        run.train(report)
    if not run.stopped:
        run.results(load_final(folder).episodes)


def perform_here(folder: str, variables: Mapping[str, str]) -> int:
    """Execute the run in `folder` in this process; errors are written to its log.

    Args:
        folder: of the run.
        variables: environment variables that list the modules of users.

    Returns:
        The exit status.
    """
    os.environ.update(variables)
    try:
        perform(Path(folder))
    except Exception:  # other runs continue after any exception of one
        write_text(Path(folder) / LOG, traceback.format_exc())
        return 1
    return 0


# -- processes -------------------------------------------------------------------------------------


def start_worker(folder: Path) -> BaseProcess:
    """Start a process that executes the run in `folder`; its output goes to `log.txt`.

    The process is forked from a server that has imported this module and torch once.
    """
    context: Any = get_context("forkserver")
    # the server looks for modules in the working folder first, where another `train` may be
    context.set_forkserver_preload(["pursuit.train.experiments.worker"])
    process: BaseProcess = context.Process(target=work, args=(str(folder), environment()))
    process.start()
    return process


def work(folder: str, variables: Mapping[str, str]) -> None:
    """The main function of a run's process."""
    os.setsid()  # Ctrl-C reaches only the study's process, which stops its runs
    with (Path(folder) / LOG).open("ab") as log:
        for stream in (1, 2):
            os.dup2(log.fileno(), stream)
    os.environ.update(variables)
    Thread(target=end_with_parent, daemon=True).start()
    perform(Path(folder))


def end_with_parent() -> None:
    """When the parent process has ended, make this one save and exit."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(SECONDS_TO_SAVE)
    os._exit(128 + signal.SIGTERM)


def record_end(folder: Path, code: int) -> None:
    """Write down why a run failed, if it did."""
    if code == 0:
        return
    path = folder / LOG
    log = path.read_text(errors="replace").strip().splitlines() if path.exists() else []
    reason = log[-1] if log else "no output"
    if code < 0:
        reason = f"killed by signal {-code} ({signal.Signals(-code).name})"
    text = f"{reason}\n\nexit status {code}; the end of {LOG}:\n" + "\n".join(log[-30:]) + "\n"
    write_text(folder / ERROR, text)


def progress_of(folder: Path) -> float:
    """The progress that a running run has reported, in [0, 1]."""
    with contextlib.suppress(OSError, ValueError):
        found = float((folder / PROGRESS).read_text())
        return min(max(found, 0.0), 1.0) if math.isfinite(found) else 0.0
    return 0.0
