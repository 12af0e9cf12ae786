"""A job of a study in a process of its own: here, or on another machine of a cluster.

The process ends when whoever started it is gone, however that ended: it hears so from the pipe that
is its standard input. And only one process at a time works on the folder of a job: the next waits.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory
from threading import Thread

from filelock import FileLock

from pursuit.plugins import allow, environment, look_in
from train.experiments.forms import LABEL
from train.experiments.identity import INPUTS, MODEL, named_policies, policy_files, put_policies
from train.experiments.identity import put_files as put
from train.experiments.kinds import open_run
from train.experiments.study import CALL, ERROR, OUTCOME, PROGRESS, status_of
from train.files import read_json, write_json, write_text
from train.runs.folder import CHECKPOINT, CONFIG, RESULTS, load_final
from train.runs.loop import Run
from train.runs.provenance import SOURCES, source_files

LOG = "log.txt"
LAST_WORD = 60.0
"""Seconds that a run whose sweep is gone has for saving, before it is ended."""
POLL = 0.2
"""Seconds between two looks at a run."""

Tell = Callable[[float, dict[str, bytes] | None], bool]
"""Called now and then with the progress of a run on another machine, and with its files whenever it
has saved; answers whether it is to stop."""


# -- the process -----------------------------------------------------------------------------------


def perform(folder: Path) -> None:
    """Do the job in `folder`, or go on with it, to its results."""
    with FileLock(folder / ".worker.lock"):  # a worker of a killed sweep may still be saving
        if status_of(folder) == "complete":
            return
        if (folder / CONFIG).exists():
            train(folder)
        else:
            call = read_json(folder / CALL)
            write_json(folder / OUTCOME, resolve_name(call["function"])(**call["given"]))


def train(folder: Path) -> None:
    """Do the run of a learner, and evaluate what it learned."""
    run = open_run(folder)

    def report(run: Run, row: dict[str, float]) -> None:
        if row:  # the checkpoint has been written, and all that belongs to it
            write_text(folder / PROGRESS, str(run.progress))

    if run.progress < 1.0:
        run.train(report)
    if not run.stopped:
        run.results(load_final(folder).episodes)


def end_with_the_sweep() -> None:
    """Stop this process, once it has saved, when the other end of its standard input is gone."""

    def listen() -> None:
        while os.read(0, 1024):
            pass
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(LAST_WORD)
        os._exit(128 + signal.SIGTERM)

    Thread(target=listen, daemon=True).start()


# -- whoever starts it -----------------------------------------------------------------------------


def worker_environment() -> dict[str, str]:
    """One core a run: the libraries' own threads would get in each other's way. Users' modules are
    found and trusted there as they are here."""
    single = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    found = {**os.environ, **single, **environment()}
    root = Path(__file__).parents[2]
    if "site-packages" not in root.parts:  # a source tree that is not installed, perhaps
        found["PYTHONPATH"] = os.pathsep.join(filter(None, (found.get("PYTHONPATH"), str(root))))
    return found


def start_worker(folder: Path) -> subprocess.Popen[bytes]:
    """A process that does the job in `folder`; what it says goes to `log.txt`."""
    with (folder / LOG).open("ab") as log:
        return subprocess.Popen(
            # -P: a train.py where the user happens to be must not stand in for ours.
            [sys.executable, "-P", "-m", "train.experiments.worker", str(folder)],
            stdin=subprocess.PIPE,  # closed when this process ends, however it ends
            stdout=log,
            stderr=subprocess.STDOUT,
            env=worker_environment(),
            start_new_session=True,  # Ctrl-C reaches the sweep alone, which passes it on once
        )


class Performed:
    """A job that was done in this process, as a process that has ended."""

    pid = 0

    def __init__(self, folder: Path) -> None:
        self._code = 0
        try:
            perform(folder)
        except Exception:  # whatever a job raises: the others go on
            self._code = 1
            write_text(folder / LOG, traceback.format_exc())

    def poll(self) -> int:
        """Its exit status."""
        return self._code

    wait = poll

    def send_signal(self, number: int) -> None:
        """Nothing: it has ended."""


def record_end(folder: Path, code: int) -> None:
    """Write down why a run failed, if it did."""
    if code == 0:
        return
    log = (folder / LOG).read_text(errors="replace").strip().splitlines()
    reason = log[-1] if log else "no output"
    if code < 0:
        reason = f"killed by signal {-code} ({signal.Signals(-code).name})"
    text = f"{reason}\n\nexit status {code}; the end of {LOG}:\n" + "\n".join(log[-30:]) + "\n"
    write_text(folder / ERROR, text)


def progress_of(folder: Path) -> float:
    """How far a running run says it is, in [0, 1]."""
    with contextlib.suppress(OSError, ValueError):
        found = float((folder / PROGRESS).read_text())
        return min(max(found, 0.0), 1.0) if math.isfinite(found) else 0.0
    return 0.0


# -- runs that travel ------------------------------------------------------------------------------


def work_elsewhere(
    files: dict[str, bytes],
    tell: Tell = lambda progress, files: False,
    trusted: Sequence[str] = (),
) -> dict[str, bytes]:
    """Do one run on whatever machine this is: files of its folder in, files out.

    Machines of a cluster need not share a disk. The run has a process of its own, so that a crash
    of it is its own, too.

    Args:
        files: what `shipment` gave.
        tell: hears of it; when it says so, the run saves and stops.
        trusted: modules that the files may name; users' own come with them.

    Returns:
        The files of the folder that belong to the run.
    """
    with TemporaryDirectory(prefix="pursuit-") as temporary:
        folder = Path(temporary)
        unpack(folder, files, trusted)
        process = start_worker(folder)
        told, stopping = None, False
        try:
            while process.poll() is None:
                time.sleep(POLL)
                saved, news = when_saved(folder), None
                if saved not in (None, told):
                    news = files_of(folder)
                    if when_saved(folder) == saved:  # nothing was written in between
                        told = saved
                    else:
                        news = None
                if tell(progress_of(folder), news) and not stopping:
                    stopping = True
                    process.send_signal(signal.SIGINT)
        finally:
            if process.poll() is None:  # nobody hears of it any more
                process.kill()
                process.wait()
        if not stopping:
            record_end(folder, process.returncode)
        return files_of(folder)


def when_saved(folder: Path) -> tuple[int, int] | None:
    """Tells two moments at which a run was saved apart; None before the first, and while it saves.

    The progress is written after the checkpoint and all that belongs to it.
    """
    try:
        checkpoint = (folder / CHECKPOINT).stat().st_mtime_ns
        progress = (folder / PROGRESS).stat().st_mtime_ns
    except OSError:
        return None
    return (checkpoint, progress) if progress >= checkpoint else None


def files_of(folder: Path) -> dict[str, bytes]:
    """The files of a run by their paths in the folder, without settings and what the sweep adds."""
    others = {CONFIG, LABEL, PROGRESS}
    found = {}
    for path in folder.rglob("*"):
        inner = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in inner.parts)
        if hidden or inner.parts[0] in (INPUTS, SOURCES) or str(inner) in others:
            continue
        with contextlib.suppress(FileNotFoundError, IsADirectoryError):  # renamed just now
            found[str(inner)] = path.read_bytes()
    return found


def shipment(folder: Path) -> dict[str, bytes]:
    """What a run needs to begin or to go on on another machine, with the policies that it reads and
    its users' own modules."""
    plain = read_json(folder / CONFIG)
    places = {}
    found = {name: c for name, c in files_of(folder).items() if name not in (LOG, ERROR)}
    found |= {f"{SOURCES}/{name}": content for name, content in source_files(plain).items()}
    for name, value in named_policies(plain).items():
        if Path(value).exists():
            inner = f"{INPUTS}/{name}"
            found |= {f"{inner}/{n}": c for n, c in policy_files(Path(value)).items()}
            places[name] = inner if Path(value).is_dir() else f"{inner}/{MODEL}"
    return found | {CONFIG: json.dumps(put_policies(plain, places)).encode()}


def unpack(folder: Path, files: dict[str, bytes], trusted: Sequence[str] = ()) -> None:
    """Write what `shipment` gave; the settings name the policies where they are now, and users'
    modules are found among the files and `trusted`."""
    put(folder, files)
    look_in(folder / SOURCES)
    allow(*trusted)
    plain = read_json(folder / CONFIG)
    places = {
        name: str(folder / value)
        for name, value in named_policies(plain).items()
        if value.startswith(f"{INPUTS}/")
    }
    write_json(folder / CONFIG, put_policies(plain, places))


def put_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write what came back: a checkpoint after what belongs to it, the results last of all."""
    put(folder, {n: files[n] for n in sorted(files, key=lambda n: (n == RESULTS, n == CHECKPOINT))})


if __name__ == "__main__":
    end_with_the_sweep()
    perform(Path(sys.argv[1]))
