"""Evaluation of policies of the arm in steps, with the minimum steps as reference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.reacher.policy import ArmPolicy
from pursuit.reacher.rendering import ArmScene, scene_of
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder
from pursuit.validation import check
from scripted_agents import (
    IK_METHODS,
    InverseKinematics,
    LeastStepsPolicy,
    RandomArm,
    ThesisInverseKinematics,
    least_steps_of,
)
from scripted_agents.exact.references import ARMS, Question, Solution, solution_of
from train.evaluation.recordings import add_recorded
from train.evaluation.scores import (
    BY_STEPS,
    Contest,
    FunctionActions,
    Measure,
    Reference,
    Score,
)
from train.files import Plain
from train.settings.checks import EVALUATION_SEED

EPISODES = 1000
"""Minimum number of starts that are solved together."""


@dataclass(frozen=True)
class Bounds:
    """Bounds of the minimum episode lengths from given starts.

    Attributes:
        lower, upper: [episodes] int64; equal if the minimum is known.
        possible: [episodes] bool, whether the target can be reached within `max_steps`.
    """

    lower: NDArray[np.int64]
    upper: NDArray[np.int64]
    possible: NDArray[np.bool_]

    @property
    def share_exact(self) -> float:
        """The share of starts with a known minimum."""
        return float((self.lower == self.upper).mean())


@lru_cache(maxsize=16)
def bounds_of(task: ReacherTask, episodes: int, seed: int) -> Bounds:
    """Bounds of the minimum episode lengths of an evaluation.

    Every episode has at least `hold` steps and at most `max_steps`. Discrete actions reach fewer
    poses than continuous ones, so for them only the lower bounds are valid.

    Evaluations with few episodes use the first of EPISODES starts, so all share one solution.
    """
    if episodes < EPISODES:
        first = bounds_of(task, EPISODES, seed)
        return Bounds(*(array[:episodes] for array in vars(first).values()))
    arms = ReacherSimulator(task, episodes, seed, auto_restart=False)
    bounds = least_steps_of(arms.angles, arms.targets, task.max_turn, task.tolerance)[:2]
    needed = [np.maximum(steps, 1) + task.hold - 1 for steps in bounds]
    lower, upper = (np.minimum(steps, task.max_steps) for steps in needed)
    return Bounds(lower, upper, needed[0] <= task.max_steps)


@dataclass(frozen=True)
class ArmContest(Contest[ArmPolicy, ReacherSimulator]):
    """Evaluation of the arm; a `Contest`.

    Starting poses are random, or fixed by the task. They are not kept from the previous episode, as
    they would then depend on the policy.
    """

    NO_REPLAY: ClassVar[str] = ""
    measure: ClassVar[Measure] = BY_STEPS
    simulator: ClassVar[type[ReacherSimulator]] = ReacherSimulator

    task: ReacherTask
    episodes: int = 1000
    seed: int = EVALUATION_SEED

    @property
    def exact_reference(self) -> Solution:
        """As `Contest`."""
        return solution_of(Question(self.task, "arm", {}), ARMS)

    def describe(self) -> Plain:
        """The task, the number of joints, and the bounds of the minimum steps."""
        bounds = self.bounds()
        least = {
            "lower": float(bounds.lower.mean()),
            "upper": None if self.task.discrete_actions else float(bounds.upper.mean()),
            "share_exact": 0.0 if self.task.discrete_actions else bounds.share_exact,
        }
        joints = self.task.joints
        return {"task": "reacher", "role": "arm", "maze": None, "joints": joints, "least": least}

    def line(self) -> str:
        """The evaluation in one line of text."""
        task = self.task
        joints = f"{task.joints} joint{'s' if task.joints > 1 else ''}"
        held = f", held for {task.hold} steps" if task.hold > 1 else ""
        discrete = ", discrete actions" if task.discrete_actions else ""
        return (
            f"reacher: an arm of {joints}, target within {task.tolerance:g}{held}{discrete}, "
            f"at most {task.max_steps} steps"
        )

    def stepper(self, games: ReacherSimulator, policy: ArmPolicy) -> Callable[[], None]:
        """As `Contest`."""
        return lambda: games.step(policy.act(games.view()))

    def score(self, name: str, policy: ArmPolicy) -> Score:
        """As `Contest`, by simulation."""
        return Score.of_episodes(name, *self.play(policy))

    def scripted(self) -> ArmPolicy:
        """As `Contest`: inverse kinematics."""
        check(
            not self.task.discrete_actions,
            "an arm with discrete actions has only learned policies; give the folder of a run",
        )
        return InverseKinematics()

    @property
    def best_name(self) -> str:
        """As `Contest`: the policy that attains the proven upper bounds."""
        return "optimal" if self.knows_least_steps else "least steps, as proved"

    def best_policy(self) -> ArmPolicy:
        """As `Contest`."""
        check(not self.task.discrete_actions, "unknown for discrete actions; omit --optimal")
        return LeastStepsPolicy()

    def optimal_policy(self) -> ArmPolicy:
        """As `Contest`: there is none, as an arm has no known distribution over actions."""
        why = "an arm has continuous actions, or an unknown optimum; take another game"
        raise ValueError(f"no optimal policy to imitate: {why}")

    @property
    def notes(self) -> list[str]:
        """As `Contest`: the bounds of the minimum steps."""
        bounds = self.bounds()
        if self.task.discrete_actions:
            least = "minimum steps with continuous actions, a lower bound for discrete actions"
        elif bounds.share_exact == 1.0:
            least = "minimum steps, exact from every start"
        else:
            least = (
                f"at least {bounds.lower.mean():.3f} steps and at most {bounds.upper.mean():.3f}, "
                f"exact from {100 * bounds.share_exact:.1f} % of the starts; gaps are to the lower "
                "bound"
            )
        return [f"optimal: {least}"]

    def bounds(self) -> Bounds:
        """Bounds of the minimum lengths of these episodes."""
        return bounds_of(self.task, self.episodes, self.seed)

    @property
    def knows_least_steps(self) -> bool:
        """Whether the minimum steps are known from every start."""
        return not self.task.discrete_actions and self.bounds().share_exact == 1.0

    def optimal(self) -> Score | None:
        """The lower bounds of the minimum steps from the same starts.

        None if `max_steps` truncates every episode, as all policies have equal lengths then.
        """
        bounds = self.bounds()
        if not bounds.possible.any():
            return None
        return Score.of_episodes("optimal", bounds.lower, bounds.possible)

    def baselines(self) -> list[Score]:
        """Random, the inverse kinematics methods, the thesis' baseline, and the minimum steps.

        If the bounds differ, the policy that attains the upper bounds is included. With discrete
        actions only the random policy and the lower bounds are.
        """
        optimum = self.optimal()
        known = [] if optimum is None else [optimum]
        scores = [self.score("random", RandomArm())]
        if self.task.discrete_actions:
            return scores + known
        scores += [self.score(method, InverseKinematics(method)) for method in IK_METHODS]
        scores.append(self.score("thesis' inverse kinematics", ThesisInverseKinematics()))
        scores += known
        if known and self.bounds().share_exact < 1.0:
            scores.append(self.score(self.best_name, LeastStepsPolicy()))
        return scores

    def reference(self, scores: Sequence[Score], learned: Score) -> Reference | None:
        """As `Contest`; a bound if the minimum steps are not known exactly from every start."""
        found = super().reference(scores, learned)
        if found is None or found.kind != "exact" or self.knows_least_steps:
            return found
        return replace(found, kind="bound")

    def scene(self, games: ReacherSimulator, caption: str, before: object = None) -> ArmScene:
        """As `Contest`."""
        return scene_of(games, caption=caption)

    def add_episodes(
        self,
        builder: Builder,
        policy: ArmPolicy,
        games: Mapping[str, int],
        policy_name: str,
        encoding: str | None = None,
    ) -> Replay:
        """As `Contest`, without observations."""
        return add_recorded(builder, self, policy, games, policy_name)

    def optimal_lengths(self) -> NDArray[np.float64] | None:
        """As `Contest`."""
        return self.bounds().lower.astype(np.float64) if self.knows_least_steps else None

    @property
    def actions(self) -> FunctionActions:
        """As `Contest`: the turns of the joints; discrete ones from 0 for -1 to 2 for 1."""
        shape = (self.task.joints,)
        if self.task.discrete_actions:
            return FunctionActions(3, shape, lambda actions: actions - 1.0)
        return FunctionActions(None, shape, lambda actions: actions.astype(np.float64))
