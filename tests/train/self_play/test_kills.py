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
    *("self-play", "--maze", "3x3-tree", "--frames", "12000", "--num-games", "32", "--width", "16"),
    *("--minibatch-size", "128", "--snapshots", "4", "--pool-size", "4", "--members", "astar"),
    *("--sampling", "psro", "--episodes", "20"),
]


@pytest.mark.slow
def test_a_run_that_was_killed_ends_with_the_same_weights(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    main([*RUN, "--out", str(whole)])
    words = [sys.executable, "-m", "train.commands.main", *RUN, "--out", str(killed)]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL) as process:
        metrics = killed / METRICS
        wait_until(lambda: metrics.exists() and metrics.read_text().count("\n") > 3, process)
        time.sleep(Random("psro").uniform(0.0, 0.3))
        process.kill()
        assert process.wait() == -signal.SIGKILL
    assert not (killed / RESULTS).exists()
    main(["self-play", "--resume", str(killed)])
    ends = [load_checkpoint(folder)["trainee"]["sides"] for folder in (whole, killed)]
    for role in ("chaser", "evader"):
        networks = [end[role]["learner"]["network"] for end in ends]
        assert all(torch.equal(weight, networks[1][name]) for name, weight in networks[0].items())
        names = [sorted(p.name for p in (f / "pool" / role).iterdir()) for f in (whole, killed)]
        assert names[0] == names[1] and len(names[0]) == 4
        for name in names[0]:
            one, two = (torch.load(f / "pool" / role / name)["network"] for f in (whole, killed))
            assert all(torch.equal(weight, two[key]) for key, weight in one.items())
