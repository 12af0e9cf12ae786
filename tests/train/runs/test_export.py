"""Exported networks and datasets give what the policies play."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

import pursuit
import train
from scripted_agents import AStarChaser
from train.commands.main import main
from train.experiments.kinds import start


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short runs with several kinds of networks."""
    folder = tmp_path_factory.mktemp("runs")
    for name, changed in (
        ("index", {}),
        ("planes", {"observation": "planes"}),
        ("dqn", {"algorithm": "dqn", "learning_starts": 256}),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            settings = (
                train.settings_of(
                    maze="3x3", num_games=64, frames=4000, **changed, minibatch_size=256
                )
                if name != "dqn"
                else train.settings_of(maze="3x3", frames=4000, **changed)
            )
            start("single", settings, folder / name).train()
    return folder


@pytest.mark.parametrize("name", ["index", "planes", "dqn"])
@pytest.mark.parametrize("suffix", [".onnx", ".pt2"])
def test_an_exported_network_gives_the_same_probabilities(
    runs: Path, name: str, suffix: str, tmp_path: Path
) -> None:
    policy = train.load_policy(runs / name)
    path = train.export_policy(policy, tmp_path / f"policy{suffix}")
    sim = pursuit.Simulator(policy.task, num_games=7, seed=3)
    sim.reset()
    observed = sim.view(0).observe(policy.encoding)
    with torch.no_grad():
        known = torch.softmax(policy.network.logits(torch.from_numpy(observed)), -1).numpy()
    found: Any
    if suffix == ".pt2":
        found = torch.export.load(path).module()(torch.from_numpy(observed)).detach().numpy()
    else:
        runtime = pytest.importorskip("onnxruntime")
        session = runtime.InferenceSession(path)
        [found] = session.run(["probabilities"], {"observation": observed})
    np.testing.assert_allclose(found, known, atol=1e-5)
    np.testing.assert_array_equal(found.argmax(axis=1), policy.act(sim.view(0)))


def test_what_cannot_be_exported_is_refused(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = train.load_policy(runs / "index")
    with pytest.raises(ValueError, match=r"ends in \.onnx or \.pt2"):
        train.export_policy(policy, tmp_path / "policy.h5")
    with pytest.raises(ValueError, match="no network without memory"):
        train.export_policy(AStarChaser(), tmp_path / "policy.pt2")
    out = tmp_path / "made.pt2"
    assert main(["export", str(runs / "index"), "--out", str(out)]) in (0, None)
    assert "observation [batch, 3] (index)" in capsys.readouterr().out and out.exists()
    with pytest.raises(SystemExit):
        main(["export", str(runs / "index"), "--out", str(out)])
    assert "exists" in capsys.readouterr().err
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "changed, option",
    [({"frame_stack": 2}, "--frame-stack"), ({"recurrent": "gru"}, "--recurrent")],
)
def test_a_policy_with_memory_is_refused_by_its_option(
    changed: dict[str, Any], option: str, tmp_path: Path
) -> None:
    small = {"num_games": 8, "rollout_steps": 4, "minibatch_size": 16, "width": 8, "frames": 32}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = start("single", train.settings_of(maze="3x3", **small, **changed), tmp_path)
    with pytest.raises(ValueError) as refused:
        train.export_policy(run.trainee.policy, tmp_path / "policy.pt2")
    told = str(refused.value)
    assert [name for name in ("--frame-stack", "--recurrent") if name in told] == [option]


def test_a_minari_dataset_holds_the_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", opponent_epsilon=0.2)
    pursuit.export_minari("pursuit/test-v0", env, AStarChaser(), episodes=5, seed=7)
    saved = list(minari.load_dataset("pursuit/test-v0").iterate_episodes())
    assert len(saved) == 5
    for number, episode in enumerate(saved):
        observed, _ = env.reset(seed=7 + number)
        for step, action in enumerate(episode.actions):
            np.testing.assert_array_equal(episode.observations[step], observed)
            observed, reward, terminated, truncated, _ = env.step(int(action))
            assert (episode.terminations[step], episode.truncations[step]) == (
                terminated,
                truncated,
            )
            assert episode.rewards[step] == pytest.approx(reward)
        assert terminated or truncated
    with pytest.raises(ValueError, match="dataset 'pursuit/test-v0' exists"):
        pursuit.export_minari("pursuit/test-v0", env, AStarChaser())
    first = pursuit.export_minari("pursuit/zero-v0", env, lambda seen: np.zeros(len(seen)), 2)
    assert all((episode.actions == 0).all() for episode in first.iterate_episodes())
    with pytest.raises(ValueError, match="give a single-agent environment of Pursuit"):
        pursuit.export_minari("pursuit/arm-v0", gymnasium.make("pursuit/Reacher-v0"), AStarChaser())
