"""Execution of the runs of a study, in local processes or as tasks of a Ray cluster.

The process of a run exits when its parent has ended for any reason. The folder of a run is locked,
so that only one process executes it at a time.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from multiprocessing import get_all_start_methods, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import Any, Protocol

from filelock import FileLock

from pursuit.plugins import environment
from pursuit.validation import check
from train.experiments.recorded import record
from train.experiments.rows import recorded_row
from train.experiments.runs import ERROR, PROGRESS, Study, Watch, prepare, status_of, statuses_of
from train.experiments.shards import row_files
from train.experiments.study import ENDED
from train.files import LOCK, hold, only_one, write_text
from train.kinds import open_run
from train.machine import usable_cores
from train.runs.folder import load_config
from train.runs.interruption import Stopped
from train.runs.loop import Run

FORK_SERVER = "forkserver"
LOG = "log.txt"
SECONDS_TO_SAVE = 60.0
"""Time to save before the process of a run exits, after its parent has ended."""
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
    study: Study, out: Path, slots: int, start: Callable[[Path, int], Job], watch: Watch
) -> dict[str, str]:
    """Execute all runs of the study, or of its shard, that are not complete; the status of each
    by name.

    Args:
        study: the runs.
        out: the folder of the study.
        slots: number of parallel runs.
        start: starts the run in a folder; the second argument is the index of its slot.
        watch: called with the status and progress of all runs.

    Raises:
        ValueError: another process executes the study or the shard.
        KeyboardInterrupt: once the runs have saved.
    """
    with alone(study, out):
        folders = {run.name: folder for run, folder in prepare(study, out)}
        for folder in folders.values():  # of a command that ended before it wrote the row
            if status_of(folder) == "complete":
                record_run(study, folder)
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
                        if statuses[name] in ENDED:
                            record_run(study, folders[name])
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


@contextlib.contextmanager
def alone(study: Study, out: Path) -> Iterator[None]:
    """Lock what only one process may write: of a shard its file of rows, as shards may share the
    folder of the study; of a whole study the folder, and the rows of shards, which have then ended.

    Raises:
        ValueError: another process has locked one of them.
    """
    files = [] if study.rows is None else row_files(study.rows)
    if study.shard is not None and study.rows is not None:
        files = [study.shard.file(study.rows)]
    with contextlib.ExitStack() as held:
        if study.shard is None:
            held.enter_context(only_one(out, "sweep"))
        for path in (path for path in files if path != study.rows):
            lock = hold(path.parent, f"shard ({path.name})", name=f".{path.stem}{LOCK}")
            held.callback(lock.release)
            path.touch()
        yield


# -- one run ---------------------------------------------------------------------------------------


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

    try:
        if not run.is_trained:
            run.train(report)
    except Stopped:  # it has saved
        return
    run.results(**load_config(folder).final.arguments())


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


def start_worker(folder: Path) -> BaseProcess:
    """Start a process that executes the run in `folder`; its output goes to `log.txt`.

    Where the system can, the process is forked from a server that has imported this module and
    torch once.
    """
    forks = FORK_SERVER in get_all_start_methods()
    context: Any = get_context(FORK_SERVER if forks else "spawn")
    if forks:
        # the server looks for modules in the working folder first, where another `train` may be
        context.set_forkserver_preload(["pursuit.train.experiments.executors"])
    process = context.Process(target=work, args=(str(folder), environment()))
    process.start()
    return process


def work(folder: str, variables: Mapping[str, str]) -> None:
    """The main function of a run's process."""
    if hasattr(os, "setsid"):  # Ctrl-C reaches only the study's process, which stops its runs
        os.setsid()
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


def record_run(study: Study, folder: Path) -> None:
    """Write the row of a run that has ended, if the study has a file of rows."""
    if study.rows is not None:
        rows = study.rows if study.shard is None else study.shard.file(study.rows)
        record(rows, recorded_row(folder))


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
