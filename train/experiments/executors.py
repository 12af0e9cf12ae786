"""Execution of the runs of a study, in local processes or as tasks of a Ray cluster."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any, Protocol

from pursuit.plugins import environment
from pursuit.validation import check
from train.experiments.runs import ERROR, Study, Watch, prepare, status_of, statuses_of
from train.experiments.worker import perform_here, progress_of, record_end, start_worker
from train.files import only_one
from train.machine import usable_cores

POLL = 0.2
"""Polling interval of running processes in seconds."""
SECONDS_TO_ANSWER = 5.0
"""Timeout for the connection to a cluster."""
OF_WORKERS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment variables: one thread per run, as each has one core."""
OF_WORKERS["PYTHONSAFEPATH"] = "1"  # a train.py in the current folder is not imported


class Job(Protocol):
    """A running job."""

    def poll(self) -> int | None:
        """Its exit status, negative if a signal ended it; None while it runs."""

    def stop(self) -> None:
        """Make it save and exit."""


def run_study(
    study: Study,
    out: Path,
    slots: int,
    start: Callable[[Path, int], Job],
    watch: Watch,
) -> dict[str, str]:
    """Execute all runs that are not complete, and return the status of every run by name.

    Args:
        study: the runs.
        out: the folder of the study.
        slots: number of parallel runs.
        start: starts the run in a folder; the second argument is the index of its slot.
        watch: called with the status and progress of all runs.

    Raises:
        KeyboardInterrupt: once the runs have saved.
    """
    with only_one(out, "sweep"):
        folders = {run.name: folder for run, folder in prepare(study, out)}
        waiting = [name for name, folder in folders.items() if status_of(folder) != "complete"]
        for name in waiting:  # retried
            (folders[name] / ERROR).unlink(missing_ok=True)
        statuses = statuses_of(study, out)
        watch(statuses, {})
        running: dict[int, tuple[str, Job]] = {}
        try:
            while waiting or running:
                for slot in set(range(slots)) - set(running):
                    if waiting:
                        name = waiting.pop(0)
                        running[slot] = (name, start(folders[name], slot))
                        statuses[name] = "running"
                for slot, (name, job) in list(running.items()):
                    code = job.poll()
                    if code is not None:
                        del running[slot]
                        record_end(folders[name], code)
                        statuses[name] = status_of(folders[name])
                watch(statuses, {name: progress_of(folders[name]) for name, _ in running.values()})
                if running:
                    time.sleep(POLL)
        except KeyboardInterrupt:
            for _, job in running.values():
                job.stop()
            while any(job.poll() is None for _, job in running.values()):
                time.sleep(POLL)
            raise
        return statuses


# -- this machine ----------------------------------------------------------------------------------


class LocalJob:
    """A job in a local process, pinned to `core` unless that is None."""

    def __init__(self, folder: Path, core: int | None) -> None:
        self.process = start_worker(folder)
        if core is not None and hasattr(os, "sched_setaffinity"):
            with contextlib.suppress(ProcessLookupError):
                os.sched_setaffinity(self.process.pid or 0, {core})

    def poll(self) -> int | None:
        """As `Job`."""
        return self.process.exitcode

    def stop(self) -> None:
        """As `Job`."""
        # SIGINT would be lost in a process that has just been forked: its server ignores it.
        self.process.terminate()


def run_locally(study: Study, out: Path | str, workers: int, watch: Watch) -> dict[str, str]:
    """Execute all runs that are not complete in `workers` processes.

    Failed runs are retried. After Ctrl-C the running runs save their checkpoints.
    A script that calls this needs the guard `if __name__ == "__main__":`, as for
    `multiprocessing`.

    Args:
        study: the runs.
        out: the folder of the study.
        workers: parallel processes.
        watch: called with the status and progress of all runs.

    Returns:
        The status of every run by name.

    Raises:
        KeyboardInterrupt: once the runs have saved.
    """
    cores = usable_cores()[::-1] if study.pinned else []

    def start(folder: Path, slot: int) -> LocalJob:
        return LocalJob(folder, cores[slot % len(cores)] if cores else None)

    before = dict(os.environ)
    os.environ.update(OF_WORKERS)  # no effect on libraries that are loaded in this process
    try:
        return run_study(study, Path(out), workers, start, watch)
    finally:
        os.environ.clear()
        os.environ.update(before)


# -- Ray -------------------------------------------------------------------------------------------


def import_ray() -> Any:
    """Import Ray; ImportError with the remedy if it is not installed."""
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError:
        raise ImportError("ray is not installed; pip install 'pursuit[ray]'") from None
    return ray


def check_answers(address: str | None) -> None:
    """Check that a cluster can be reached; None, "auto" and "local" are resolved by Ray.

    Raises:
        ValueError: not an address, or no connection within SECONDS_TO_ANSWER.
    """
    if address in (None, "auto", "local"):
        return
    host, _, port = str(address).removeprefix("ray://").rpartition(":")
    check(
        bool(host) and port.isdecimal() and 0 < int(port) < 2**16,
        f"address={address!r} is not an address; give auto, HOST:PORT or ray://HOST:PORT",
    )
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=SECONDS_TO_ANSWER).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"address={address!r}: no Ray cluster answers there ({reason}); start one by "
            "`ray start --head`, or leave the address out"
        ) from None


class RayJob:
    """A job as a task of a Ray cluster; retried on another machine if its machine fails."""

    def __init__(self, ray: Any, folder: Path) -> None:
        remote = ray.remote(num_cpus=1, max_retries=5)(perform_here)
        self.ray, self.folder = ray, folder
        self.task = remote.remote(str(folder.resolve()), environment())

    def poll(self) -> int | None:
        """As `Job`."""
        ready, _ = self.ray.wait([self.task], timeout=0)
        if not ready:
            return None
        try:
            return int(self.ray.get(self.task))
        except self.ray.exceptions.RayError:
            return 1

    def stop(self) -> None:
        """As `Job`: Ray interrupts the task, which saves."""
        self.ray.cancel(self.task)


def run_on_ray(study: Study, out: Path | str, address: str | None, watch: Watch) -> dict[str, str]:
    """Execute all runs that are not complete as tasks of a Ray cluster, one core each.

    The folder `out` must be on a disk that all machines of the cluster share. If a machine fails,
    its runs are resumed elsewhere from their checkpoints.

    Args:
        study: the runs.
        out: the folder of the study.
        address: of the cluster, "auto" for the one on this machine; None starts one here.
        watch, returned: as in `run_locally`.

    Raises:
        KeyboardInterrupt: once the runs have saved.
    """
    check_answers(address)
    ray = import_ray()
    started_here = not ray.is_initialized()
    if started_here:
        before = signal.getsignal(signal.SIGTERM)
        ray.init(address=address, log_to_driver=False, include_dashboard=False)
        if current_thread() is main_thread():  # Ray's handler would exit without saving
            signal.signal(signal.SIGTERM, before)
    try:
        slots = max(int(ray.cluster_resources().get("CPU", 1)), 1)
        return run_study(study, Path(out), slots, lambda folder, _: RayJob(ray, folder), watch)
    finally:
        if started_here:
            ray.shutdown()
