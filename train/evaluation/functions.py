"""Evaluation of any function from observations to actions, compared with the optimum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.evaluation import Evaluation
from pursuit.reacher.task import ReacherTask, make_reacher_task
from pursuit.simulator.policy import ONE_RESULT
from pursuit.tasks.task import Task, checked_task, make_task
from pursuit.validation import check, whole
from scripted_agents.environments import chosen_policies
from scripted_agents.limits import MAX_EVALUATED_WORK
from scripted_agents.references import is_table_in
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.games import half_width
from train.settings.checks import evaluation_seed


class FunctionPolicy:
    """A function of observations [games, ...] as a policy of an agent or of the arm."""

    def __init__(self, function: Callable[[Any], Any], observation: str) -> None:
        self.function, self.observation = function, observation

    def act(self, view: Any) -> NDArray[Any]:
        """The actions in the form of the simulators.

        Raises:
            ValueError: actions of a wrong shape, type or range.
        """
        task, returned = view.task, self.function(view.observe(self.observation))
        check(not isinstance(returned, tuple), ONE_RESULT)
        actions = np.asarray(returned)
        arm = isinstance(task, ReacherTask)
        shape = (view.num_games, task.joints) if arm else (view.num_games,)
        kinds = "iu" if not arm or task.discrete_actions else "fiu"
        check(
            actions.shape == shape and actions.dtype.kind in kinds,
            f"the policy returned actions of shape {actions.shape}, dtype {actions.dtype}; return "
            f"{'numbers' if 'f' in kinds else 'integers'} of shape {shape}",
        )
        if arm and not task.discrete_actions:
            return actions.astype(np.float64)
        count = 3 if arm else task.num_actions
        check(
            bool(((actions >= 0) & (actions < count)).all()),
            f"the policy returned actions from {actions.min()} to {actions.max()}; return integers "
            f"from 0 to {count - 1}",
        )
        return actions - 1.0 if arm else actions.astype(np.int32)


def evaluate(
    policy: Any,
    task: Task | ReacherTask | str,
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
    contest: ArmContest | GameContest
    if isinstance(task, ReacherTask):
        check(agent in (None, "arm"), f"agent={agent!r}; give 'arm' for task 'reacher'")
        for name, none in (("opponent", None), ("opponent_epsilon", 0.0)):
            check(
                settings[name] == none,
                f"{name}={settings[name]!r}; task 'reacher' has no other agents; leave it out",
            )
        contest = ArmContest(task, episodes, evaluation_seed(seed))
    else:
        agent = checked_task(task).agent_names[0] if agent is None else agent
        task.seat(agent)
        others = chosen_policies(task, agent, settings["opponent"], settings["opponent_epsilon"])
        rest = (episodes, evaluation_seed(seed), False, MAX_EVALUATED_WORK)
        contest = GameContest(task, agent, others, *rest)
    if not callable(getattr(policy, "act", None)):
        check(callable(policy), f"policy={policy!r}; give a function of observations, or a Policy")
        if observation is None:
            observation = "positions" if isinstance(task, ReacherTask) else "one_hot"
        policy = FunctionPolicy(policy, observation)
    return _compared(contest, policy)


def _compared(contest: ArmContest | GameContest, policy: Any) -> Evaluation:
    """The score of a policy in a contest, compared with the optimum."""
    game = contest if isinstance(contest, GameContest) else None
    if game is not None and game.is_table_duel and is_table_in(game.task, policy):
        score, best = contest.score("policy", policy), contest.optimal()
        steps = None if best is None else best.mean_steps
        gap = None if steps is None else score.mean_steps / steps - 1.0
        both = None if gap is None else (gap, gap)
        mean = score.mean_steps
        played = (score.episodes, mean, 0.0, score.success_rate)
        why = None if steps is not None else contest.exact_reference.reason
        return Evaluation(*played, steps, gap, both, "steps", mean, steps, why)
    lengths, won = contest.play(policy)
    least = contest.optimal_lengths()
    mean, optimum, gap, interval = float(lengths.mean()), None, None, None
    if least is not None:
        optimum = float(least.mean())
        gap = mean / optimum - 1.0
        half = half_width(lengths - (gap + 1.0) * least) / optimum
        interval = (gap - half, gap + half)
    measure, value, reached = "steps", mean, optimum
    if game is not None and not game.measure.by_steps:
        measure, value = game.measure.name, float(game.values(policy).mean())
        best = game.optimal(game.measure)
        reached = None if best is None else game.measure.of(best)
    figures = (half_width(lengths), float(won.mean()), optimum, gap, interval)
    unequal = "bounds of the minimum steps are not equal from every start"  # of an arm
    why = None if reached is not None else contest.exact_reference.reason or unequal
    return Evaluation(len(lengths), mean, *figures, measure, value, reached, why)
