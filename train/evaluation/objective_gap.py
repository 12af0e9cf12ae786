"""The objective gap: the gap of the policy with the best discounted return.

Training maximises discounted returns, evaluation counts steps. So a gap consists of the objective
gap and of what was not learned. It is known exactly for duels and single runners with rewards that
depend only on the time of captures and goals, and for one agent in a whole game that is solved.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.tasks.task import Rewards, Task
from scripted_agents import evaluate_joint, mean_over_starts, solve_joint
from scripted_agents.duel.action_values import expected_after, outcomes
from scripted_agents.tours.objective import tour_objective_gap
from train.evaluation.contest import GameContest
from train.evaluation.games import best_reply
from train.evaluation.joint_contest import joint_work

MAX_CELLS = 256
"""Above this number of cells the objective gap of a duel is not computed (seconds)."""

MAX_OBJECTIVE_WORK = 50_000_000
"""Above this size (`joint_work`) that of a whole game is not computed (15 seconds on 5x5)."""

TIE = 1e-9
"""Relative difference below which two actions are equally good."""


class ObjectiveGap(NamedTuple):
    """The loss of the policy with the best discounted return; None if it is not known.

    Attributes:
        gap: its `optimality_gap`, at most 0 for evaders.
        missing_return: its undiscounted return below the best one, if other agents collect goals.
    """

    gap: float | None = None
    missing_return: float | None = None


UNKNOWN = ObjectiveGap()


def objective_gap(contest: Any, discount: float) -> ObjectiveGap:
    """The loss of the policy with the best discounted return, exact over all starts.

    Among policies with equal return the one with the fewest steps (evader: most) counts; in a whole
    game (team, race, heist) any of them. In a race both values are known, and that of steps is
    large with any discount, as rewards for goals give no reason to end the game soon.

    Unknown for games too large to be solved, action masks, distance or user-defined rewards,
    several mazes, starts at marks, too many goals to enumerate, rewards that do not favour short
    episodes (evader: long ones), a limited view, a whole game without discount, a discount of 0,
    and the arm.
    """
    if not isinstance(contest, GameContest) or contest.is_limited or discount == 0.0:
        return UNKNOWN
    task = contest.task
    paid = task.role_rewards[contest.role]
    if len(task.mazes) > 1 or task.start != "random":
        return UNKNOWN
    if paid.distance != 0.0 or task.reward_function is not None:
        return UNKNOWN
    if (task.num_agents, task.num_runners) == (1, 1):
        return ObjectiveGap(_tour(task, paid, discount))
    if contest.is_exact and not contest.mask_bumps and task.max_cells <= MAX_CELLS:
        return ObjectiveGap(_duel(contest, paid, discount))
    if contest.is_exact or contest.mask_bumps or discount >= 1.0:
        return UNKNOWN
    if joint_work(task) > MAX_OBJECTIVE_WORK:
        return UNKNOWN
    return _whole_game(contest, discount)


def _tour(task: Task, paid: Rewards, discount: float) -> float | None:
    maze, step, goal = task.mazes[0], paid.step, paid.goal
    least = step < 0.0 or (step == 0.0 and discount < 1.0 and goal > 0.0)
    if least and (goal == step or (paid.on_completion and goal >= 0.0)):
        return 0.0  # the return depends on the length of the tour alone
    if not least or paid.on_completion:
        return None
    return tour_objective_gap(maze, task.num_goals, discount, step, goal, task.max_steps)


def _duel(contest: GameContest, paid: Rewards, discount: float) -> float | None:
    task, maze = contest.task, contest.task.mazes[0]
    chases = contest.role == "chaser"
    best = contest.best_response()
    if best is None:
        return None
    # With T steps the return is step * (1 + ... + discount**(T - 2)) + capture * discount**(T - 1).
    if discount == 1.0:
        return 0.0 if (paid.step < 0.0 if chases else paid.step > 0.0) else None
    of_a_capture = paid.capture - paid.step / (1.0 - discount)
    if of_a_capture <= 0.0 if chases else of_a_capture >= 0.0:
        return None
    table = contest.opponent_table()
    role: Any = contest.role
    values = best_reply(task, role, table, None, discount).values
    order: Any = task.move_order
    moves = list(outcomes(role, maze, table, task.num_actions, order))
    pick: Any = np.min if chases else np.max
    options = expected_after(moves, values if chases else values.T, task.num_actions)
    goal = pick(options, axis=2, keepdims=True)
    forbidden = np.abs(options - goal) > TIE * np.abs(goal)
    steps = np.zeros_like(values)
    for _ in range(task.max_steps):
        options = expected_after(moves, steps, task.num_actions)
        options[forbidden] = np.inf if chases else -np.inf
        before, steps = steps, 1.0 + pick(options, axis=2)
        np.fill_diagonal(steps, 0.0)
        if (steps == before).all():
            break
    least = task.min_start_distance
    return mean_over_starts(steps, maze, least) / mean_over_starts(best.values, maze, least) - 1.0


def _whole_game(contest: GameContest, discount: float) -> ObjectiveGap:
    """The objective gap against fixed opponents, from the solution of the whole game.

    The remaining steps are not observed, so the best policy is that of the game without time limit;
    it is evaluated with the time limit.
    """
    steps, paid = contest.best_of_steps, contest.best_of_returns
    best = paid or steps
    if best is None:
        return UNKNOWN
    task, name = contest.task, best.agents[0]
    plan = solve_joint(task, [name], contest.opponents, None, discount, "return").policy
    found = evaluate_joint(task, {**contest.opponents, name: plan}, task.max_steps, agents=[name])
    return ObjectiveGap(
        None if steps is None else found.steps[name] / steps.mean_over_starts - 1.0,
        None if paid is None else paid.mean_over_starts - found.returns[name],
    )
