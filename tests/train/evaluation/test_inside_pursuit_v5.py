"""A policy inside PettingZoo's `pursuit_v5` plays as in our simulator."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from pettingzoo.sisl.pursuit.pursuit import parallel_env
from pettingzoo.sisl.pursuit.utils.controllers import RandomPolicy

from pursuit.observations.pursuit_v5 import PURSUIT_V5_ACTIONS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.pursuit_v5 import PursuitV5Rewards
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser, AStarEvader, GatheringTeam
from train.algorithms.learner import Build
from train.algorithms.rollouts import actor_critic_of
from train.commands.evaluate import evaluate
from train.evaluation import pursuit_v5 as module
from train.evaluation.pursuit_v5 import PursuitV5Episodes, play_pursuit_v5
from train.kinds import start
from train.networks.policy import MazeSeat
from train.runs.folder import RUN
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.settings.algorithms import PPOSettings
from train.settings.presets import preset_task
from train.settings.task import TaskSettings

CYCLES = 120


def default_task(**changed: Any) -> Task:
    settings = TaskSettings(**{**preset_task("sisl-pursuit", TaskSettings), **changed})
    return settings.build()


def policy_in(
    task: Task, encoding: str = "pursuit_v5", greedy: bool = False, recurrent: str | None = None
) -> Any:
    """A policy with random weights."""
    torch.manual_seed(3)
    seat = MazeSeat(task, "chaser", encoding, network="mlp")
    build = Build(fused=False)
    network = actor_critic_of(PPOSettings(width=16, recurrent=recurrent), seat, build)
    with torch.no_grad():
        network.policy_head.weight *= 30.0  # so that actions depend on observations
    return seat.policy(network, greedy)


@pytest.mark.parametrize(
    "given",
    [
        pytest.param({"greedy": True}, marks=pytest.mark.slow),
        pytest.param({"encoding": "pursuit_v5+id"}, marks=pytest.mark.slow),
        {"encoding": "pursuit_v5_flat"},
        pytest.param(
            {"encoding": "pursuit_v5_flat+id", "recurrent": "gru"}, marks=pytest.mark.slow
        ),
        GatheringTeam(),
        AStarChaser(0.2),
    ],
    ids=["greedy", "id", "flat", "gru", "gathering", "astar"],
)
def test_a_policy_plays_there_as_here(monkeypatch: pytest.MonkeyPatch, given: Any) -> None:
    rules = {"surround": False, "shared_reward": False, "max_cycles": CYCLES}
    task = default_task(capture="cell", n_catch=2, max_steps=CYCLES)
    task = replace(task, rewards=PursuitV5Rewards(shared=False))
    policy, seed = policy_in(task, **given) if isinstance(given, dict) else given, 7
    drawn, draw = [], RandomPolicy.act

    def recorded(evaders: RandomPolicy, state: Any) -> Any:
        drawn.append(draw(evaders, state))
        return drawn[-1]

    monkeypatch.setattr(RandomPolicy, "act", recorded)
    theirs = play_pursuit_v5(policy, 1, seed, **rules)

    fresh = parallel_env(**rules)
    fresh.reset(seed)
    base, maze = fresh.unwrapped.env, task.mazes[0]
    agents = [*base.pursuer_layer.allies, *base.evader_layer.allies]
    ours, probe = (Simulator(task, 1, seed, auto_restart=False) for _ in "12")
    ours.positions[0] = [maze.cell_numbers[y, x] for x, y in (a.current_position() for a in agents)]
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    while not (ours.terminated | ours.truncated).any():
        ours.act([policy] * 8 + [None] * 30, actions)
        actions[0, 8:] = 4
        # Evaders caught after the pursuers' moves draw nothing there: first find who is left.
        probe.reset()
        probe.positions[:], probe.active[:] = ours.positions, ours.active
        probe.step(actions)
        free = np.flatnonzero(probe.active[0, 8:])
        own, drawn = drawn[: len(free)], drawn[len(free) :]
        actions[0, 8 + free] = np.array(PURSUIT_V5_ACTIONS)[own]
        ours.step(actions)
    assert not drawn
    caught = int((ours.active[0, 8:] == 0).sum())
    assert caught > 0 and theirs.caught.tolist() == [caught]
    assert theirs.steps.tolist() == ours.steps.tolist()
    np.testing.assert_allclose(theirs.returns[0], ours.returns[0, :8], atol=1e-4)


def test_the_command_plays_a_saved_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = {"num_games": 16, "rollout_steps": 2, "minibatch_size": 16, "width": 8}
    settings = settings_of(preset="sisl-pursuit", **sizes, seconds=1)
    start(RUN, settings, tmp_path / "run").save()
    short = partial(module.environments, max_cycles=5)
    monkeypatch.setattr(module, "environments", short)
    out = tmp_path / "scores.json"
    evaluate([str(tmp_path / "run"), "--env", "pursuit_v5", "--episodes", "2", "--out", str(out)])
    scores = json.loads(out.read_text())["scores"]
    assert [score["policy"] for score in scores] == ["learned", "learned, sampled"]
    for greedy, score in zip((True, False), scores, strict=True):
        played = play_pursuit_v5(load_policy(tmp_path / "run", greedy), 2)
        assert score == {"policy": score["policy"], **played.summary()}
        assert score["mean_steps"] == 5.0
    for option in (["--maze", "5x5"], ["--teammates", "scripted"], ["--opponent", "random"]):
        with pytest.raises(ValueError, match="--env plays its own game"):
            evaluate([str(tmp_path / "run"), "--env", "pursuit_v5", *option])


def test_the_summary_counts_agents_and_episodes() -> None:
    returns = np.array([[1.0, 3.0], [5.0, 7.0]])
    summary = PursuitV5Episodes(returns, np.array([500, 9]), np.array([2, 4])).summary()
    assert summary["mean_return"] == 4.0 and summary["total_return"] == 8.0
    assert summary["ci95"] == pytest.approx(1.96 * 8**0.5 / 2**0.5)
    assert (summary["mean_steps"], summary["mean_caught"], summary["episodes"]) == (254.5, 3.0, 2)


@pytest.mark.parametrize(
    ("changed", "encoding", "message"),
    [
        ({}, "positions", "observes 'positions'"),
        ({"num_chasers": 4}, "pursuit_v5", "pursuers of the policy: 4"),
        ({"stay_action": False, "move_order": "simultaneous", "capture_check": "each_move"},
         "pursuit_v5", "actions of the policy: 4"),
    ],
)  # fmt: skip
def test_other_policies_are_refused(changed: dict[str, Any], encoding: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        play_pursuit_v5(policy_in(default_task(**changed), encoding), 1)


def test_the_scripted_team_has_its_return_there() -> None:
    played = play_pursuit_v5(GatheringTeam(), 3, seed=1)
    assert played.returns.mean() > 110 and (played.caught == 30).all()


def test_scripted_agents_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="plays evaders, but pursuers are chasers"):
        play_pursuit_v5(AStarEvader(), 1)
    with pytest.raises(ValueError, match=r"obs_range=7 of Gather.*see 5 rows and columns"):
        play_pursuit_v5(GatheringTeam(), 1, obs_range=5)
    with pytest.raises(ValueError, match="observes None"):
        play_pursuit_v5(object(), 1)
