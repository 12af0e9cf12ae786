"""Evaluation of any function from observations to actions, compared with the optimum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.evaluation import Evaluation
from pursuit.reacher.task import make_reacher_task
from pursuit.simulator.policy import ONE_RESULT
from pursuit.tasks.task import make_task
from pursuit.validation import check, whole
from train.evaluation.contests import contest_for
from train.evaluation.games import half_width
from train.evaluation.scores import Contest, FunctionActions
from train.settings.checks import evaluation_seed


class FunctionPolicy:
    """A function of observations [games, ...] as a policy of an agent."""

    def __init__(
        self, function: Callable[[Any], Any], observation: str, actions: FunctionActions
    ) -> None:
        self.function, self.observation, self.actions = function, observation, actions

    def act(self, view: Any) -> NDArray[Any]:
        """The actions in the form of the simulators.

        Raises:
            ValueError: actions of a wrong shape, type or range.
        """
        returned, (most, each, moves) = self.function(view.observe(self.observation)), self.actions
        check(not isinstance(returned, tuple), ONE_RESULT)
        actions = np.asarray(returned)
        shape, kinds = (view.num_games, *each), "fiu" if most is None else "iu"
        check(
            actions.shape == shape and actions.dtype.kind in kinds,
            f"the policy returned actions of shape {actions.shape}, dtype {actions.dtype}; return "
            f"{'numbers' if most is None else 'integers'} of shape {shape}",
        )
        check(
            most is None or bool(((actions >= 0) & (actions < most)).all()),
            f"the policy returned actions from {actions.min()} to {actions.max()}; return integers "
            f"from 0 to {(most or 0) - 1}",
        )
        return moves(actions)


def evaluate(
    policy: Any,
    task: Any,
    agent: str | None,
    observation: str | None,
    episodes: int,
    seed: int,
    settings: Mapping[str, Any],
) -> Evaluation:
    """As `pursuit.evaluate`; `settings` are those of the opponents and of the task."""
    whole("episodes", episodes, 2)
    own = {key: value for key, value in settings.items() if not key.startswith("opponent")}
    check(
        isinstance(task, str) or not own,
        f"{', '.join(own)}: settings of a new task, and task is a Task; leave them out",
    )
    if isinstance(task, str):
        task = make_reacher_task(**own) if task == "reacher" else make_task(task, **own)
    others = settings["opponent"], settings["opponent_epsilon"]
    contest, usual = contest_for(task, agent, *others, episodes, evaluation_seed(seed))
    if not callable(getattr(policy, "act", None)):
        check(callable(policy), f"policy={policy!r}; give a function of observations, or a Policy")
        seen = usual if observation is None else observation
        policy = FunctionPolicy(policy, seen, contest.actions)
    return _compared(contest, policy)


def _compared(contest: Contest[Any, Any], policy: Any) -> Evaluation:
    """The score of a policy in a contest, compared with the optimum."""
    measure, steps, gap, interval = contest.measure, None, None, None
    value: Any
    if contest.is_exact_for(policy):
        score, best = contest.score("policy", policy), contest.optimum()
        value = measure.of(score)
        reached = None if best is None else measure.of(best)
        if measure.by_steps and reached is not None:
            steps, gap = reached, score.mean_steps / reached - 1.0
            interval = (gap, gap)
        played = (score.episodes, score.mean_steps, 0.0, score.success_rate)
        why = None if reached is not None else contest.exact_reference.reason
        return Evaluation(*played, steps, gap, interval, measure.name, value, reached, why)
    lengths, won = contest.play(policy)
    least, mean = contest.optimal_lengths(), float(lengths.mean())
    if least is not None:
        steps = float(least.mean())
        gap = mean / steps - 1.0
        half = half_width(lengths - (gap + 1.0) * least) / steps
        interval = (gap - half, gap + half)
    value, reached = mean, steps
    if not measure.by_steps:
        value, best = float(contest.values(policy).mean()), contest.optimum()
        reached = None if best is None else measure.of(best)
    figures = (half_width(lengths), float(won.mean()), steps, gap, interval)
    unequal = "bounds of the minimum steps are not equal from every start"  # of an arm
    why = None if reached is not None else contest.exact_reference.reason or unequal
    return Evaluation(len(lengths), mean, *figures, measure.name, value, reached, why)
