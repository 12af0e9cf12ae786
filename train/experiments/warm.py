"""Several jobs of a study, each in a process of its own that need not import everything anew.

To import torch and what else a job needs takes seconds. So one process imports it, once, has one
thread only, and forks for every job; a forked process is what `worker.start_worker` would have
started, from its imports on. `multiprocessing` has a fork server, but what that forks imports the
caller's `__main__`: a user's script without a guard would begin its study again in every job.

The sweep asks in lines of JSON, [number, verb, ...], on the standard input of that process, which
answers [number, value]. The standard input of what it forks is a pipe whose other end it alone
holds: when it ends, because the sweep has ended or however else, they hear so.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from train.experiments.worker import (
    LOG,
    POLL,
    end_with_the_sweep,
    perform,
    start_worker,
    worker_environment,
)
from train.runs.threads import can_fork


class Process(Protocol):
    """Whoever does a job; as `subprocess.Popen` has it."""

    @property
    def pid(self) -> int:
        """Its number."""

    def poll(self) -> int | None:
        """Its exit status, negative where a signal ended it; None while it runs."""

    def wait(self) -> int:
        """The same once it has ended."""

    def send_signal(self, number: int, /) -> None:
        """Send it a signal, unless it has ended."""


# -- the process that forks ------------------------------------------------------------------------


def serve() -> Path | None:
    """Answer until the study is gone, then None; in what is forked, the folder of its job."""
    codes: dict[int, int | None] = {}
    heard, held = os.pipe()
    gc.freeze()  # nobody looks through what was imported, which would copy its memory
    for line in sys.stdin:
        number, verb, *given = json.loads(line)
        answer: Any = None
        if verb == "start":
            answer = os.fork()
            if not answer:
                os.close(held)
                begin(Path(given[0]), heard)
                return Path(given[0])
            codes[answer] = None
        else:  # of a process that is not waited for the number is nobody else's
            process, *others = given
            if verb == "poll" and codes[process] is None:
                ended, status = os.waitpid(process, os.WNOHANG)
                codes[process] = os.waitstatus_to_exitcode(status) if ended else None
            elif verb == "signal" and codes[process] is None:
                os.kill(process, *others)
            answer = codes[process]
        print(json.dumps([number, answer]), flush=True)
    return None


def begin(folder: Path, heard: int) -> None:
    """Make a forked process one of its own: its session, name, log, end and random numbers."""
    os.setsid()
    Path("/proc/self/comm").write_text(folder.name[-15:])  # `ps` and `pgrep` find the run by it
    os.dup2(heard, 0)
    os.close(heard)
    with (folder / LOG).open("ab") as log:
        for said in (1, 2):
            os.dup2(log.fileno(), said)
    np.random.seed()  # noqa: NPY002 -- we use it nowhere, users' parts may: as if imported anew


# -- whoever asks it -------------------------------------------------------------------------------


class Gone(Exception):
    """The process that forks has ended."""


class Warm:
    """The process that forks, as the study sees it; `modules` are those that jobs need, too."""

    def __init__(self, modules: Iterable[str] = ()) -> None:
        self._asked = 0
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "train.experiments.warm", *modules],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # where it cannot import, the runs' own processes say why
            bufsize=0,  # an interrupted question leaves nothing behind
            env=worker_environment(),
            start_new_session=True,
        )

    def ask(self, *question: Any) -> Any:
        """The answer to a verb and what belongs to it.

        Raises:
            Gone: there is nobody to answer.
        """
        assert self._process.stdin is not None and self._process.stdout is not None
        self._asked += 1
        try:
            self._process.stdin.write(json.dumps([self._asked, *question]).encode() + b"\n")
        except BrokenPipeError:
            raise Gone from None
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):  # the rest of an answer nobody waited for
                answer = json.loads(line)
                if isinstance(answer, list) and answer[:1] == [self._asked]:
                    return answer[1]
        raise Gone

    def close(self) -> None:
        """End it, and so all that still runs."""
        self._process.kill()
        with self._process:  # its pipes
            pass


class Forked:
    """The process of a job that was forked; a new one, where the one that forks has gone."""

    def __init__(self, warm: Warm, folder: Path) -> None:
        self._warm, self._folder = warm, folder
        self._code: int | None = None
        self._new: Process | None = None
        try:
            self.pid = warm.ask("start", str(folder))
        except Gone:
            self._new = start_worker(folder)
            self.pid = self._new.pid

    def poll(self) -> int | None:
        """Its exit status, negative where a signal ended it; None while it runs."""
        if self._new is None and self._code is None:
            try:
                self._code = self._warm.ask("poll", self.pid)
            except Gone:  # the run has heard of it: the new one waits until it has saved
                self._new = start_worker(self._folder)
        return self._code if self._new is None else self._new.poll()

    def wait(self) -> int:
        """The same once it has ended."""
        while (code := self.poll()) is None:
            time.sleep(POLL)
        return code

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self._new is not None:
            self._new.send_signal(number)
        elif self._code is None:
            try:
                self._code = self._warm.ask("signal", self.pid, number)
            except Gone:  # it ends anyway
                self._code = -number


@contextlib.contextmanager
def starter(jobs: int, modules: Iterable[str] = ()) -> Iterator[Callable[[Path], Process]]:
    """What starts the process of a job, given its folder.

    For several jobs it forks, where that is sound; else a new process does it. The results are the
    same. Processes that still run when it is left save and end.

    Args:
        jobs: how many there are.
        modules: that they need, imported once.
    """
    if jobs < 2 or not hasattr(os, "fork"):
        yield start_worker
        return
    warm = Warm(modules)
    try:
        yield partial(Forked, warm)
    finally:
        warm.close()


if __name__ == "__main__":
    for needed in sys.argv[1:]:
        importlib.import_module(needed)
    job = serve() if can_fork() else None  # whoever asks hears that this process has ended
    if job is not None:
        end_with_the_sweep()
        perform(job)
