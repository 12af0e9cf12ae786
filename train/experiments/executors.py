"""Who does the runs of a sweep: processes of this machine, or a Ray cluster."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterable
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

from train.experiments.address import check_answers
from train.experiments.on_ray import do_tasks, tune
from train.experiments.sweep import ERROR, STOPPED, Sweep, Told, prepare, status_of, to_do
from train.experiments.warm import Process, starter
from train.experiments.worker import POLL, progress_of, record_end
from train.files import only_one

__all__ = ["progress_of", "run_locally", "run_on_ray"]


def run_locally(
    sweep: Sweep, out: Path | str, workers: int, told: Told, again: bool = False
) -> dict[str, str]:
    """Do all runs that have not ended in `workers` processes.

    A run that failed before is tried again. Ctrl-C lets the running ones save their checkpoints.

    Args:
        sweep: the runs.
        out: the folder of the sweep.
        workers: processes at a time.
        told: is told how far it is.
        again: go on with runs, too, that a scheduler stopped early.

    Returns:
        The status of every run by name.

    Raises:
        KeyboardInterrupt: once the runs have saved.
    """
    out = Path(out)
    with only_one(out, "sweep"):
        folders = dict((run.name, folder) for run, folder in prepare(sweep, out))
        statuses = {name: status_of(folder) for name, folder in folders.items()}
        waiting = to_do(folders, again)
        forget_ends(folders[name] for name in waiting)
        running: dict[str, Process] = {}
        told(statuses, {})
        with starter(len(waiting)) as start:
            try:
                while waiting or running:
                    while waiting and len(running) < workers:
                        name = waiting.pop(0)
                        running[name] = start(folders[name], sweep.episodes)
                        statuses[name] = "running"
                    for name, process in list(running.items()):
                        code = process.poll()
                        if code is not None:
                            del running[name]
                            record_end(folders[name], code)
                            statuses[name] = status_of(folders[name])
                    told(statuses, {name: progress_of(folders[name]) for name in running})
                    time.sleep(POLL)
            except KeyboardInterrupt:
                for process in running.values():
                    process.send_signal(signal.SIGINT)
                for process in running.values():
                    process.wait()
                raise
        return statuses


def forget_ends(folders: Iterable[Path]) -> None:
    """Runs that go on have neither failed nor been stopped."""
    for folder in folders:
        for name in (ERROR, STOPPED):
            (folder / name).unlink(missing_ok=True)


# -- Ray -------------------------------------------------------------------------------------------


def import_ray() -> Any:
    """Ray; ImportError with the remedy where it is missing."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        raise ImportError("ray is not installed; pip install 'pursuit[ray]'") from None
    return ray


def run_on_ray(
    sweep: Sweep, out: Path | str, address: str | None, told: Told, again: bool = False
) -> dict[str, str]:
    """Do all runs that have not ended as tasks of a Ray cluster, one core each.

    Only this process writes into `out`: whenever a run has saved, what it saved is brought here. So
    a run whose machine dies goes on elsewhere from there, and so does all after Ctrl-C, which lets
    the running ones save first.

    Args:
        sweep: the runs.
        out: the folder of the sweep.
        address: of the cluster, "auto" for the one of this machine; None starts one here.
        told: is told how far it is.
        again: go on with runs, too, that a scheduler stopped early.

    Returns:
        The status of every run by name.

    Raises:
        KeyboardInterrupt: once the runs have saved, and that is here.
    """
    out = Path(out)
    check_answers(address)
    ray = import_ray()
    with only_one(out, "sweep"):
        folders = dict((run.name, folder) for run, folder in prepare(sweep, out))
        todo = to_do(folders, again)
        told({name: status_of(folder) for name, folder in folders.items()}, {})
        started_here = not ray.is_initialized()
        if started_here:
            before = signal.getsignal(signal.SIGTERM)
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
            if current_thread() is main_thread():  # Ray's own handler would end all without saving
                signal.signal(signal.SIGTERM, before)
        try:
            forget_ends(folders[name] for name in todo)
            work = tune if sweep.scheduler == "asha" else do_tasks
            if todo:
                work(ray, {name: folders[name] for name in todo}, sweep.episodes, folders, told)
        finally:
            if started_here:
                ray.shutdown()
        return {name: status_of(folder) for name, folder in folders.items()}
