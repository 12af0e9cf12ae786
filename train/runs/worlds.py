"""Tasks with their opponents, environments and contests: games in mazes, arms, small games."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from pursuit.environments.single_agent import fill_seats
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents.environments import AGENTS
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.scores import BY_MOST_STEPS, measure_of
from train.evaluation.small_game_contest import SmallGameContest
from train.evaluation.suite_contest import SuiteContest
from train.evaluation.team_contest import TeamContest
from train.networks.arm_policy import ArmSeat
from train.networks.policy import MazeSeat
from train.networks.seat import Seat
from train.networks.small_game_policy import SmallGameSeat
from train.runs.opponents import opponents_of, player_policy
from train.runs.tasks import agent_of, discount_of, game_of, player_in, reward_scale, task_of
from train.settings.checks import EVALUATION_SEED
from train.settings.task import AnyTask, ReacherSettings, SmallGameSettings, TaskSettings
from train.teaching.context import ArmContext, CurriculumContext, SmallGameContext
from train.teaching.plan import Plan
from train.teaching.teacher import EpisodeMetrics, Teacher

if TYPE_CHECKING:  # TorchRL and TensorDict, which are slow to import; only training needs them
    from train.environments.simulator_env import SimulatorEnv


@dataclass(frozen=True)
class GridWorld:
    """A game in mazes with its opponents, built once from settings.

    With `team` evaluations are of the whole team of the learning agent (`TeamContest`), if it has
    several members.

    Attributes:
        task: of the evaluation.
        context: for which curricula are built.
    """

    settings: TaskSettings
    team: bool = False

    @cached_property
    def task(self) -> Task:
        """The task; ValueError for settings that it does not allow."""
        return task_of(self.settings)

    @cached_property
    def agent(self) -> str:
        """The learning agent; ValueError unless the task has it."""
        return agent_of(self.settings, self.task)

    @cached_property
    def opponents(self) -> dict[str, Policy]:
        """The policy of every role; ValueError as `opponents_of`."""
        given = self.settings
        how = (given.opponent, given.opponent_epsilon, given.opponent_policy)
        return opponents_of(self.task, self.agent, *how, given.opponent_observation)

    @property
    def context(self) -> CurriculumContext:
        """The task and its opponents, for a curriculum."""
        given = self.settings
        learned = None if given.opponent in AGENTS else given.opponent
        epsilon = given.opponent_epsilon
        return CurriculumContext(self.task, self.agent, self.opponents, epsilon, learned)

    def games(
        self, seat: Seat, num_games: int, seed: int, plan: Plan | None, first_game: int = 0
    ) -> tuple[SimulatorEnv, Teacher | None]:
        """The training environment, and the teacher in it.

        Args:
            seat: the learning agent, with the training task.
            num_games: number of parallel games.
            seed: of the games.
            plan: of the curriculum; None without one.
            first_game: index of the first game among those of the seed.
        """
        from train.environments.simulator_env import SimulatorEnv

        assert isinstance(seat, MazeSeat)
        number, policies = fill_seats(seat.task, seat.agent, self.opponents)
        members = seat.members if seat.team else 1
        agents = seat.task.count(seat.role) if seat.team else 1
        seats = slice(number, number + agents)
        policies[seats] = [None] * agents
        metrics = EpisodeMetrics(
            lambda games: won_by(games, number),
            lambda games: games.returns[:, seats].mean(axis=1),
            measure_of(seat.task, seat.role) != BY_MOST_STEPS,
        )
        count = max(num_games // members, 1)
        simulator = Simulator(seat.task, count, seed, first_game, auto_restart=False)
        teacher = None if plan is None else Teacher(plan, simulator, metrics)
        return SimulatorEnv(simulator, seat, policies, teacher, members), teacher

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> GameContest | SuiteContest:
        """The contest of evaluations: in the task itself, independent of the curriculum."""
        given = (self.task, self.agent, self.opponents, episodes, seed)
        role = self.task.seat_roles[self.task.seat(self.agent)]
        if self.team and self.task.count(role) > 1:
            check(
                not hasattr(self.opponents[role], "task"),
                f"opponent={self.settings.opponent!r} is a policy for {role!r}, but the whole team "
                "is evaluated; give one for another role",
            )
            return TeamContest(self.task, role, *given[2:], mask_bumps=self.settings.mask_bumps)
        if len(self.task.mazes) > 1:
            return SuiteContest(*given)
        return GameContest(*given, mask_bumps=self.settings.mask_bumps)


@dataclass(frozen=True)
class ArmWorld:
    """An arm, with the same interface as `GridWorld`."""

    settings: ReacherSettings

    @cached_property
    def task(self) -> ReacherTask:
        """The task."""
        return self.settings.build()

    @property
    def context(self) -> ArmContext:
        """The arm, for a curriculum."""
        return ArmContext(self.task)

    def games(
        self, seat: Seat, num_games: int, seed: int, plan: Plan | None, first_game: int = 0
    ) -> tuple[SimulatorEnv, Teacher | None]:
        """As in `GridWorld`."""
        from train.environments.simulator_env import SimulatorEnv

        assert isinstance(seat, ArmSeat)
        simulator = ReacherSimulator(seat.task, num_games, seed, first_game, auto_restart=False)
        metrics = EpisodeMetrics(lambda arms: arms.terminated, lambda arms: arms.returns)
        teacher = None if plan is None else Teacher(plan, simulator, metrics)
        return SimulatorEnv(simulator, seat, hook=teacher), teacher

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> ArmContest:
        """As in `GridWorld`."""
        return ArmContest(self.task, episodes, seed)


@dataclass(frozen=True)
class SmallGameWorld:
    """A small game with the policies of the other players, with the interface of `GridWorld`."""

    settings: SmallGameSettings

    @cached_property
    def task(self) -> GameTask:
        """The game."""
        return game_of(self.settings)

    @cached_property
    def agent(self) -> str:
        """The learning player; ValueError unless the game has it."""
        return player_in(self.settings, self.task)

    @cached_property
    def opponents(self) -> dict[str, StatePolicy]:
        """The policy of every other player; ValueError for an unknown one."""
        given = self.settings
        how = (given.opponent_epsilon, given.opponent_policy == "greedy")
        return {
            name: player_policy(given.opponent, self.task, name, *how)
            for name in self.task.agent_names
            if name != self.agent
        }

    @property
    def context(self) -> SmallGameContext:
        """The game and the policies of the other players, for a curriculum."""
        epsilon = self.settings.opponent_epsilon
        return SmallGameContext(self.task, self.agent, self.opponents, epsilon)

    def games(
        self, seat: Seat, num_games: int, seed: int, plan: Plan | None, first_game: int = 0
    ) -> tuple[SimulatorEnv, Teacher | None]:
        """As in `GridWorld`."""
        from train.environments.simulator_env import SimulatorEnv

        assert isinstance(seat, SmallGameSeat)
        simulator = GameSimulator(seat.task, num_games, seed, first_game, auto_restart=False)
        number = seat.number
        metrics = EpisodeMetrics(
            lambda games: games.returns[:, number] > games.returns.mean(axis=1),
            lambda games: games.returns[:, number],
        )
        teacher = None if plan is None else Teacher(plan, simulator, metrics)
        policies = [self.opponents.get(name) for name in seat.task.agent_names]
        scale = reward_scale(self.task, self.agent, discount_of(self.settings))
        return SimulatorEnv(simulator, seat, policies, teacher, scale=scale), teacher

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> SmallGameContest:
        """As in `GridWorld`."""
        return SmallGameContest(self.task, self.agent, self.opponents, episodes, seed)


World = GridWorld | ArmWorld | SmallGameWorld


def world_of(settings: AnyTask, team: bool = False) -> World:
    """The world of a task's settings; `team` as in `GridWorld`."""
    if isinstance(settings, SmallGameSettings):
        return SmallGameWorld(settings)
    if isinstance(settings, ReacherSettings):
        return ArmWorld(settings)
    return GridWorld(settings, team)
