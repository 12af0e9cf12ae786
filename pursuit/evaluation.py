"""How far any policy is from the optimum: `pursuit.evaluate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pursuit.plugins import from_train
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task


@dataclass(frozen=True)
class Evaluation:
    """What a policy achieves, beside the exact optimum on the same starts.

    Attributes:
        episodes: played.
        mean_steps: mean episode length; an episode that runs out of time counts with all its steps.
        ci95: half width of its 95 % confidence interval; 0 where it is exact.
        success_rate: share of episodes won: the chasers caught all, the evader lived to the last
            step, all goals were collected.
        optimal_steps: the mean length under the best possible play; None where it is not known.
        gap: mean_steps / optimal_steps - 1. Evaders maximise the length, so theirs is at most 0.
        gap_ci95: the 95 % confidence interval of the gap (lower, upper), from the differences on
            equal starts (delta method of a ratio of means).
        measure: what the task is judged by: "steps", "goals" (a race) or "return" (a heist).
        mean, optimum: in that measure, the mean of the policy and of the best possible play; None
            where it is not known.
    """

    episodes: int
    mean_steps: float
    ci95: float
    success_rate: float
    optimal_steps: float | None
    gap: float | None
    gap_ci95: tuple[float, float] | None
    measure: str
    mean: float
    optimum: float | None


def evaluate(
    policy: Callable[[Any], Any] | Policy,
    task: Task | ReacherTask | str,
    agent: str | None = None,
    observation: str | None = None,
    *,
    opponent: Any = None,
    opponent_epsilon: float = 0.0,
    episodes: int = 1000,
    seed: int = 0,
    **settings: Any,
) -> Evaluation:
    """Play a policy from held-out seeds, and compare it with the exact optimum.

    Args:
        policy: a function of observations [games, ...] that returns actions: [games] integers, of
            an arm [games, joints]; or a `Policy`.
        task: a `Task`, a `ReacherTask`, or the name of a task, whose settings are `settings`.
        agent: that the policy plays, by name or role; the first of the task if left out.
        observation: what the function is given; "one_hot", of an arm "positions", if left out.
        opponent, opponent_epsilon: the policies of the other seats, as in `gymnasium.make`.
        episodes: at least 2.
        seed: of the starts. None is ever trained on.
        **settings: of `pursuit.Task`, where `task` is a name.

    Raises:
        ValueError: settings that make no game, an unknown agent or observation, or actions that
            are none.
        ImportError: what this, or a learned opponent, needs is not installed (torch, above all).
    """
    chosen = {"opponent": opponent, "opponent_epsilon": opponent_epsilon, **settings}
    found: Evaluation = from_train("train.evaluation.functions:evaluate")(
        policy, task, agent, observation, episodes, seed, chosen
    )
    return found
