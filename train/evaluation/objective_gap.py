"""The objective gap: the optimality gap of the policy with the best discounted return.

Training maximises discounted returns, and evaluation counts steps, so even an optimal learner has
this gap. It is known exactly for duels and single runners if rewards depend only on the time of
captures and goals, and for one agent in a whole game that is solved.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pursuit.tasks.task import Rewards, Task
from scripted_agents import evaluate_joint, mean_over_starts, solve_joint
from scripted_agents.duel.action_values import expected_after, outcomes
from scripted_agents.limits import (
    MAX_OBJECTIVE_CELLS,
    MAX_OBJECTIVE_WORK,
    is_single_runner,
    work_of,
)
from scripted_agents.long_work import OutOfTime, why_no_time
from scripted_agents.tolerances import EQUAL_VALUES
from scripted_agents.tours.objective import tour_objective_gap
from train.evaluation.contest import OUTCOMES, GameContest
from train.evaluation.contests import AnyContest
from train.evaluation.games import best_reply, duel_role, order_of
from train.evaluation.scores import BY_RETURN, BY_STEPS
from train.evaluation.small_game_contest import SmallGameContest


class ObjectiveGap(NamedTuple):
    """The loss of the policy with the best discounted return; None where unknown.

    Attributes:
        gap: its `optimality_gap`, at most 0 for evaders.
        missing_return: the best undiscounted return minus its own, if other agents collect goals;
            with exits in captures minus escapes, for an evader its own minus the least.
    """

    gap: float | None = None
    missing_return: float | None = None


UNKNOWN = ObjectiveGap()


def objective_gap(contest: AnyContest, discount: float) -> ObjectiveGap:
    """The loss of the policy with the best discounted return, exact over all starts.

    Ties are broken by the fewest steps (evader: the most), in a whole game (team, race, heist)
    arbitrarily. In a race both values are known. The gap in steps is large there with any discount,
    as rewards for goals do not favour short games.

    Unknown for games that are too large, action masks, distance or user-defined rewards, several
    mazes, starts at marks, a team as one player, too many goals to enumerate, rewards that do not
    favour short episodes (evader: long ones), a limited view, a whole game without discount,
    discount 0, and the arm.
    """
    if isinstance(contest, SmallGameContest) and discount > 0.0:
        return ObjectiveGap(missing_return=contest.missing_return(discount))
    if not isinstance(contest, GameContest) or contest.is_limited or discount == 0.0:
        return UNKNOWN
    if len(contest.seats) > 1:
        return UNKNOWN
    task = contest.task
    rewards = task.role_rewards[contest.role]
    by_time = rewards.distance == 0.0 and task.reward_function is None
    if len(task.mazes) > 1 or task.start != "random" or not by_time:
        return UNKNOWN
    if is_single_runner(task):
        return ObjectiveGap(_tour_gap(task, rewards, discount))
    if contest.is_table_duel and not contest.mask_bumps and task.max_cells <= MAX_OBJECTIVE_CELLS:
        return ObjectiveGap(_duel_gap(contest, rewards, discount))
    masked_or_large = contest.mask_bumps or work_of(task) > MAX_OBJECTIVE_WORK
    if contest.is_table_duel or masked_or_large or discount >= 1.0:
        return UNKNOWN
    try:
        return _joint_gap(contest, discount)
    except OutOfTime:  # the optimum is known already
        if why_no_time(work_of(contest.task)) is None:
            raise
        return UNKNOWN


def _tour_gap(task: Task, rewards: Rewards, discount: float) -> float | None:
    maze, step, goal = task.mazes[0], rewards.step, rewards.goal
    least = step < 0.0 or (step == 0.0 and discount < 1.0 and goal > 0.0)
    if least and (goal == step or (rewards.on_completion and goal >= 0.0)):
        return 0.0  # the return depends only on the length of the tour
    if not least or rewards.on_completion:
        return None
    return tour_objective_gap(maze, task.num_goals, discount, step, goal, task.max_steps)


def _duel_gap(contest: GameContest, rewards: Rewards, discount: float) -> float | None:
    task, maze = contest.task, contest.task.mazes[0]
    chases = contest.role == "chaser"
    best = contest.best_in()
    if best is None:
        return None
    # With T steps the return is step * (1 + ... + discount**(T - 2)) + capture * discount**(T - 1).
    if discount == 1.0:
        return 0.0 if (rewards.step < 0.0 if chases else rewards.step > 0.0) else None
    of_capture = rewards.capture - rewards.step / (1.0 - discount)
    if of_capture <= 0.0 if chases else of_capture >= 0.0:
        return None
    table = contest.opponent_table()
    role = duel_role(contest.role)
    values = best_reply(task, role, table, None, discount).values
    moves = list(outcomes(role, maze, table, task.num_actions, order_of(task)))
    pick: Any = np.min if chases else np.max
    options = expected_after(moves, values if chases else values.T, task.num_actions)
    goal = pick(options, axis=2, keepdims=True)
    forbidden = np.abs(options - goal) > EQUAL_VALUES * np.abs(goal)
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


def _joint_gap(contest: GameContest, discount: float) -> ObjectiveGap:
    """The objective gap against fixed opponents, from the solution of the whole game.

    Learners do not observe the remaining steps, so the policy is optimised without time limit.
    It is evaluated with the time limit. The discount is that of a round of turns.
    """
    steps, returns = contest.best_in(BY_STEPS), contest.best_in(BY_RETURN)
    best = returns or steps or contest.best_in(contest.measure)
    if best is None:
        return UNKNOWN
    task, name = contest.task, contest.task.agent_names[contest.seat]
    plan = solve_joint(task, [name], contest.opponents, None, discount, "return").policy
    played = {**contest.opponents, name: plan}
    if contest.measure.name == "outcome":
        counted = replace(task, rewards=OUTCOMES)
        own = evaluate_joint(counted, played, task.max_steps, agents=[name]).returns[name]
        return ObjectiveGap(missing_return=best.mean_over_starts - own)
    found = evaluate_joint(task, played, task.max_steps, agents=[name])
    return ObjectiveGap(
        None if steps is None else found.steps[name] / steps.mean_over_starts - 1.0,
        None if returns is None else returns.mean_over_starts - found.returns[name],
    )
