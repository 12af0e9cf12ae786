"""The cross-entropy method: its candidates, its episodes, its distribution, that it learns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.utils import vector_to_parameters

from pursuit.environments.single_agent import fill_seats
from pursuit.simulator.simulator import Simulator
from scripted_agents import RandomAgent
from train.algorithms.cross_entropy import CrossEntropy, draw_actions
from train.algorithms.registry import Build, entry
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.networks.distributions import masked
from train.networks.policy import MazeSeat
from train.runs.parts import contest_of, settings_of


def make(**flat: Any) -> tuple[CrossEntropy, GameContest]:
    chosen = settings_of(**{"algorithm": "cross_entropy", "maze": "3x3", "frames": 1, **flat})
    contest = contest_of(chosen.task, 300)
    task, agent = contest.task, contest.agent
    _, policies = fill_seats(task, agent, contest.opponents)
    simulator = Simulator(task, chosen.hyper.num_games, chosen.seed, auto_restart=False)
    env = SimulatorEnv(simulator, MazeSeat(task, agent, chosen.observation), policies)
    learner = entry("cross_entropy").build(chosen.hyper, env, Build(seed=chosen.seed))
    assert isinstance(learner, CrossEntropy)
    return learner, contest


SMALL = {"num_games": 64, "population": 16, "elite_share": 0.25}
SHORT = {**SMALL, "max_steps": 8}


@pytest.mark.parametrize("flat", [{"observation": "planes"}, {"observation": "cells"}, {}])
def test_every_candidate_plays_by_its_own_weights(flat: dict[str, str]) -> None:
    """Candidates that prefer one action each play that action alone."""
    learner, _ = make(task="maze", num_goals=2, **flat, **SHORT)
    candidates = torch.zeros(16, len(learner.mean))
    assert list(learner._searched)[-1] == "1.bias"  # of the policy head
    for number in range(16):
        candidates[number, number % 4 - 4] = 1e3
    played: list[torch.Tensor] = []
    step = learner.env.step_episodes

    def noted(actions: torch.Tensor, running: torch.Tensor) -> Any:
        played.append(actions.clone())
        return step(actions, running)

    learner.env.step_episodes = noted  # type: ignore[method-assign]
    learner.play(candidates)
    assert (played[0] == torch.arange(16).repeat_interleave(4) % 4).all()
    assert np.isfinite(learner.iterate(0.5)["return_mean"])


@pytest.mark.parametrize("activation", ["relu", "tanh"])
@pytest.mark.parametrize("encoding", ["index", "one_hot", "cells", "planes"])
def test_the_batched_networks_are_those_of_the_candidates(encoding: str, activation: str) -> None:
    flat = {"observation": encoding, "activation": activation, **SMALL}
    learner, _ = make(task="chase", role="chaser", **flat)
    torch.manual_seed(0)
    candidates = 0.2 * torch.randn(16, len(learner.mean))
    observation, running = learner.env.reset()["observation"], torch.tensor([0, 3, 4, 30, 63])
    with torch.no_grad():
        found = learner._outputs(candidates, 4)(observation, running)
        for row, game in enumerate(running.tolist()):
            vector_to_parameters(candidates[game // 4], learner._searched.values())
            wanted = learner.network.logits(observation[game : game + 1])
            torch.testing.assert_close(found[row : row + 1], wanted, rtol=1e-3, atol=1e-4)


def test_actions_are_drawn_from_the_softmax() -> None:
    logits = torch.tensor([[2.0, -1.0, 0.5, 80.0], [0.0, 0.0, -300.0, 300.0]])
    allowed = torch.tensor([[True, True, True, False], [True, True, True, True]])
    wanted = masked(logits, allowed).softmax(dim=1).numpy()
    count = 20_000
    running = np.arange(1, 2 * count, 2)  # every second game
    actions = np.full(2 * count, 7)
    for row in range(2):
        rows = masked(logits, allowed)[row].repeat(count, 1).numpy()
        draw_actions(rows, (np.arange(count, dtype=np.float32) + 0.5) / count, running, actions)
        shares = np.bincount(actions[running], minlength=4) / count
        np.testing.assert_allclose(shares, wanted[row], atol=2 / count)
        assert (actions[::2] == 7).all()


def test_all_candidates_play_from_the_same_starts() -> None:
    learner, _ = make(task="chase", role="chaser", **SMALL)
    starts: list[Any] = []
    step = learner.env.step_episodes

    def noted(actions: torch.Tensor, running: torch.Tensor) -> Any:
        starts.append(learner.env.simulator.positions.copy())
        return step(actions, running)

    learner.env.step_episodes = noted  # type: ignore[method-assign]
    learner.play(torch.zeros(16, len(learner.mean)))
    first = starts[0].reshape(16, 4, 2)
    assert (first == first[:1]).all() and len(np.unique(first[0], axis=0)) > 1


def test_frames_and_returns_are_those_of_the_episodes_one_for_each_game() -> None:
    learner, _ = make(task="chase", role="chaser", **SMALL)
    returns = learner.play(torch.randn(16, len(learner.mean)))
    env = learner.env
    ended, lengths = (np.concatenate(part) for part in (env.finished_returns, env.finished_lengths))
    assert len(ended) == len(lengths) == 64 and learner.frames == lengths.sum()
    assert float(returns.mean()) == pytest.approx(ended.mean(), abs=1e-4)
    # -0.1 a step and 1 for the capture, which replaces the reward of its step.
    caught = lengths < 200
    np.testing.assert_allclose(ended[caught], 1.1 - 0.1 * lengths[caught], atol=1e-4)


def test_a_captured_learners_episode_ends_with_its_capture() -> None:
    learner, _ = make(task="chase", role="evader", num_evaders=2, **SMALL)
    returns = learner.play(torch.zeros(16, len(learner.mean)))
    lengths = np.concatenate(learner.env.finished_lengths)
    ended = np.concatenate(learner.env.finished_returns)
    assert len(lengths) == 64 and float(returns.mean()) == pytest.approx(ended.mean())
    # +1 a step, and -1 in the step of the capture.
    caught = lengths < 200
    assert caught.any()
    np.testing.assert_allclose(ended[caught], lengths[caught] - 2.0)


def test_the_distribution_is_that_of_the_elite() -> None:
    learner, _ = make(task="maze", num_goals=1, extra_std=0.0, **SMALL)
    played: list[torch.Tensor] = []
    scores = torch.arange(16.0).roll(5)

    def play(candidates: torch.Tensor) -> torch.Tensor:
        played.append(candidates)
        return scores

    learner.play = play  # type: ignore[method-assign]
    learner.iterate(0.0)
    best = [number for number in range(16) if scores[number] >= 12]
    chosen = np.stack([played[0][number].numpy() for number in best])
    np.testing.assert_allclose(learner.mean.numpy(), chosen.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(learner.std.numpy(), chosen.std(axis=0, ddof=1), atol=1e-6)
    learner.settings = replace(learner.settings, extra_std=0.5)
    narrow = learner.std.clone()
    learner.iterate(0.5)
    assert float(learner.std.min()) >= 0.25 and float(narrow.min()) < 0.25


@pytest.mark.parametrize("encoding", ["index", "one_hot"])
def test_it_resumes_bit_for_bit(encoding: str) -> None:
    flat = {"task": "chase", "role": "chaser", "observation": encoding, **SHORT}
    first, second = (make(**flat)[0] for _ in range(2))
    first.iterate(0.0)
    second.load_state_dict(first.state_dict())
    second.env.simulator.set_state(first.env.simulator.get_state())
    for learner in (first, second):
        torch.manual_seed(7)
        learner.iterate(0.3)
        learner.iterate(0.6)
    assert first.frames == second.frames
    assert torch.equal(first.mean, second.mean) and torch.equal(first.std, second.std)
    other, _ = make(**{**flat, "width": 8})
    with pytest.raises(RuntimeError, match="size mismatch"):
        other.load_state_dict(first.state_dict())


@pytest.mark.slow
def test_a_chaser_and_an_evader_beat_random_by_far() -> None:
    for role, frames, factor in (("chaser", 1_000_000, 0.6), ("evader", 400_000, 5.0)):
        torch.manual_seed(0)
        learner, contest = make(task="chase", role=role)
        while learner.frames < frames:
            learner.iterate(learner.frames / frames)
        steps = contest.score("learned", learner.policy(greedy=False)).mean_steps
        random = contest.score("random", RandomAgent()).mean_steps
        assert (steps < factor * random) if factor < 1 else (steps > factor * random)


@pytest.mark.slow
def test_a_runner_beats_random_by_far() -> None:
    torch.manual_seed(0)
    learner, contest = make(task="maze", num_goals=1)
    while learner.frames < 4_500_000:
        learner.iterate(learner.frames / 4_500_000)
    steps = contest.score("learned", learner.policy()).mean_steps
    assert steps < 0.5 * contest.score("random", RandomAgent()).mean_steps
