"""The cross-entropy method: its batched networks, its draws, its episodes, that it learns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.utils import vector_to_parameters

from pursuit.environments.single_agent import fill_seats
from pursuit.observations.observations import ENCODINGS
from pursuit.simulator.simulator import Simulator
from scripted_agents import RandomAgent
from train.algorithms.cross_entropy import Candidates, CrossEntropy
from train.algorithms.registry import Build, entry
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.contest import GameContest
from train.networks.policy import Seat
from train.runs.parts import contest_of, settings_of


def make(**flat: Any) -> tuple[CrossEntropy, GameContest]:
    chosen = settings_of(**{"algorithm": "cross_entropy", "maze": "3x3", "frames": 1, **flat})
    contest = contest_of(chosen.task, 300)
    task, agent = contest.task, contest.agent
    _, policies = fill_seats(task, agent, contest.opponents)
    simulator = Simulator(task, chosen.hyper.num_games, chosen.seed, auto_restart=False)
    env = SimulatorEnv(simulator, Seat(task, agent, chosen.observation), policies)
    learner = entry("cross_entropy").build(chosen.hyper, env, Build(seed=chosen.seed))
    assert isinstance(learner, CrossEntropy)
    return learner, contest


SMALL = {"num_games": 64, "population": 16, "elite_share": 0.25}
SHORT = {**SMALL, "max_steps": 8}


def candidates_of(learner: CrossEntropy, flat: torch.Tensor) -> Candidates:
    return Candidates(learner.network, learner._named, flat)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("encoding", sorted(ENCODINGS))
def test_every_candidate_computes_what_the_network_with_its_weights_does(
    encoding: str, activation: str
) -> None:
    learner, _ = make(
        task="maze", num_goals=2, observation=encoding, activation=activation, **SHORT
    )
    env = learner.env
    env.simulator.reset()
    observed = torch.from_numpy(env.simulator.observe(encoding, env.seat))
    flat = torch.randn(16, len(learner.mean))
    batched = candidates_of(learner, flat).logits(observed)
    for number, weights in enumerate(flat):
        vector_to_parameters(weights, learner._named.values())
        games = slice(4 * number, 4 * number + 4)
        with torch.no_grad():
            alone = learner.network.logits(observed[games])
        torch.testing.assert_close(batched[games], alone, rtol=1e-3, atol=1e-3)
    assert np.isfinite(learner.iterate(0.5)["return_mean"])


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("encoding", ["index", "one_hot"])
def test_actions_are_drawn_from_the_softmax_of_each_candidate(
    encoding: str, activation: str
) -> None:
    flat = {"task": "maze", "num_goals": 2, "activation": activation, "observation": encoding}
    learner, _ = make(**flat, num_games=80_000, population=4, elite_share=0.5)
    simulator, seat = learner.env.simulator, learner.env.seat
    simulator.place(np.array([[4]]), np.array([[2, -1]]))  # one goal is gone: no row at all
    observed = simulator.observe(encoding, seat)
    candidates = candidates_of(learner, torch.randn(4, len(learner.mean)))
    running = np.ones(80_000, dtype=bool)
    every = np.ones((80_000, 4), dtype=bool)
    candidates.act(observed, learner._streams, running, every, learner._actions)
    probabilities = candidates.logits(torch.from_numpy(observed)).softmax(-1)[::20_000]
    for number in range(4):
        drawn = learner._actions[20_000 * number : 20_000 * (number + 1)]
        share = np.bincount(drawn, minlength=4) / 20_000
        np.testing.assert_allclose(share, probabilities[number].numpy(), atol=0.02)


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


def test_candidates_draw_from_streams_of_their_own() -> None:
    learner, _ = make(task="chase", role="chaser", **SMALL)
    simulator = learner.env.simulator
    simulator.seed(0)
    assert not np.isin(learner._streams, simulator.streams).any()


def test_a_captured_learners_episode_ends_with_its_capture() -> None:
    learner, _ = make(task="chase", role="evader", num_evaders=2, **SMALL)
    learner.play(torch.zeros(16, len(learner.mean)))
    lengths = np.concatenate(learner.env.finished_lengths)
    ended = np.concatenate(learner.env.finished_returns)
    assert len(lengths) == 64
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
        learner.iterate(0.3)
        learner.iterate(0.6)
    assert first.frames == second.frames
    assert torch.equal(first.mean, second.mean) and torch.equal(first.std, second.std)
    assert (first._streams == second._streams).all()
    other, _ = make(**{**flat, "width": 8})
    with pytest.raises(RuntimeError, match="size mismatch"):
        other.load_state_dict(first.state_dict())


def test_a_chaser_and_an_evader_beat_random_by_far() -> None:
    for role, frames, factor in (("chaser", 1_000_000, 0.3), ("evader", 400_000, 5.0)):
        learner, contest = make(task="chase", role=role)
        while learner.frames < frames:
            learner.iterate(learner.frames / frames)
        steps = contest.score("learned", learner.policy()).mean_steps
        random = contest.score("random", RandomAgent()).mean_steps
        assert (steps < factor * random) if factor < 1 else (steps > factor * random)


@pytest.mark.slow
@pytest.mark.parametrize("goals", [1, 2])
def test_a_runner_beats_random_by_far(goals: int) -> None:
    learner, contest = make(task="maze", num_goals=goals)
    while learner.frames < 4_500_000:
        learner.iterate(learner.frames / 4_500_000)
    steps = contest.score("learned", learner.policy()).mean_steps
    assert steps < 0.5 * contest.score("random", RandomAgent()).mean_steps
