"""The objective gap: the optimality gap of the policy with the best discounted return.

Training maximises discounted returns, and evaluation counts steps, so even an optimal learner has
this gap. It is known exactly for duels and single runners if rewards depend only on the time of
captures and goals, and for one agent in a whole game that is solved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pursuit.rules.arrays import Reals
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Rewards, Task
from scripted_agents import BestResponse, evaluate_joint, mean_over_starts, solve_joint
from scripted_agents.exact.duel.action_values import expected_after, outcomes
from scripted_agents.exact.tolerances import EQUAL_VALUES
from scripted_agents.exact.tours.objective import tour_objective_gap
from train.evaluation.departures import OUTCOME_REWARDS
from train.evaluation.games import best_reply, duel_role, order_of
from train.evaluation.scores import BY_RETURN, BY_STEPS, UNKNOWN_GAP, Measure, ObjectiveGap


def tour_gap(task: Task, rewards: Rewards, discount: float) -> float | None:
    """The gap in steps of a single runner."""
    maze, step, goal = task.mazes[0], rewards.step, rewards.goal
    least = step < 0.0 or (step == 0.0 and discount < 1.0 and goal > 0.0)
    if least and (goal == step or (rewards.on_completion and goal >= 0.0)):
        return 0.0  # the return depends only on the length of the tour
    if not least or rewards.on_completion:
        return None
    return tour_objective_gap(maze, task.num_goals, discount, step, goal, task.max_steps)


def duel_gap(
    task: Task, role: str, table: Reals, best: BestResponse, discount: float
) -> float | None:
    """The gap in steps of a role of a duel.

    Args:
        task: the rules.
        role: of the agent.
        table: of the opponent, [its cell, other cell, action].
        best: the best response in steps.
        discount: of the returns.
    """
    maze, rewards, chases = task.mazes[0], task.role_rewards[role], role == "chaser"
    # With T steps the return is step * (1 + ... + discount**(T - 2)) + capture * discount**(T - 1).
    if discount == 1.0:
        return 0.0 if (rewards.step < 0.0 if chases else rewards.step > 0.0) else None
    of_capture = rewards.capture - rewards.step / (1.0 - discount)
    if of_capture <= 0.0 if chases else of_capture >= 0.0:
        return None
    solved = duel_role(role)
    values = best_reply(task, solved, table, None, discount).values
    moves = list(outcomes(solved, maze, table, task.num_actions, order_of(task)))
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


def joint_gap(
    task: Task,
    name: str,
    opponents: Mapping[str, Policy],
    measure: Measure,
    best_in: Callable[[Measure], Any],
    discount: float,
) -> ObjectiveGap:
    """The objective gap against fixed opponents, from the solution of the whole game.

    Learners do not observe the remaining steps, so the policy is optimised without time limit.
    It is evaluated with the time limit. The discount is that of a round of turns.

    Args:
        task: the rules.
        name: of the agent.
        opponents: the policies of the others.
        measure: of the evaluation.
        best_in: (measure) -> the best response, or None.
        discount: of the returns.
    """
    steps, returns = best_in(BY_STEPS), best_in(BY_RETURN)
    best = returns or steps or best_in(measure)
    if best is None:
        return UNKNOWN_GAP
    plan = solve_joint(task, [name], opponents, None, discount, "return").policy
    played = {**opponents, name: plan}
    if measure.name == "outcome":
        counted = replace(task, rewards=OUTCOME_REWARDS)
        own = evaluate_joint(counted, played, task.max_steps, agents=[name]).returns[name]
        return ObjectiveGap(missing_return=best.mean_over_starts - own)
    found = evaluate_joint(task, played, task.max_steps, agents=[name])
    return ObjectiveGap(
        None if steps is None else found.steps[name] / steps.mean_over_starts - 1.0,
        None if returns is None else returns.mean_over_starts - found.returns[name],
    )
