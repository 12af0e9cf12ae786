"""`pursuit.evaluate`: compares a policy with the exact optimum."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pursuit.plugins import from_train
from pursuit.simulator.batch import Rules
from pursuit.simulator.policy import Policy


@dataclass(frozen=True)
class Evaluation:
    """The results of a policy, and the exact optimum from the same start positions.

    Attributes:
        episodes: number of episodes.
        mean_steps: mean episode length; a truncated episode counts with all its steps.
        ci95: half width of the 95 % confidence interval of `mean_steps`; 0 if it is exact.
        success_rate: share of successful episodes: all evaders captured (chaser), escaped or
            in games without exits not captured (evader), or all goals collected (runner).
        optimal_steps: mean episode length of the optimal policy; None if unknown.
        gap: mean_steps / optimal_steps - 1. Evaders maximise episode length, so their exact
            gap is at most 0; a sampled one can be above.
        gap_ci95: 95 % confidence interval of the gap (lower, upper), from paired differences on
            the same start positions (delta method for a ratio of means).
        measure: the metric of the task: "steps", "goals" (race), "return" (heist, small games), or
            with exits the "outcome", captures minus escapes.
        mean, optimum: the mean of this metric for the policy and for the optimal policy; None if
            unknown.
        why_no_optimum: the reason why `optimum` is None; None if it is known.
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
    why_no_optimum: str | None = None


def evaluate(
    policy: Callable[[Any], Any] | Policy,
    task: Rules | str,
    agent: str | None = None,
    observation: str | None = None,
    *,
    opponent: Any = None,
    opponent_epsilon: float = 0.0,
    episodes: int = 1000,
    seed: int = 0,
    **settings: Any,
) -> Evaluation:
    """Evaluate a policy with held-out seeds and compare it with the exact optimum.

    The result is exact, without sampling, in a duel of policies with `action_probabilities`, such
    as a `scripted_agents.TablePolicy`, and of a policy with a `table` in a small game.

    Args:
        policy: a function from observations [games, ...] to actions ([games] integers; for an arm
            [games, joints] floats), a `Policy`, or of a small game a `TableAgent`.
        task: a `Task`, a `ReacherTask`, a `GameTask`, or the name of a task with `settings`.
        agent: the name or role of the agent that the policy controls; default: the first agent.
        observation: the encoding of the observations; default: "one_hot", for an arm "positions",
            for a small game "index".
        opponent, opponent_epsilon: the policies of the other agents, as in `gymnasium.make`; in a
            small game without folders of runs.
        episodes: number of episodes, at least 2.
        seed: seed of the start positions; training uses other seeds.
        **settings: settings of `pursuit.Task`, if `task` is a name.

    Raises:
        ValueError: invalid settings, an unknown agent or observation, or invalid actions.
        ImportError: a required package is not installed, for example torch.
    """
    chosen = {"opponent": opponent, "opponent_epsilon": opponent_epsilon, **settings}
    return from_train("train.evaluation.functions:evaluate")(
        policy, task, agent, observation, episodes, seed, chosen
    )
