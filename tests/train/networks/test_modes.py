"""Dropout and statistics of batches: training mode in updates, evaluation mode everywhere else."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

import train
from pursuit import Simulator, make_task, plugins
from scripted_agents import AStarEvader
from train.algorithms.registry import Build, entry
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.kinds import start
from train.networks.continuous import polyak_update
from train.networks.policy import LearnedPolicy, MazeSeat
from train.runs.folder import RUN, SELF_PLAY, load_checkpoint
from train.runs.parts import parts_of, settings_of
from train.runs.single import SingleAgent
from train.self_play.parts import self_play_settings_of

NOISY = {"network": "my_parts:noisy", "observation": "one_hot", "width": 8}
GAME = {"maze": "2x2", "max_steps": 10, "num_games": 16, "frames": 3000}
ARM = {"task": "reacher", "max_steps": 10, "num_games": 16, "frames": 3000}
LEARNERS: dict[str, dict[str, Any]] = {
    "ppo": {**GAME, "rollout_steps": 8, "minibatch_size": 32},
    "a2c": {**GAME, "rollout_steps": 8, "recurrent": "gru"},
    "reinforce": GAME,
    "dqn": {**GAME, "rollout_steps": 8, "learning_starts": 64, "batch_size": 32},
    "sac": {**ARM, "rollout_steps": 8, "learning_starts": 64, "batch_size": 32},
    "td3": {**ARM, "rollout_steps": 8, "learning_starts": 64, "batch_size": 32},
}


@pytest.fixture(autouse=True)
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "own_parts"))
    monkeypatch.setattr(plugins, "_allowed", set())
    monkeypatch.setattr(plugins, "_named", set())
    monkeypatch.setattr("train.runs.single.EPISODES", 10)


def settings_for(algorithm: str, **more: Any) -> Any:
    names = {"observation": "positions"} if "task" in LEARNERS[algorithm] else {}
    flat = {"algorithm": algorithm, **LEARNERS[algorithm], **NOISY, **names, **more}
    return settings_of(**flat)


def parts_in(network: nn.Module, form: type[nn.Module]) -> list[Any]:
    return [each for each in network.modules() if isinstance(each, form)]


@pytest.mark.parametrize("algorithm", LEARNERS)
def test_learners_switch_to_training_mode_in_updates_only(algorithm: str) -> None:
    trainee = SingleAgent(parts_of(settings_for(algorithm)), "greedy")
    network, modes = trainee.learner.network, []
    for each in parts_in(network, nn.Dropout):
        each.register_forward_hook(
            lambda module, *_: modes.append((module.training, torch.is_grad_enabled()))
        )
    before = copy.deepcopy(network.state_dict())
    flags = [each.training for each in network.modules()]
    for _ in range(3):
        trainee.learner.iterate(0.0)
    assert set(modes) == {(True, True), (False, False)}
    assert flags == [each.training for each in network.modules()]
    after, statistics = network.state_dict(), [n for n in before if "running" in n]
    assert statistics and all(not torch.equal(before[name], after[name]) for name in statistics)
    assert trainee.learner.update_form == "torch"
    trainee.close()


def test_targets_and_references_follow_the_statistics() -> None:
    one, two = (nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4)) for _ in range(2))
    two(torch.randn(50, 3) + 5.0)
    polyak_update(one, two, 0.25)
    for name in ("running_mean", "running_var", "num_batches_tracked"):
        assert torch.equal(getattr(one[1], name), getattr(two[1], name))


def trained(folder: Path, **more: Any) -> Path:
    start(RUN, settings_for("ppo", **more), folder).train()
    return folder


def test_a_run_is_evaluated_exactly_and_exported_in_evaluation_mode(tmp_path: Path) -> None:
    folder = trained(tmp_path / "run")
    plugins.allow("my_parts")
    policy, other = train.load_policy(folder), train.load_policy(folder)
    task = policy.task
    maze, network = task.mazes[0], policy.network
    assert isinstance(policy, LearnedPolicy) and not network.training
    table = policy.action_probabilities(maze)
    contest = GameContest(task, "chaser", {"evader": AStarEvader(epsilon=0.2)}, 5)
    scores = [contest.score("learned", one) for one in (policy, other, policy)]
    assert scores[0].exact and scores[0] == scores[1] == scores[2]
    for _ in range(3):
        np.testing.assert_array_equal(other.action_probabilities(maze), table)
    for training in (True, False):
        network.train(training)
        parts_in(network, nn.BatchNorm1d)[0].eval()  # a part that its user froze
        flags = [each.training for each in network.modules()]
        kept = copy.deepcopy(network.state_dict())
        np.testing.assert_array_equal(policy.action_probabilities(maze), table)
        path = train.export_policy(policy, tmp_path / f"{training}.pt2")
        assert flags == [each.training for each in network.modules()]
        assert all(torch.equal(kept[name], now) for name, now in network.state_dict().items())
        program = torch.export.load(path).module()
        observed = torch.rand(7, *policy.seat.features.shape)
        network.eval()
        with torch.no_grad():
            expected = network.logits(observed).softmax(-1)
        torch.testing.assert_close(program(observed), expected)
        torch.testing.assert_close(program(observed), program(observed))


def test_a_policy_with_a_network_in_training_mode_acts_in_evaluation_mode() -> None:
    task = make_task("chase", maze="2x2")
    seat = MazeSeat(task, "chaser", "one_hot")
    size = int(np.prod(seat.features.shape))

    class Plain(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.layers = nn.Sequential(nn.Linear(size, 32), nn.Dropout(0.5), nn.Linear(32, 4))

        def logits(self, observation: torch.Tensor) -> torch.Tensor:
            return self.layers(observation.flatten(-len(seat.features.shape)).float())

    network = Plain()
    policy = seat.policy(network, greedy=False)
    table = policy.action_probabilities(task.mazes[0])
    np.testing.assert_array_equal(policy.action_probabilities(task.mazes[0]), table)
    assert all(each.training for each in network.modules())


def test_snapshots_and_averages_hold_the_statistics(tmp_path: Path) -> None:
    flat = {**GAME, **NOISY, "snapshots": 3, "minibatch_size": 64, "rollout_steps": 16}
    run = start(SELF_PLAY, self_play_settings_of(**flat), tmp_path / "run")
    run.train()
    side = run.trainee.sides["chaser"]
    statistics = {n: w for n, w in side.snapshot()["network"].items() if "running_mean" in n}
    assert statistics and all(w.abs().max() > 0.0 for w in statistics.values())
    maze = run.trainee.game.task.mazes[0]
    snapshot: Any = run.trainee.pools["chaser"].snapshots[-1].policy_once()
    kept = {n for n in snapshot.network.state_dict() if "running_mean" in n}
    assert kept == set(statistics)
    loaded: Any = side.load(side.snapshot())
    table = loaded.action_probabilities(maze)
    np.testing.assert_array_equal(loaded.action_probabilities(maze), table)
    evaluated: Any = run.trainee.policy("chaser")
    plugins.allow("my_parts")
    saved = train.load_policy(tmp_path / "run" / "chaser", greedy=False)
    np.testing.assert_array_equal(
        saved.action_probabilities(maze), evaluated.action_probabilities(maze)
    )


@pytest.mark.parametrize("algorithm", ["mmd", "rnad"])
def test_reference_policies_have_the_statistics_of_the_policy(algorithm: str) -> None:
    task = make_task("chase", maze="2x2", max_steps=10)
    seat = MazeSeat(task, "chaser", "one_hot", network="my_parts:noisy")
    env = SimulatorEnv(Simulator(task, 16, 0, auto_restart=False), seat, [None, AStarEvader()])
    form = entry(algorithm).settings
    hyper = form(num_games=16, width=8, rollout_steps=8, minibatch_size=64, reference_interval=1)
    learner = entry(algorithm).build(hyper, env, Build())
    learner.iterate(0.0)
    own, reference = learner.network.state_dict(), learner.reference.state_dict()
    names = [name for name in own if "running" in name]
    assert names and all(torch.equal(own[name], reference[name]) for name in names)
    learner.close()


def test_two_processes_have_equal_statistics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("train.runs.data_parallel.can_fork", lambda: True)
    settings = settings_for("ppo", processes=2, threads=1)
    start(RUN, settings, tmp_path / "run").train()  # compares their weights and statistics
    learned = load_checkpoint(tmp_path / "run")["trainee"]["learner"]["network"]
    alone = trained(tmp_path / "alone")
    assert learned.keys() == load_checkpoint(alone)["trainee"]["learner"]["network"].keys()
    assert any("running" in name and weight.abs().max() > 0.0 for name, weight in learned.items())
