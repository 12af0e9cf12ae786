"""Runs of a sweep that are forked are what they would be in processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest
import torch
from filelock import FileLock, Timeout

from train.experiments import warm as warm_module
from train.experiments.executors import run_locally
from train.experiments.study import prepare, status_of
from train.experiments.sweep import load_sweep
from train.experiments.warm import Forked, Gone, Warm, can_fork, starter
from train.experiments.worker import LOG, perform, start_worker
from train.runs.folder import load_checkpoint, read_metrics

SWEEP = """
episodes = 20
seeds = [0, 1]
[settings]
task = "maze"
maze = "2x2"
algorithm = "a2c"
frames = {frames}
max_steps = 40
num_games = 32
"""
SHORT = 640
LONG = 300_000  # saved for the first time after a twentieth of it


def folders_of(tmp_path: Path, out: str, frames: int) -> list[Path]:
    """The folders of two runs that have not begun."""
    (tmp_path / "s.toml").write_text(SWEEP.format(frames=frames))
    return [folder for _, folder in prepare(load_sweep(str(tmp_path / "s.toml")), tmp_path / out)]


def until(true: Callable[[], Any]) -> None:
    deadline = time.monotonic() + 120
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def same(first: Any, second: Any) -> bool:
    """Whether all tensors and values are equal bit for bit, but for the seconds."""
    if isinstance(first, dict):
        names = set(first) - {"seconds"}
        return names == set(second) - {"seconds"} and all(same(first[n], second[n]) for n in names)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, torch.Tensor):
        return torch.equal(first.nan_to_num(), second.nan_to_num())
    return bool(first == second)


def check_same(first: Path, second: Path) -> None:
    one, other = load_checkpoint(first), load_checkpoint(second)
    assert one["trainee"]["learner"]["frames"] >= SHORT and same(one, other)
    rows = [
        [{n: v for n, v in row.items() if "second" not in n} for row in read_metrics(folder)]
        for folder in (first, second)
    ]
    assert rows[0] == rows[1]


@pytest.fixture(scope="module")
def warm() -> Iterator[Warm]:
    process = Warm()
    yield process
    process.close()


# -- what is forked --------------------------------------------------------------------------------


def test_weights_are_those_of_another_process_bit_for_bit(warm: Warm, tmp_path: Path) -> None:
    """Of the second one, too: nothing of the first is left."""
    _, elsewhere = folders_of(tmp_path, "elsewhere", SHORT)
    for folder in folders_of(tmp_path, "forked", SHORT):
        assert Forked(warm, folder).wait() == 0 and status_of(folder) == "complete"
    perform(elsewhere)
    check_same(folder, elsewhere)


@pytest.mark.slow
def test_weights_are_those_of_a_process_of_its_own(warm: Warm, tmp_path: Path) -> None:
    forked, own = (folders_of(tmp_path, out, 20_000)[0] for out in ("forked", "own"))
    running = [Forked(warm, forked), start_worker(own)]
    assert [process.wait() for process in running] == [0, 0]
    check_same(forked, own)


def test_ends_are_seen_and_signals_reach_the_run_alone(warm: Warm, tmp_path: Path) -> None:
    first, second = folders_of(tmp_path, "out", LONG)
    stopped, killed = Forked(warm, first), Forked(warm, second)
    until(lambda: all((folder / "checkpoint.pt").exists() for folder in (first, second)))
    number = killed.pid
    assert os.getsid(number) == number  # Ctrl-C of a terminal passes it by
    found = subprocess.run(["pgrep", "-x", second.name[-15:]], capture_output=True, text=True)
    assert found.stdout.split() == [str(number)]
    stopped.send_signal(signal.SIGINT)
    assert stopped.wait() == 0 and killed.poll() is None
    assert status_of(first) == "interrupted" and load_checkpoint(first)["trainee"]
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    killed.send_signal(signal.SIGKILL)  # it has ended: nobody is hit
    (second / "checkpoint.pt").write_bytes(b"no checkpoint")
    damaged = Forked(warm, second)
    assert damaged.wait() == 1
    log = (second / LOG).read_text()
    assert "Traceback" in log and "damaged" in log.splitlines()[-1]


@pytest.mark.slow
def test_runs_save_and_end_with_the_process_that_forked_them(tmp_path: Path) -> None:
    folder, _ = folders_of(tmp_path, "out", LONG)
    warm = Warm()
    run = Forked(warm, folder)
    until((folder / "checkpoint.pt").exists)
    lock = FileLock(folder / ".worker.lock")
    with pytest.raises(Timeout), lock.acquire(blocking=False):
        pass
    warm._process.kill()
    warm._process.wait()
    with lock.acquire(timeout=60):
        assert status_of(folder) == "interrupted"
        frames = load_checkpoint(folder)["trainee"]["learner"]["frames"]
    assert frames > 0
    # Whoever still wants it done has it done by a new process, from there.
    assert run.poll() is None
    until(lambda: lock_is_held(folder))
    run.send_signal(signal.SIGINT)
    run.wait()
    assert load_checkpoint(folder)["trainee"]["learner"]["frames"] >= frames
    with pytest.raises(Gone):
        warm.ask("poll", run.pid)


def lock_is_held(folder: Path) -> bool:
    try:
        with FileLock(folder / ".worker.lock").acquire(blocking=False):
            return False
    except Timeout:
        return True


@pytest.mark.slow
def test_a_script_without_a_guard_is_run_once(tmp_path: Path) -> None:
    folders_of(tmp_path, "none", SHORT)
    (tmp_path / "script.py").write_text(
        "from pathlib import Path\n"
        "from train.experiments.executors import run_locally\n"
        "from train.experiments.sweep import load_sweep\n"
        "print('begun', flush=True)\n"
        f"sweep = load_sweep({str(tmp_path / 's.toml')!r})\n"
        f"print(run_locally(sweep, Path({str(tmp_path / 'out')!r}), 2, lambda *_: None).values())\n"
    )
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True)
    assert done.stdout.count("begun") == 1 and done.stdout.count("complete") == 2, done.stderr
    for log in (tmp_path / "out").glob(f"runs/*/{LOG}"):
        assert "begun" not in log.read_text()


# -- who forks, and who does not -------------------------------------------------------------------


def test_only_a_process_of_one_thread_forks() -> None:
    over = Event()
    thread = Thread(target=over.wait)
    thread.start()
    try:
        assert not can_fork()
    finally:
        over.set()
        thread.join()


def test_where_nobody_forks_a_new_process_does_the_job(tmp_path: Path) -> None:
    folder, _ = folders_of(tmp_path, "out", SHORT)
    with starter(2, ["no_module_of_this_name"]) as start:
        process = start(folder)
        assert process.pid > 0 and process.wait() == 0
    assert status_of(folder) == "complete"


def test_one_run_or_a_system_without_forks_needs_no_more_than_one_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(warm_module, "Warm", None)
    with starter(1) as start:
        assert start is start_worker
    monkeypatch.delattr(os, "fork")
    with starter(8) as start:
        assert start is start_worker


def test_an_answer_that_nobody_waited_for_is_passed_over() -> None:
    """As after Ctrl-C between a question and its answer."""
    asked = Warm.__new__(Warm)
    asked._asked = 4
    code = "print('[4, 77]\\n7]\\nnoise\\n[5, null]', flush=True); import time; time.sleep(60)"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as asked._process:
        assert asked.ask("poll", 1) is None and asked._asked == 5
        asked._process.kill()


@pytest.mark.slow
def test_a_sweep_whose_forking_process_is_killed_is_completed(tmp_path: Path) -> None:
    folders = folders_of(tmp_path, "out", 60_000)
    killed: list[int] = []

    def kill(statuses: dict[str, str], progress: dict[str, float]) -> None:
        if not killed and (folders[0] / "checkpoint.pt").exists():
            found = subprocess.run(
                ["pgrep", "-P", str(os.getpid()), "-f", "experiments.warm"],
                capture_output=True,
                text=True,
            )
            killed.extend(int(number) for number in found.stdout.split())
            os.kill(killed[0], signal.SIGKILL)

    sweep = load_sweep(str(tmp_path / "s.toml"))
    statuses = run_locally(sweep, tmp_path / "out", 1, kill)
    assert len(killed) == 1 and set(statuses.values()) == {"complete"}
