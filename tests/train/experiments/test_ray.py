"""Sweeps on a Ray cluster: every run is executed and counted exactly once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from executed_here import executed_here
from test_sweeps import TINY, silent, write

from train.experiments.executors import run_locally, run_on_ray
from train.experiments.expansion import load_study
from train.experiments.rows import read_all
from train.experiments.runs import status_of
from train.files import read_json
from train.kinds import open_run


@pytest.fixture(scope="module")
def cluster() -> Any:
    """A local Ray cluster of three nodes; the head has no cores for runs."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        found.add_node(num_cpus=1)
    ray.init(address=found.address, log_to_driver=False)
    yield found
    ray.shutdown()
    found.shutdown()


@pytest.mark.slow
def test_ray_gives_the_results_of_this_machine_once_each_when_a_node_dies(
    cluster: Any, tmp_path: Path
) -> None:
    text = TINY.replace("frames = 2000", "frames = 20000").replace(', "q_learning"', "")
    sweep, out = load_study(write(tmp_path / "tiny.toml", text)), tmp_path / "out"
    removed: list[Any] = []

    def kill(statuses: dict[str, str], progress: dict[str, float]) -> None:
        workers = [node for node in cluster.list_all_nodes() if node is not cluster.head_node]
        if not removed and list(statuses.values()).count("complete") >= 1:
            removed.append(workers[0])
            cluster.remove_node(workers[0], allow_graceful=False)
            cluster.add_node(num_cpus=1)

    statuses = run_on_ray(sweep, out, None, kill)
    assert removed
    assert statuses == dict.fromkeys((run.name for run in sweep.runs), "complete")
    study = read_all(out)
    assert len(study.everything) == len(study.curves) == 4
    for rows in study.curves.values():
        assert len({row["frames"] for row in rows}) == len(rows)
    # A budget of frames repeats exactly.
    local = tmp_path / "local"
    with executed_here():
        run_locally(sweep, local, 1, silent)
    for run in sweep.runs:
        ours, theirs = (
            read_json(each / "runs" / run.name / "results.json") for each in (local, out)
        )
        assert ours["evaluation"] == theirs["evaluation"]


LONG = """
episodes = 5
[settings]
task = "maze"
maze = "3x3"
algorithm = "a2c"
frames = 8000000
num_games = 32
[search]
samples = 4
learning_rate = {low = 1e-4, high = 1e-2}
"""


@pytest.mark.slow
def test_control_c_keeps_the_progress_of_ray_tasks(cluster: Any, tmp_path: Path) -> None:
    sweep = load_study(write(tmp_path / "long.toml", LONG))
    out = tmp_path / "out"

    def interrupt(statuses: dict[str, str], progress: dict[str, float]) -> None:
        if any(share > 0.1 for share in progress.values()):  # after the first evaluation
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_on_ray(sweep, out, None, interrupt)
    statuses = [status_of(out / "runs" / run.name) for run in sweep.runs]
    assert "interrupted" in statuses and set(statuses) <= {"interrupted", "new"}
    for run, status in zip(sweep.runs, statuses, strict=True):
        if status == "interrupted":
            found = open_run(out / "runs" / run.name)
            assert found.trainee.frames > 0 and found.rows
