"""`Family`: the record of the parts of a kind of game; `TaskWorld`: a task with its policies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

from pursuit.simulator.batch import Batch
from pursuit.validation import Missing
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from train.evaluation.sides import Sides
from train.families.policies import NamedPolicies
from train.networks.seat import Seat
from train.settings.checks import EVALUATION_SEED
from train.settings.run import AgentSettings
from train.settings.task_form import TaskForm
from train.teaching.context import Context
from train.teaching.plan import Plan
from train.teaching.teacher import EpisodeMetrics, Teacher

if TYPE_CHECKING:  # torch is slow to import
    from train.environments.batch_env import BatchEnv
    from train.environments.vector_env import LearnerVectorEnv


@dataclass(frozen=True)
class TaskWorld(ABC):
    """A task with the policies of its agents, built once from settings.

    Attributes:
        settings: of the task.
        team: whether the whole team of the learning agent is evaluated, if it has several members.
        saved: reads saved policies.
        BATCH: the class of the simulator.
        scale: factor of rewards in training.
    """

    BATCH: ClassVar[type[Batch[Any]]]
    scale: ClassVar[float] = 1.0

    settings: Any
    team: bool = False
    saved: Any = field(default=None, compare=False)

    @cached_property
    def task(self) -> Any:
        """The task; ValueError for settings that it does not allow."""
        return self.settings.build()

    @cached_property
    def agent(self) -> str:
        """The learning agent; ValueError unless the task has it."""
        return str(self.settings.agent_in(self.task))

    @property
    @abstractmethod
    def opponents(self) -> dict[str, Any]:
        """The policies of the other agents, by agent or role; ValueError for an unknown one."""

    @property
    def context(self) -> Context:
        """The task and its policies, for curricula; by default what any batch allows."""
        return Context(self.task, self.agent, self.opponents)

    @abstractmethod
    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> Any:
        """The contest of evaluations: in the task itself, independent of the curriculum."""

    def optimal_policy(self) -> Any:
        """The exact best response of the learning agent to the opponents of these settings, in the
        measure of its evaluation, as a target of imitation: uniform over all equally good actions.

        In games in mazes with `distribution(task, games, seat)`, also in several mazes, in small
        games with `table(task)`. It is the policy of the first step of an episode, in all steps: so
        its result is exactly the optimum where the time limit does not change what is optimal.
        Where time costs nothing, as with exits or for goals in a race, waiting can be as good as
        going, and it may run into the time limit. Of a team that learns as one player it is one
        optimal plan, without its ties, as members that mix independently play other joint actions;
        of a kind of games with a `ReturnSolver` it is the policy of that solver.

        Raises:
            ValueError: it is not known: of the arm, with a limited view, of a game that is too
                large, or against a policy without known probabilities.
        """
        return self.contest(1).solved_up_to(MAX_EVALUATED_WORK).optimal_policy()

    def brief(self, episodes: int, steps: int) -> Any:
        """A contest of few short episodes, to measure how long evaluations take."""
        return self.contest(episodes).brief(steps)

    @abstractmethod
    def policies(self, seat: Seat) -> list[Any]:
        """The policy of each agent of the training games; None for the learner's."""

    @abstractmethod
    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """How the outcomes of the learner's episodes are read from the simulator."""

    def bounded(self, discount: float) -> bool:
        """Whether the time limit ends the game, for learners with this discount."""
        return False

    def games(
        self,
        form: type[BatchEnv],
        seat: Seat,
        num_games: int,
        seed: int,
        plan: Plan | None,
        first_game: int = 0,
        discount: float = 0.0,
    ) -> tuple[BatchEnv, Teacher | None]:
        """The training environment, and the teacher in it.

        Args:
            form: the class of the environment.
            seat: the learning agent, with the training task.
            num_games: number of parallel games, times the members of a team.
            seed: of the games.
            plan: of the curriculum; None without one.
            first_game: index of the first game among those of the seed.
            discount: of the learner.
        """
        members = seat.members if seat.team else 1
        batch = self.BATCH(
            seat.task, max(num_games // members, 1), seed, first_game, auto_restart=False
        )
        teacher = None if plan is None else Teacher(plan, batch, self.metrics(seat))
        how = (teacher, members, self.scale, self.bounded(discount))
        return form(batch, seat, self.policies(seat), *how), teacher

    def vector_games(
        self, seat: Seat, num_games: int, seed: int, discount: float
    ) -> LearnerVectorEnv:
        """As `games`, for a learner with a loop of its own, and without a curriculum."""
        from train.environments.vector_env import LearnerVectorEnv

        batch, how = self.BATCH(seat.task, num_games, seed, 0, False), self.policies(seat)
        return LearnerVectorEnv(batch, seat, how, self.scale, self.bounded(discount))


@dataclass(frozen=True)
class Family:
    """The parts of a kind of game; `Missing` where it lacks one.

    Attributes:
        settings: the form of the settings of its tasks.
        seat: (settings of a run) -> the learning agent in its training games, alone.
        world: (settings of a task, team, saved runs) -> the task with its policies.
        policies: by name.
        sides: (world, task, discount) -> its sides in self-play and leagues.
    """

    settings: type[TaskForm]
    seat: Callable[[AgentSettings], Seat]
    world: Callable[..., TaskWorld]
    policies: NamedPolicies | Missing
    sides: Callable[..., Sides] | Missing
