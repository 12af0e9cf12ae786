"""Jobs in separate processes give the same results as in this one, and react to signals."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from waiting import wait_until

from train.experiments.executors import LOG, LocalJob, perform
from train.experiments.expansion import load_study
from train.experiments.runs import prepare, status_of
from train.machine import usable_cores
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
    """The folders of two new runs."""
    (tmp_path / "s.toml").write_text(SWEEP.format(frames=frames))
    return [folder for _, folder in prepare(load_study(str(tmp_path / "s.toml")), tmp_path / out)]


def ended(job: LocalJob) -> int:
    wait_until(lambda: job.poll() is not None)
    code = job.poll()
    assert code is not None
    return code


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


@pytest.mark.slow
def test_weights_are_those_of_another_process_bit_for_bit(tmp_path: Path) -> None:
    """Of the second one, too: nothing of the first is left."""
    _, elsewhere = folders_of(tmp_path, "elsewhere", SHORT)
    for folder in folders_of(tmp_path, "processes", SHORT):
        assert ended(LocalJob(folder, None)) == 0 and status_of(folder) == "complete"
    perform(elsewhere)
    one, other = load_checkpoint(folder), load_checkpoint(elsewhere)
    assert one["trainee"]["learner"]["frames"] >= SHORT and same(one, other)
    rows = [
        [{n: v for n, v in row.items() if "second" not in n} for row in read_metrics(each)]
        for each in (folder, elsewhere)
    ]
    assert rows[0] == rows[1]


def test_all_cores_may_be_used_where_the_system_does_not_say_which(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # as on macOS
    assert usable_cores() == list(range(os.cpu_count() or 1))


@pytest.mark.slow
def test_exits_are_noticed_and_signals_reach_only_the_run(tmp_path: Path) -> None:
    first, second = folders_of(tmp_path, "out", LONG)
    stopped, killed = LocalJob(first, None), LocalJob(second, None)
    wait_until(lambda: all((folder / "checkpoint.pt").exists() for folder in (first, second)))
    number = killed.process.pid
    assert (
        number is not None and os.getsid(number) == number
    )  # Ctrl-C of a terminal does not reach it
    stopped.stop()
    assert ended(stopped) == 0 and killed.poll() is None
    assert status_of(first) == "interrupted" and load_checkpoint(first)["trainee"]
    os.kill(number, signal.SIGKILL)
    assert ended(killed) == -signal.SIGKILL
    killed.stop()  # no effect after its end
    (second / "checkpoint.pt").write_bytes(b"no checkpoint")
    assert ended(LocalJob(second, None)) == 1
    log = (second / LOG).read_text()
    assert "Traceback" in log and "damaged" in log.splitlines()[-1]


@pytest.mark.slow
def test_a_script_runs_a_study(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SWEEP.format(frames=SHORT).replace("[0, 1]", "[0]"))
    (tmp_path / "script.py").write_text(
        "from pathlib import Path\n"
        "from train.experiments.executors import run_locally\n"
        "from train.experiments.expansion import load_study\n"
        "if __name__ == '__main__':\n"
        f"    sweep = load_study({str(tmp_path / 's.toml')!r})\n"
        f"    out = Path({str(tmp_path / 'out')!r})\n"
        "    print(run_locally(sweep, out, 2, lambda *_: None).values())\n"
    )
    done = subprocess.run([sys.executable, tmp_path / "script.py"], capture_output=True, text=True)
    assert done.stdout.count("complete") == 1, done.stderr


@pytest.mark.slow
def test_a_process_that_imports_only_the_worker_knows_all_kinds_of_runs() -> None:
    code = "import train.experiments.executors, train.kinds; print(*sorted(train.kinds.KINDS))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["contestant", "self-play", "single"]
