"""Runs trained in bfloat16: their policies are evaluated in float32, as when they are loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from self_play_runs import make_run

from train.evaluation.scores import Score
from train.evaluation.self_play_metrics import exploited
from train.kinds import start
from train.networks import layers
from train.networks.layers import Trunk
from train.runs.folder import RUN, load_results
from train.runs.opponents import load_policy
from train.runs.parts import contest_of, settings_of

SMALL: dict[str, Any] = {"num_games": 32, "rollout_steps": 16, "minibatch_size": 256}
SMALL |= {"frames": 2048, "threads": 1}
SETTINGS: dict[str, dict[str, Any]] = {
    "exact": {"task": "chase", "maze": "3x3", "evaluate": "sampled"},
    "bag": {"task": "chase", "maze": "3x3", "evaluate": "sampled"},
    "recurrent": {"task": "chase", "maze": "3x3", "recurrent": "gru"},
    "arm": {"task": "reacher", "joints": 1, "max_steps": 40},
}


@pytest.mark.parametrize("case", SETTINGS)
def test_results_of_a_run_in_bfloat16_are_those_of_the_loaded_policy(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if case == "bag":  # the form of large mazes
        monkeypatch.setattr(layers, "first_layer_form", lambda num_rows: "bag")
    settings = settings_of(**SMALL, **SETTINGS[case], precision="bfloat16")
    run = start(RUN, settings, tmp_path / "run")
    trunk = run.trainee.learner.network.policy_trunk
    assert isinstance(trunk, Trunk) and trunk.autocast_bfloat16
    run.train()
    results = run.results(100)
    assert trunk.autocast_bfloat16 and results["precision"] == "bfloat16"
    stored = {score["name"]: score for score in results["scores"]}
    for name, greedy in (("learned", True), ("learned, sampled", False)):
        policy = load_policy(run.folder, greedy=greedy)
        loaded: Score = contest_of(settings.task, 100).score(name, policy)
        assert stored[name]["mean_steps"] == pytest.approx(loaded.mean_steps, rel=1e-6), name


def test_so_are_those_of_self_play(tmp_path: Path) -> None:
    run = make_run(tmp_path / "pair", precision="bfloat16", frames=5_000)
    run.train()
    stored = run.results(20)
    assert load_results(run.folder)["precision"] == stored["precision"] == "bfloat16"
    chaser, evader = (load_policy(run.folder / role, greedy=False) for role in ("chaser", "evader"))
    trainee = run.trainee
    loaded = exploited(trainee.game.task, chaser, evader, trainee.parts.game.discount)
    for name, value in loaded.items():
        assert stored["evaluation"][name] == pytest.approx(value, rel=1e-6, abs=1e-7), name
