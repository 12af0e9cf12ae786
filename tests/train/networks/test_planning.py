"""The layer that plans: shortest paths in unseen mazes, gradients, and what is learned with it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

import pursuit
from pursuit.observations.observations import Encoder
from pursuit.rules.visibility import GOALS_PLANE, MAZE_PLANES, PLANES
from train.commands.main import main
from train.networks.planning import Planning, paths
from train.networks.planning_kernels import CHANNELS, NOWHERE
from train.networks.policy import MazeSeat
from train.runs.opponents import load_policy
from train.settings.run import TrainSettings
from train.settings.task import TaskSettings


def seen(maze: str, games: int, encoding: str = "window") -> tuple[pursuit.Simulator, torch.Tensor]:
    """Runners and what they see."""
    task = pursuit.make_task("maze", maze=maze, num_goals=2)
    simulator = pursuit.Simulator(task, games, seed=3)
    planes = np.array(Encoder(task, encoding).encode(simulator.games))[:, 0]
    return simulator, torch.from_numpy(planes)


@pytest.mark.parametrize("encoding", ["window", "planes"])
def test_with_costs_of_walls_it_knows_the_distances_of_any_maze(encoding: str) -> None:
    simulator, planes = seen("suite:7x7-test/0-39", 400, encoding)
    sources = torch.full((len(PLANES) + 1, CHANNELS), 0.0)
    sources[-1], sources[GOALS_PLANE] = -200.0, 200.0  # 0 at a goal
    costs = torch.zeros(len(PLANES) + 1, 4, CHANNELS)
    costs[-1] = 1.0
    for side in range(4):
        costs[MAZE_PLANES + 1 + side, side] = 500.0
    worth, around = paths(planes, sources, costs.flatten(1))
    games = simulator.games
    for game in range(len(planes)):
        maze = simulator.task.mazes[games.maze[game]]
        own, goals = games.position[game, 0], games.goal[game]
        goals = goals[goals >= 0]
        for action in range(4):
            onward = maze.neighbors[own, action]
            if onward != own:
                nearest = maze.distances[onward, goals].min()
                assert worth[game, action].tolist() == [-1.0 - nearest] * CHANNELS
            else:
                assert bool((worth[game, action] < -90.0).all())
    assert torch.equal(around[:, 4, 0], torch.ones(len(planes)))  # itself, in the middle


def by_torch(planes: torch.Tensor, sources: torch.Tensor, costs: torch.Tensor) -> torch.Tensor:
    """What `paths` gives, in torch alone, by sweeps over whole grids."""
    games, _, rows, columns = planes.shape
    marked = torch.cat([planes, torch.ones(games, 1, rows, columns)], 1).movedim(1, -1)
    known = planes.any(1)[..., None]
    source = marked @ sources
    cost = (marked @ costs).reshape(games, rows, columns, 4, CHANNELS)
    value = source
    for _ in range(rows * columns):
        wide = nn.functional.pad(value, (0, 0, 1, 1, 1, 1), value=float(NOWHERE))
        other = torch.stack(
            [wide[:, :-2, 1:-1], wide[:, 2:, 1:-1], wide[:, 1:-1, 2:], wide[:, 1:-1, :-2]], 3
        )
        ways = torch.where(other == float(NOWHERE), other, other - cost)
        value = torch.where(known, torch.maximum(source, ways.amax(3)), float(NOWHERE))
    place = planes[:, 0].flatten(1).argmax(1)
    whole = torch.cat([ways, source[..., None, :]], 3).flatten(1, 2)
    return whole[torch.arange(games), place]


def test_values_and_gradients_are_those_of_torch() -> None:
    generator = torch.Generator().manual_seed(0)
    planes = (torch.rand(60, 4, 4, 5, generator=generator) < 0.3).float()
    planes[:, 0] = 0.0
    for game in range(60):
        planes[game, 0, game % 4, game % 5] = 1.0
    planes[7] = 0.0  # nothing is seen at all
    sources = torch.randn(5, CHANNELS, generator=generator).requires_grad_()
    costs = torch.rand(5, 4 * CHANNELS, generator=generator).requires_grad_()
    weights = torch.randn(60, 5, CHANNELS, generator=generator)
    found = []
    for function in (lambda *given: paths(*given)[0], by_torch):
        worth = function(planes, sources, costs)
        total = (worth * weights * (worth != float(NOWHERE))).sum()
        torch.autograd.backward(total)
        assert sources.grad is not None and costs.grad is not None
        found.append((worth.detach(), sources.grad, costs.grad))
        sources.grad = costs.grad = None
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-3)


def test_it_is_a_layer_of_any_batch() -> None:
    _, planes = seen("5x5", 12)
    features = MazeSeat(pursuit.make_task("maze", maze="5x5", num_goals=2), "runner", "window").seen
    layer = Planning(features, 16)
    assert torch.allclose(
        layer(planes.reshape(3, 4, *planes.shape[1:])).flatten(0, 1), layer(planes)
    )


@pytest.mark.parametrize("own", ["ppo --rollout-steps 4 --minibatch-size 128", "a2c"])
def test_learners_of_discrete_actions_support_it(tmp_path: Path, own: str) -> None:
    command = f"train --algorithm {own} --task maze --num-goals 1 --maze suite:5x5-train/0-9 "
    command += "--observation window --network planning --max-steps 30 --frames 1000 --width 8 "
    command += f"--num-games 64 --episodes 40 --threads 1 --no-report --out {tmp_path}/run"
    main(command.split())
    assert load_policy(tmp_path / "run").seat.features.kind == "grid"


@pytest.mark.slow
def test_it_learns_to_go_in_mazes_that_it_never_saw(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 1)
    command = "train --task maze --num-goals 1 --maze suite:5x5-train/0-99 --observation window "
    command += (
        "--network planning --mask-bumps --learning-rate 3e-3 --minibatch-size 1024 --epochs 4 "
    )
    command += (
        "--entropy-coef 0.02 --num-games 256 --rollout-steps 16 --frames 120000 --max-steps 100 "
    )
    command += f"--evaluate sampled --episodes 100 --threads 1 --out {tmp_path}/run"
    main(command.split())
    out = tmp_path / "out.json"
    main(f"evaluate {tmp_path}/run --maze suite:5x5-test/0-19 --out {out}".split())
    found = json.loads(out.read_text())["suite"]
    random, learned = found["random"], found["learned, sampled"]
    assert random["success_rate"] < 0.7 and random["optimality_gap"] > 9.0
    assert learned["success_rate"] > 0.95 and learned["optimality_gap"] < 1.0


@pytest.mark.parametrize("given", [{"observation": "index"}, {"device": "cuda"}])
def test_unsupported_planning_networks_are_refused(given: dict[str, str]) -> None:
    settings: dict[str, Any] = {"observation": "window", "network": "planning", "frames": 1}
    with pytest.raises(ValueError, match="network='planning'"):
        TrainSettings(task=TaskSettings(task="maze"), **settings | given)
