"""All optimal actions of an agent in whole games, against value iteration in plain Python."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from test_options_brute_force import DUEL, GAMES, ROOM, SQUARE, Model, Whimsical, whim

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks
from pursuit.rules.layout import Games
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Rewards, Task, make_task
from scripted_agents import AStarEvader, evaluate_joint, solve_joint
from train.evaluation.contest import GameContest
from train.evaluation.team_contest import TeamContest

CORNER = Maze.from_text("+-+-+\n|   |\n+ +-+\n|   |\n+-+-+")
PLAIN: dict[str, dict[str, Any]] = {
    "team": {"maze": CORNER, "num_chasers": 2, "num_evaders": 1},
    "two evaders": {"maze": SQUARE, "num_chasers": 1, "num_evaders": 2, "stay_action": True},
    "race": {"maze": CORNER, "num_runners": 2, "num_goals": 2, "stay_action": True},
    "heist": {"maze": SQUARE, **DUEL, "num_goals": 2, "move_order": "chasers_first"},
    "a runner that slips": {"maze": ROOM, "num_runners": 1, "num_goals": 1, "slip": 0.3},
}
LATE = {"race": 1e-5, "exits, goals": 2e-3}
"""Relative differences in games in which waiting is as good as going, or of which all steps are
played and the last ones otherwise."""
OTHERS = {role: Whimsical() for role in ("chaser", "evader", "runner")}


def contest_of(name: str, agent: str, max_steps: int) -> GameContest:
    settings = (PLAIN | GAMES)[name]
    rules = {"stay_action": settings.get("move_order") == "turns", **settings}
    return GameContest(Task(**rules, max_steps=max_steps), agent, OTHERS)  # type: ignore[arg-type]


def cases() -> list[tuple[str, str]]:
    """Every game with the first agent of each role, and the last one of teams."""
    found = []
    for name, settings in (PLAIN | GAMES).items():
        for role in ("chaser", "evader", "runner"):
            many = settings.get(f"num_{role}s", 0)
            found += [(name, f"{role}_{seat}") for seat in sorted({0, many - 1} if many else ())]
    return found


def paid_by_measure(contest: GameContest) -> Task:
    """The task with rewards that add up to the measure, unless that is steps."""
    if contest.measure.name == "goals":
        return replace(contest.task, rewards={"runner": Rewards(goal=1.0)})
    return contest.by_outcome if contest.measure.name == "outcome" else contest.task


def measured(contest: GameContest) -> tuple[Model, Any, Any]:
    """The rules with the rewards of the measure, what a step pays, and the better of values."""
    by_steps = contest.measure.by_steps
    model = Model(paid_by_measure(contest))
    pays = (model.rounds if by_steps else model.returns)([contest.seat])
    return model, pays, np.min if by_steps and contest.role != "evader" else np.max


def values_by_hand(
    contest: GameContest, model: Model, pays: Any, best: Any, steps: int
) -> tuple[Any, Any]:
    """{state: the value of each own action with so many steps (in turns halves) left}, and the
    values, the others playing by `whim`; states in which the agent is not to move are left out."""
    values: Any = np.zeros(len(model.steps) + 1)
    for _ in range(steps):
        fresh, found = np.zeros_like(values), {}
        for state in model.steps:
            worth, movers = model.worth(state, pays, values, 1.0), model.steps[state][0]
            for axis in reversed(range(len(movers))):
                if movers[axis] != contest.seat:
                    chances = whim(state, movers[axis], model.task.num_actions)
                    worth = np.tensordot(worth, chances, axes=(axis, 0))
            fresh[model.numbers[state]] = best(worth)
            if contest.seat in movers:
                found[state] = worth
        values = fresh
    return found, values


def games_of(states: list[Any]) -> Games:
    parts = [np.array([row[i] for row in states], dtype=np.int32) for i in range(5)]
    position, active, goal, exits = (part.reshape(len(states), -1) for part in parts[:4])
    nothing = np.zeros(len(states), dtype=np.int32)
    return Games(position, active, np.zeros_like(position), goal, parts[4], nothing, exits)


@pytest.mark.parametrize(("name", "agent"), cases())
def test_all_optimal_actions_and_no_others_are_played(name: str, agent: str) -> None:
    """Each has the value of the best response, every other one a worse one, by brute force."""
    contest = contest_of(name, agent, 5)
    model, pays, best = measured(contest)
    task, policy = contest.task, contest.optimal_policy()
    halves = task.steps_per_round
    found, values = values_by_hand(contest, model, pays, best, 5 * halves)
    games, solved = games_of(list(found)), contest.best_in(contest.measure)
    rows = policy.distribution(task, games, contest.seat)  # type: ignore[attr-defined]
    masks = action_masks(games, lay_out(task.mazes), task)[:, contest.seat]
    for worth, row, mask in zip(found.values(), rows, masks, strict=True):
        optimal = np.abs(worth - best(worth)) <= 1e-9
        optimal &= mask | (not task.options.turns)
        np.testing.assert_allclose(row, optimal / optimal.sum())
    starts = solved.values_of(model.games())  # type: ignore[union-attr]
    own = [values[model.numbers[state]] for state in model.starts]
    np.testing.assert_allclose(starts, own, atol=1e-9)


@pytest.mark.parametrize(("name", "agent"), cases())
def test_playing_all_of_them_alike_has_the_optimal_value(name: str, agent: str) -> None:
    """In long games: the policy of the first step plays the last steps as the first, which costs
    nothing where all games end before, and where time costs nothing it takes longer than needed."""
    contest = contest_of(name, agent, 3000)
    policies: Any = contest.with_policy(contest.optimal_policy())
    found = evaluate_joint(paid_by_measure(contest), policies, 3000)
    value = (found.steps if contest.measure.by_steps else found.returns)[agent]
    best = contest.best_in(contest.measure)
    assert best is not None
    assert value == pytest.approx(best.mean_over_starts, rel=LATE.get(name, 1e-8))


def test_an_infinite_horizon_has_all_optimal_actions_too() -> None:
    task = make_task("chase", maze="3x3-open")
    given: Any = (task, "chaser", {"evader": AStarEvader(0.2)})
    near, far = (solve_joint(*given, horizon, 0.9).optimal for horizon in (300, None))
    assert near is not None and far is not None
    assert near.sum() > near.any(axis=1).sum()
    np.testing.assert_array_equal(near, far)


def test_a_team_as_one_player_keeps_its_plan() -> None:
    """Its members draw nothing, but how they stay in their cells."""
    task = make_task("chase", maze="3x3", num_chasers=2, stay_action=True)
    contest = TeamContest(task, "chaser", {"evader": AStarEvader(0.2)}, 30)
    policy: Any = contest.optimal_policy()
    best: Any = contest.best_in(contest.measure)
    games = Simulator(task, 200).games
    for seat in (0, 1):
        rows = policy.distribution(task, games, seat)
        plan = best.policy.distribution(task, games, seat)
        after = task.mazes[0].neighbors[games.position[:, seat]]
        for row, own, cells in zip(rows, plan, after, strict=True):
            assert len(set(cells[row > 0])) == 1 and row[own.argmax()] > 0
    score = contest.score("plan", policy)
    assert score.exact and score.mean_steps == pytest.approx(best.mean_over_starts, rel=1e-9)
    with pytest.raises(ValueError, match="no policy for evader_0"):
        policy.distribution(task, games, 2)
