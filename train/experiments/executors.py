"""Who does the jobs of a study: processes of this machine, or a Ray cluster."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

from train.experiments.on_ray import check_answers, do_tasks
from train.experiments.study import (
    ERROR,
    Call,
    Study,
    Told,
    prepare,
    status_of,
    statuses_of,
    to_do,
)
from train.experiments.warm import Process, starter
from train.experiments.worker import POLL, Performed, progress_of, record_end
from train.files import only_one


@contextlib.contextmanager
def opened(study: Study, out: Path) -> Iterator[tuple[dict[str, Path], list[str]]]:
    """The folders of all jobs by name, and the names of those to be done; nobody else does them."""
    with only_one(out, "sweep"):
        folders = {run.name: folder for run, folder in prepare(study, out)}
        waiting = to_do(folders)
        for name in waiting:  # what goes on has not failed
            (folders[name] / ERROR).unlink(missing_ok=True)
        yield folders, waiting


def run_locally(study: Study, out: Path | str, workers: int, told: Told) -> dict[str, str]:
    """Do all jobs that are not complete in `workers` processes.

    A job that failed before is tried again. Ctrl-C lets the running ones save their checkpoints.

    Args:
        study: the jobs.
        out: the folder of the study.
        workers: processes at a time; 0 does one job after the other in this process.
        told: is told how far it is.

    Returns:
        The status of every job by name.

    Raises:
        KeyboardInterrupt: once the jobs have saved.
    """
    out = Path(out)
    modules = {run.function.partition(":")[0] for run in study.runs if isinstance(run, Call)}
    with opened(study, out) as (folders, waiting):
        statuses = statuses_of(study, out)
        told(statuses, {})
        running: dict[int, tuple[str, Process]] = {}
        with starter(len(waiting) if workers else 0, modules) as start_process:
            start = start_process if workers else Performed
            try:
                while waiting or running:
                    for lane in set(range(max(workers, 1))) - set(running):
                        if waiting:
                            name = waiting.pop(0)
                            running[lane] = (name, start(folders[name]))
                            statuses[name] = "running"
                            if study.pinned and workers:
                                pin(running[lane][1].pid, lane)
                    for lane, (name, process) in list(running.items()):
                        code = process.poll()
                        if code is not None:
                            del running[lane]
                            record_end(folders[name], code)
                            statuses[name] = status_of(folders[name])
                    progress = {name: progress_of(folders[name]) for name, _ in running.values()}
                    told(statuses, progress)
                    if running:
                        time.sleep(POLL)
            except KeyboardInterrupt:
                for _, process in running.values():
                    process.send_signal(signal.SIGINT)
                for _, process in running.values():
                    process.wait()
                raise
        return statuses


def pin(process: int, lane: int) -> None:
    """Keep a process on one core; those of other lanes have other cores."""
    if process and hasattr(os, "sched_setaffinity"):  # 0 would be this one
        cores = sorted(os.sched_getaffinity(0), reverse=True)
        with contextlib.suppress(ProcessLookupError):
            os.sched_setaffinity(process, {cores[lane % len(cores)]})


# -- Ray -------------------------------------------------------------------------------------------


def import_ray() -> Any:
    """Ray; ImportError with the remedy where it is missing."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        raise ImportError("ray is not installed; pip install 'pursuit[ray]'") from None
    return ray


def run_on_ray(study: Study, out: Path | str, address: str | None, told: Told) -> dict[str, str]:
    """Do all training runs that are not complete as tasks of a Ray cluster, one core each.

    Only this process writes into `out`: whenever a run has saved, what it saved is brought here. So
    a run whose machine dies goes on elsewhere from there, and so does all after Ctrl-C, which lets
    the running ones save first.

    Args:
        study: training runs.
        out: the folder of the study.
        address: of the cluster, "auto" for the one of this machine; None starts one here.
        told, returned: as `run_locally`.

    Raises:
        KeyboardInterrupt: once the runs have saved, and that is here.
    """
    out = Path(out)
    check_answers(address)
    ray = import_ray()
    with opened(study, out) as (folders, waiting):
        told(statuses_of(study, out), {})
        started_here = not ray.is_initialized()
        if started_here:
            before = signal.getsignal(signal.SIGTERM)
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
            if current_thread() is main_thread():  # Ray's own handler would end all without saving
                signal.signal(signal.SIGTERM, before)
        try:
            if waiting:
                do_tasks(ray, {name: folders[name] for name in waiting}, folders, told)
        finally:
            if started_here:
                ray.shutdown()
        return statuses_of(study, out)
