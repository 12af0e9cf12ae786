"""Sweeps on a Ray cluster: nothing is lost, and nothing counted twice."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from test_sweeps import TINY, silent, write

from train.commands.main import main
from train.experiments import on_ray
from train.experiments.executors import run_locally, run_on_ray
from train.experiments.kinds import open_run
from train.experiments.on_ray import make_exchange
from train.experiments.sweep import STOPPED, load_sweep, prepare, status_of
from train.experiments.tables import collect
from train.runs.loop import EVALUATIONS

# -- Ray -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster() -> Any:
    """A local Ray cluster of three nodes; the head has no cores for runs."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    found = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    for _ in range(2):
        found.add_node(num_cpus=1)
    yield found
    found.shutdown()


@pytest.mark.slow
def test_ray_gives_the_results_that_this_machine_gives(cluster: Any, tmp_path: Path) -> None:
    import ray

    text = TINY.replace(', "q_learning"', "").replace('"2x2", "3x3"', '"2x2"')
    sweep, out = load_sweep(write(tmp_path / "tiny.toml", text)), tmp_path / "out"
    ray.init(address=cluster.address, log_to_driver=False)
    try:
        statuses = run_on_ray(sweep, out, None, silent)
    finally:
        ray.shutdown()
    assert statuses == dict.fromkeys((run.name for run in sweep.runs), "complete")
    # A budget of frames repeats exactly.
    local = tmp_path / "local"
    run_locally(replace(sweep, runs=sweep.runs[:1]), local, 1, silent)
    name = sweep.runs[0].name
    evaluations = [
        json.loads((folder / "runs" / name / "results.json").read_text())["evaluation"]
        for folder in (out, local)
    ]
    assert evaluations[0] == evaluations[1]


@pytest.mark.slow
def test_ray_loses_nothing_and_counts_nothing_twice_when_a_node_dies(
    cluster: Any, tmp_path: Path
) -> None:
    import ray

    text = TINY.replace("frames = 2000", "frames = 20000").replace(', "q_learning"', "")
    sweep, out = load_sweep(write(tmp_path / "tiny.toml", text)), tmp_path / "out"
    ray.init(address=cluster.address, log_to_driver=False)
    removed: list[Any] = []

    def kill(statuses: dict[str, str], progress: dict[str, float]) -> None:
        workers = [node for node in cluster.list_all_nodes() if node is not cluster.head_node]
        if not removed and list(statuses.values()).count("complete") >= 1:
            removed.append(workers[0])
            cluster.remove_node(workers[0], allow_graceful=False)
            cluster.add_node(num_cpus=1)

    try:
        statuses = run_on_ray(sweep, out, None, kill)
    finally:
        ray.shutdown()
    assert removed
    assert statuses == dict.fromkeys((run.name for run in sweep.runs), "complete")
    runs, curves = collect(out)
    assert len(runs) == 4 and runs["run"].n_unique() == 4
    assert curves.select("run", "frames").is_unique().all()


@pytest.mark.slow
def test_asha_stops_the_worst_early(cluster: Any, tmp_path: Path) -> None:
    import ray

    text = """
    episodes = 20
    [settings]
    task = "maze"
    maze = "3x3"
    algorithm = "a2c"
    frames = 150000
    num_games = 32
    [search]
    samples = 6
    scheduler = "asha"
    learning_rate = {choices = [1e-6, 1e-2]}
    """
    path = write(tmp_path / "asha.toml", text)
    with pytest.raises(SystemExit):
        main(["sweep", path, "--out", str(tmp_path / "local")])
    sweep, out = load_sweep(path), tmp_path / "out"
    ray.init(address=cluster.address, log_to_driver=False)
    try:
        statuses = run_on_ray(sweep, out, None, silent)
    finally:
        ray.shutdown()
    assert set(statuses.values()) <= {"complete", "stopped"} and "complete" in statuses.values()
    runs, _ = collect(out)
    assert runs["mean_steps"].null_count() == 0


LONG = """
episodes = 5
[settings]
task = "maze"
maze = "3x3"
algorithm = "a2c"
frames = 2000000
num_games = 32
[search]
samples = 4
{scheduler}
learning_rate = {{low = 1e-4, high = 1e-2}}
"""


@pytest.mark.slow
def test_control_c_brings_back_what_ray_did(cluster: Any, tmp_path: Path) -> None:
    import ray

    sweep = load_sweep(write(tmp_path / "long.toml", LONG.format(scheduler="")))
    out = tmp_path / "out"

    def interrupt(statuses: dict[str, str], progress: dict[str, float]) -> None:
        if any(progress.values()):
            raise KeyboardInterrupt

    ray.init(address=cluster.address, log_to_driver=False)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_on_ray(sweep, out, None, interrupt)
    finally:
        ray.shutdown()
    statuses = [status_of(out / "runs" / run.name) for run in sweep.runs]
    assert "interrupted" in statuses and set(statuses) <= {"interrupted", "new"}
    for run, status in zip(sweep.runs, statuses, strict=True):
        if status == "interrupted":
            found = open_run(out / "runs" / run.name)
            assert found.trainee.frames > 0 and found.metrics.rows


@pytest.mark.slow
def test_control_c_under_asha_stops_nobody_for_ever(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray

    scheduler = 'scheduler = "asha"'
    sweep = load_sweep(write(tmp_path / "long.toml", LONG.format(scheduler=scheduler)))
    out, begun = tmp_path / "out", threading.Event()

    def watched(ray: Any) -> Any:
        exchange = make_exchange(ray)

        def interrupt() -> None:
            while not ray.get(exchange.all.remote()):
                time.sleep(0.5)
            begun.set()
            os.kill(os.getpid(), signal.SIGINT)

        threading.Thread(target=interrupt, daemon=True).start()
        return exchange

    monkeypatch.setattr(on_ray, "make_exchange", watched)
    ray.init(address=cluster.address, log_to_driver=False)
    try:
        with pytest.raises(KeyboardInterrupt):
            run_on_ray(sweep, out, None, silent)
    finally:
        ray.shutdown()
    statuses = [status_of(out / "runs" / run.name) for run in sweep.runs]
    assert begun.is_set()
    assert "interrupted" in statuses and set(statuses) <= {"interrupted", "new"}


class Here:
    """An `Exchange` in this process, called as an actor; tells runs to stop after some reports."""

    def __init__(self, reports: list[dict[str, Any]], stop_after: int) -> None:
        self.exchange, self.reports, self.stop_after = on_ray.Exchange(), reports, stop_after

    def __getattr__(self, name: str) -> Any:
        def call(*given: Any) -> Any:
            answer = getattr(self.exchange, name)(*given)
            return len(self.reports) >= self.stop_after if name == "tell" else answer

        return SimpleNamespace(remote=call)


def test_a_run_that_is_resumed_under_asha_goes_on_counting_its_evaluations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    from ray import tune

    class InThisProcess:
        def __init__(self, trainable: Any, param_space: Any, **_: Any) -> None:
            self.trainable, self.runs = trainable, param_space["run"]["grid_search"]

        def fit(self) -> list[Any]:
            for name in self.runs:
                self.trainable({"run": name})
            return []

    reports: list[dict[str, Any]] = []
    monkeypatch.setattr(tune, "Tuner", InThisProcess)
    monkeypatch.setattr(tune, "with_resources", lambda trainable, _: trainable)
    monkeypatch.setattr(tune, "report", reports.append)
    monkeypatch.setenv("TUNE_DISABLE_SIGINT_HANDLER", "1")
    text = TINY.replace(', "q_learning"', "").replace('"2x2", "3x3"', '"2x2"')
    text = text.replace("frames = 2000", "frames = 20000")
    sweep, out = load_sweep(write(tmp_path / "tiny.toml", text)), tmp_path / "out"
    prepare(sweep, out)
    folders = {sweep.runs[0].name: out / "runs" / sweep.runs[0].name}
    ray = SimpleNamespace(get=lambda found: found)
    for stop_after in (5, 1000):
        here = Here(reports, stop_after)
        monkeypatch.setattr(on_ray, "make_exchange", lambda _, here=here: here)
        on_ray.tune(ray, folders, 5, folders, silent)
        if stop_after == 5:
            assert 5 <= len(reports) < EVALUATIONS
            (next(iter(folders.values())) / STOPPED).unlink()
    counted = [report["evaluations"] for report in reports]
    assert counted == sorted(counted) and counted[-1] == EVALUATIONS
    assert status_of(next(iter(folders.values()))) == "complete"
