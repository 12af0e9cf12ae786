"""Games in mazes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from pursuit.environments.single_agent import fill_seats
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.validation import check
from scripted_agents.names import AGENTS
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.maze_sides import MazeSides
from train.evaluation.scores import BY_MOST_STEPS, measure_of_role
from train.evaluation.suite_contest import SuiteContest
from train.evaluation.team_contest import TeamContest
from train.families.family import Family, TaskWorld
from train.families.maze_policies import MAZE_POLICIES, opponents_of
from train.networks.policy import MazeSeat
from train.networks.seat import Seat
from train.settings.checks import EVALUATION_SEED
from train.settings.run import AgentSettings
from train.settings.task import TaskSettings
from train.teaching.context import CurriculumContext
from train.teaching.plan import training_task
from train.teaching.teacher import EpisodeMetrics


def seat_of(settings: AgentSettings) -> MazeSeat:
    """The learning agent in the training games of a run, which have the mazes of a curriculum."""
    given: Any = settings.task
    task = given.build()
    agent = given.agent_in(task)
    played = training_task(settings.curriculum, settings.curriculum_settings, task)
    network = settings.network
    if network == "auto":
        network = given.usual_network(settings.observation, settings.device)
    how = (given.mask_bumps, settings.frame_stack, network, settings.min_probability or 0.0)
    return MazeSeat(played, agent, settings.observation, *how)


@dataclass(frozen=True)
class GridWorld(TaskWorld):
    """A game in mazes with its opponents."""

    BATCH: ClassVar[Any] = Simulator

    @cached_property
    def opponents(self) -> dict[str, Policy]:
        """The policy of every role; ValueError as `opponents_of`."""
        given = self.settings
        how = (given.opponent, given.opponent_epsilon, given.opponent_policy)
        return opponents_of(self.saved, self.task, self.agent, *how, given.opponent_observation)

    @property
    def context(self) -> CurriculumContext:
        """As of `TaskWorld`."""
        given = self.settings
        learned = None if given.opponent in AGENTS else given.opponent
        epsilon = given.opponent_epsilon
        return CurriculumContext(self.task, self.agent, self.opponents, epsilon, learned)

    def policies(self, seat: Seat) -> list[Policy | None]:
        """As of `TaskWorld`."""
        number, policies = fill_seats(seat.task, seat.agent, self.opponents)
        agents = seat.team_size if seat.team else 1
        policies[number : number + agents] = [None] * agents
        return policies

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `TaskWorld`."""
        number = seat.number
        seats = slice(number, number + (seat.team_size if seat.team else 1))
        return EpisodeMetrics(
            lambda games: won_by(games, number),
            lambda games: games.returns[:, seats].mean(axis=1),
            measure_of_role(seat.task, seat.role) != BY_MOST_STEPS,
        )

    def brief(self, episodes: int, steps: int) -> Any:
        """As of `TaskWorld`. User-defined opponents are built anew, as they may have random streams
        of their own."""
        contest = super().brief(episodes, steps)
        scripted = self.settings.opponent in (None, *AGENTS)
        return contest if scripted else replace(contest, opponents=replace(self).opponents)

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> GameContest | SuiteContest:
        """As of `TaskWorld`; with `team` of the whole team."""
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
            return SuiteContest(*given, mask_bumps=self.settings.mask_bumps)
        return GameContest(*given, mask_bumps=self.settings.mask_bumps)


FAMILY = Family(TaskSettings, seat_of, GridWorld, MAZE_POLICIES, MazeSides)
