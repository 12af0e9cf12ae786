"""Self-play that is killed by SIGKILL at any moment resumes to the same weights."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

import pytest
import torch
from waiting import wait_until

from train.commands.main import main
from train.runs.folder import METRICS, RESULTS, load_checkpoint

RUN = [
    *("self-play", "--maze", "3x3-tree", "--frames", "60000", "--num-games", "32", "--width", "16"),
    *("--minibatch-size", "128", "--snapshots", "12", "--pool-size", "12", "--members", "astar"),
    *("--episodes", "20"),
]


def kill_during(command: list[str], folder: Path, rows: int, wait: float) -> None:
    """Run a command, and kill it `wait` seconds after its `rows`-th evaluation."""
    words = [sys.executable, "-m", "train.commands.main", *command]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL) as process:
        metrics = folder / METRICS
        wait_until(lambda: metrics.exists() and metrics.read_text().count("\n") > rows, process)
        time.sleep(wait)
        process.kill()
        assert process.wait() == -signal.SIGKILL


@pytest.mark.slow
@pytest.mark.parametrize("sampling", ["uniform", "psro"])
def test_a_run_that_was_killed_ends_with_the_same_weights(sampling: str, tmp_path: Path) -> None:
    first = [*RUN, "--sampling", sampling]
    whole, killed, random = tmp_path / "whole", tmp_path / "killed", Random(sampling)
    main([*first, "--out", str(whole)])
    kill_during([*first, "--out", str(killed)], killed, 3, random.uniform(0.0, 0.3))
    kill_during(["self-play", "--resume", str(killed)], killed, 10, random.uniform(0.0, 0.3))
    assert not (killed / RESULTS).exists()
    main(["self-play", "--resume", str(killed)])
    ends = [load_checkpoint(folder)["trainee"]["sides"] for folder in (whole, killed)]
    for role in ("chaser", "evader"):
        networks = [end[role]["learner"]["network"] for end in ends]
        assert all(torch.equal(weight, networks[1][name]) for name, weight in networks[0].items())
        names = [sorted(p.name for p in (f / "pool" / role).iterdir()) for f in (whole, killed)]
        assert names[0] == names[1] and len(names[0]) == 12
        for name in names[0]:
            one, two = (torch.load(f / "pool" / role / name)["network"] for f in (whole, killed))
            assert all(torch.equal(weight, two[key]) for key, weight in one.items())
