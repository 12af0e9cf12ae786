"""The policies that self-play evaluates and saves: averaged weights, no improbable actions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import make_run

from train.networks.recurrent_policy import probabilities_of, without_improbable
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.self_play import trainee
from train.self_play.side import DECAY
from train.settings.self_play import OPPOSING_ROLES, self_play_ppo


def test_improbable_actions_are_not_played(tmp_path: Path) -> None:
    hyper = replace(self_play_ppo(), entropy_coef=0.0)
    settings: Any = {"min_probability": 0.2, "precision": "float32", "hyper": hyper}
    run = make_run(tmp_path, frames=120_000, **settings)
    run.train()
    maze = run.trainee.game.task.mazes[0]
    for role in OPPOSING_ROLES:
        side = run.trainee.sides[role]
        raw = side.load(side.snapshot()).action_probabilities(maze)  # type: ignore[attr-defined]
        table = run.trainee.policy(role).action_probabilities(maze)
        assert (raw < 0.2).any()
        expected = np.where(raw >= 0.2, raw, 0.0)
        np.testing.assert_allclose(table, expected / expected.sum(-1, keepdims=True), atol=1e-6)
        loaded: Any = load_policy(tmp_path / role, greedy=False)
        np.testing.assert_array_equal(loaded.action_probabilities(maze), table)


@pytest.mark.parametrize("actions", [4, 5, 25])
@pytest.mark.parametrize("least", [0.05, 0.2, 0.9])
def test_rows_below_the_threshold_stay(actions: int, least: float) -> None:
    rows = np.random.default_rng(0).dirichlet(np.ones(actions), size=50)
    rows[0] = 1.0 / actions
    rows[1] = np.eye(actions)[0]
    found = without_improbable(rows, least)
    for row, own in zip(rows, found, strict=True):
        kept = [p if p >= least else 0.0 for p in row]
        expected = [p / sum(kept) for p in kept] if sum(kept) else row
        np.testing.assert_allclose(own, expected, atol=1e-15)
    masked = torch.log(torch.tensor(rows))
    allowed = np.arange(actions) % 2 == 0
    played = probabilities_of(masked, np.tile(allowed, (len(rows), 1)), False, least)
    np.testing.assert_allclose(played.sum(-1), 1.0)
    assert (played[:, ~allowed] == 0.0).all()


@pytest.fixture
def star(tmp_path: Path) -> str:
    """A graph of 25 nodes with a node of degree 24, so with 24 moves."""
    path = tmp_path / "star.edgelist"
    path.write_text("".join(f"0 {leaf}\n" for leaf in range(1, 25)))
    return str(path)


def test_defaults_leave_actions_in_a_star_graph(tmp_path: Path, star: str) -> None:
    run = make_run(tmp_path / "run", task={"maze": star, "max_steps": 5}, frames=2000)
    maze = run.trainee.game.task.mazes[0]
    moves = run.trainee.game.task.num_actions
    for role in OPPOSING_ROLES:
        assert run.trainee.sides[role].parts.min_probability == pytest.approx(0.25 / moves)
        table = run.trainee.policy(role).action_probabilities(maze)
        np.testing.assert_allclose(table.sum(-1), 1.0)
        assert (table > 0.0).sum(-1).min() > 1  # of an untrained policy


@pytest.mark.parametrize("least", [0.05, 0.3])
def test_probabilities_that_leave_no_action_are_refused(
    tmp_path: Path, star: str, least: float
) -> None:
    mazes = {0.05: ({"maze": star}, "0.0416667"), 0.3: ({}, "0.25")}
    task, most = mazes[least]
    with pytest.raises(
        ValueError, match=rf"min_probability={least} with .* moves; give 0 to {most}"
    ):
        make_run(tmp_path / "run", task=task, min_probability=least)
    chase = {"task": "chase", "role": "evader", "maze": "3x3", **task}
    with pytest.raises(
        ValueError, match=rf"min_probability={least} with .* moves; give 0 to {most}"
    ):
        settings_of(frames=1000, min_probability=least, **chase)


def test_evaluated_weights_are_an_average_with_polynomial_weights(tmp_path: Path) -> None:
    run = make_run(tmp_path, frames=1_000_000, precision="float32")
    side = run.trainee.sides["evader"]
    seen = []
    for _ in range(12):
        side.iterate(0.0)
        seen.append([weight.detach().clone() for weight in side.learner.network.parameters()])
    # The recursion by hand: term t has the weight (DECAY + 1) / (t + DECAY) of all up to t.
    shares = np.zeros(12)
    for t in range(1, 13):
        rate = (DECAY + 1) / (t + DECAY)
        shares *= 1.0 - rate
        shares[t - 1] = rate
    assert shares.sum() == pytest.approx(1.0)
    # Up to a constant these are the products t (t + 1) ... (t + DECAY - 1), of degree DECAY.
    products = np.array([np.prod(np.arange(t, t + DECAY, dtype=float)) for t in range(1, 13)])
    np.testing.assert_allclose(shares, products / products.sum())
    for place, (name, _) in enumerate(side.learner.network.named_parameters()):
        expected = sum(share * own[place].numpy() for share, own in zip(shares, seen, strict=True))
        np.testing.assert_allclose(side.average[name].numpy(), expected, atol=1e-5)


def test_training_episodes_are_short_and_evaluations_are_not(tmp_path: Path) -> None:
    run = make_run(tmp_path / "default", task={"maze": "3x3-open"}, frames=40_000)
    longest = 0
    while run.trainee.frames < 20_000:
        run.trainee.sides["chaser"].learner.iterate(0.0)
        longest = max(longest, int(run.trainee.sides["chaser"].simulator.steps.max()))
    assert 10 < longest <= 20
    assert run.trainee.game.task.max_steps == 200
    chosen = make_run(tmp_path / "chosen", episode_steps=7)
    assert {side.simulator.task.max_steps for side in chosen.trainee.sides.values()} == {7}
    goals = {"task": "heist", "maze": "3x3", "max_steps": 60}
    heist = make_run(tmp_path / "heist", task=goals)
    assert {side.simulator.task.max_steps for side in heist.trainee.sides.values()} == {60}


@pytest.mark.parametrize("frames, expected", [(2000, 2000), (4000, 3000), (None, None)])
def test_best_responses_have_a_budget_of_the_unit_of_the_run(
    tmp_path: Path, frames: int | None, expected: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In frames at most those of the run, so that a short run does not end with a long one."""
    budgets = []
    budget: dict[str, Any] = {"frames": frames} | ({} if frames else {"seconds": 0.05})

    def noted(settings: Any) -> Any:
        budgets.append((settings.seconds, settings.frames))
        return parts_of(settings)

    parts_of = trainee.self_play_parts
    monkeypatch.setattr(trainee, "self_play_parts", noted)
    task = {"task": "heist", "maze": "2x2", "num_goals": 2, "max_steps": 10}
    run = make_run(tmp_path / "run", task=task, best_response_seconds=0.03, **budget)
    run.train()
    results = [run.trainee.results(20)["approximate_best_response"] for _ in range(2)]
    if frames is None:
        assert set(budgets) == {(0.03, None)}
    else:
        assert set(budgets) == {(None, expected)} and results[0] == results[1]
