"""The runs of a sweep as tasks of a Ray cluster."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pursuit.plugins import allowed
from train.experiments.study import ERROR, Told, status_of
from train.experiments.worker import put_files, shipment, work_elsewhere
from train.settings.checks import check

LAST_WORD = 120.0
"""Seconds that runs have for saving after Ctrl-C, before they are left to themselves."""

SECONDS_TO_ANSWER = 5.0
"""How long the answer of a cluster is waited for."""

Files = dict[str, bytes]


def check_answers(address: str | None) -> None:
    """Refuse an address where nobody answers; None, "auto" and "local" are for Ray to find out.

    Raises:
        ValueError: no address, or no answer within SECONDS_TO_ANSWER.
    """
    if address in (None, "auto", "local"):
        return
    host, _, port = str(address).removeprefix("ray://").rpartition(":")
    check(
        bool(host) and port.isdecimal() and 0 < int(port) < 2**16,
        f"address={address!r}; give auto, HOST:PORT or ray://HOST:PORT",
    )
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=SECONDS_TO_ANSWER).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"address={address!r}: no Ray cluster answers there ({reason}); start one by "
            "`ray start --head`, or leave the address out"
        ) from None


class Exchange:
    """Where runs on other machines hand over what they saved, and hear when to stop: a Ray actor.

    Attributes:
        files: of every run that has saved, as it was then.
        fresh: those that nobody has taken since.
        progress: of every run that is being done.
        stopping: whether all are to save and stop.
    """

    def __init__(self) -> None:
        self.files: dict[str, Files] = {}
        self.fresh: set[str] = set()
        self.progress: dict[str, float] = {}
        self.stopping = False

    def tell(self, name: str, progress: float, files: Files | None) -> bool:
        """Hear of a run; answers whether it is to stop."""
        self.progress[name] = progress
        if files is not None:
            self.files[name] = files
            self.fresh.add(name)
        return self.stopping

    def latest(self, name: str) -> Files:
        """What a run last saved; nothing where it has not."""
        return self.files.get(name, {})

    def take(self) -> tuple[dict[str, Files], dict[str, float]]:
        """What was saved since the last call, and the progress of all."""
        taken = {name: self.files[name] for name in self.fresh}
        self.fresh = set()
        return taken, self.progress

    def end(self, name: str) -> None:
        """Forget a run: it has ended, and what it left was brought to the sweep."""
        for kept in (self.files, self.progress):
            kept.pop(name, None)
        self.fresh.discard(name)

    def stop(self) -> dict[str, float]:
        """From now on everybody is to stop; the progress of those who are at it."""
        self.stopping = True
        return self.progress

    def all(self) -> dict[str, Files]:
        """What everybody last saved."""
        return self.files


def make_exchange(ray: Any) -> Any:
    """An exchange on the machine of this process: it lives as long as the sweep does."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    return ray.remote(num_cpus=0, scheduling_strategy=here)(Exchange).remote()


def do_one(name: str, files: Files, exchange: Any, trusted: tuple[str, ...] = ()) -> Files:
    """Do one run on whatever machine this is; where another one has begun, from what that saved."""
    import ray

    def tell(progress: float, saved: Files | None) -> bool:
        return bool(ray.get(exchange.tell.remote(name, progress, saved)))

    return work_elsewhere(files | ray.get(exchange.latest.remote(name)), tell, trusted)


def do_tasks(ray: Any, todo: dict[str, Path], folders: dict[str, Path], told: Told) -> None:
    """All of `todo` as Ray tasks; a task whose machine or process dies is done again.

    Args:
        ray: the module, initialised.
        todo: the folders of the runs to do, by name.
        folders: of all runs of the sweep.
        told: is told how far it is.

    Raises:
        KeyboardInterrupt: what the runs saved is in their folders.
    """
    exchange = make_exchange(ray)
    remote = ray.remote(num_cpus=1, max_retries=5)(do_one)
    tasks = {
        remote.remote(name, shipment(folder), exchange, allowed()): name
        for name, folder in todo.items()
    }
    statuses = {name: status_of(folder) for name, folder in folders.items()}

    def bring(ready: Iterable[Any], stopping: bool = False) -> None:
        for task in ready:
            name = tasks[task]
            try:
                put_files(todo[name], ray.get(task))
            except ray.exceptions.RayError as error:
                if not stopping:  # else it was cancelled before it began
                    put_files(todo[name], {ERROR: f"{type(error).__name__}: {error}\n".encode()})
            ray.get(exchange.end.remote(name))
            statuses[name] = status_of(todo[name])
            del tasks[task]

    try:
        while tasks:
            ready, _ = ray.wait(list(tasks), timeout=0.5)
            bring(ready)
            saved, progress = ray.get(exchange.take.remote())
            for name, files in saved.items():
                put_files(todo[name], files)
            statuses |= dict.fromkeys(progress, "running")
            told(statuses, progress)
    except KeyboardInterrupt:
        begun = ray.get(exchange.stop.remote())
        for task, name in tasks.items():
            if name not in begun:
                ray.cancel(task)
        until = time.monotonic() + LAST_WORD
        while tasks and time.monotonic() < until:
            ready, _ = ray.wait(list(tasks), timeout=0.5)
            bring(ready, stopping=True)
        for name, files in ray.get(exchange.all.remote()).items():
            put_files(todo[name], files)
        raise
