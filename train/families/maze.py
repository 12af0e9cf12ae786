"""Games in mazes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from pursuit.environments.single_agent import fill_seats
from pursuit.observations.custom import is_builtin
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import check
from scripted_agents.environments import (
    AGENTS,
    chosen_policies,
    default_policies,
    is_agent,
    named_policy,
    roles_of_agent,
)
from train.evaluation.contest import GameContest
from train.evaluation.games import won_by
from train.evaluation.maze_sides import MazeSides
from train.evaluation.scores import BY_MOST_STEPS, measure_of
from train.evaluation.suite_contest import SuiteContest
from train.evaluation.team_contest import TeamContest
from train.families.family import Family, World
from train.families.policies import NamedPolicies, SavedRuns, check_side, loaded
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
    unseen = agent.startswith("runner") and len(task.mazes) > 1 and is_builtin(settings.observation)
    plans = settings.network == "auto" and settings.device == "cpu" and unseen
    network = "planning" if plans else settings.network
    how = (given.mask_bumps, settings.frame_stack, network, settings.min_probability or 0.0)
    return MazeSeat(played, agent, settings.observation, *how)


@dataclass(frozen=True)
class GridWorld(World):
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
        """As of `World`."""
        given = self.settings
        learned = None if given.opponent in AGENTS else given.opponent
        epsilon = given.opponent_epsilon
        return CurriculumContext(self.task, self.agent, self.opponents, epsilon, learned)

    def policies(self, seat: Seat) -> list[Policy | None]:
        """As of `World`."""
        number, policies = fill_seats(seat.task, seat.agent, self.opponents)
        agents = seat.team_size if seat.team else 1
        policies[number : number + agents] = [None] * agents
        return policies

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `World`."""
        number = seat.number
        seats = slice(number, number + (seat.team_size if seat.team else 1))
        return EpisodeMetrics(
            lambda games: won_by(games, number),
            lambda games: games.returns[:, seats].mean(axis=1),
            measure_of(seat.task, seat.role) != BY_MOST_STEPS,
        )

    def brief(self, episodes: int, steps: int) -> Any:
        """As of `World`. User-defined opponents are built anew, as they may have random streams of
        their own."""
        contest = super().brief(episodes, steps)
        scripted = self.settings.opponent in (None, *AGENTS)
        return contest if scripted else replace(contest, opponents=replace(self).opponents)

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> GameContest | SuiteContest:
        """As of `World`; with `team` of the whole team."""
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


# -- policies --------------------------------------------------------------------------------------


def opponents_of(
    saved: SavedRuns,
    task: Task,
    agent: str,
    opponent: str | None,
    epsilon: float,
    played: str = "sampled",
    observation: str | None = None,
) -> dict[str, Policy]:
    """The policy of every role: scripted, or `opponent` for its role.

    Args:
        saved: reads saved runs.
        task: the game.
        agent: the learning agent.
        opponent: one of AGENTS, a user-defined policy, the folder of a run (of self-play: its other
            side) or a model's .zip; None for A*.
        epsilon: share of random moves of the scripted agents.
        played: policy of a learned opponent, "sampled" or "greedy".
        observation: of a model without a description file.

    Raises:
        ValueError: no policy at `opponent`, or one that cannot play against the learner.
    """
    if opponent is None or is_agent(opponent):
        return chosen_policies(task, agent, opponent, epsilon)
    seat = task.seat(agent)
    others = [r for s, r in enumerate(task.seat_roles) if s != seat]
    first = next((r for r in others if r != task.seat_roles[seat]), task.seat_roles[seat])
    path = Path(opponent)
    if (sides := saved.sides(path)) is not None:
        check_side(opponent, sides, first)
        if (fixed := sides.get(first)) is not None:
            return opponents_of(saved, task, agent, fixed.name, epsilon, fixed.played, observation)
        path /= first
    trained = {"task": task, "agent": first, "observation": observation}
    policy = loaded(POLICIES, saved, path, played, **trained)
    role = role_of(policy)
    check(
        role in others,
        f"opponent={opponent!r} is a policy for {role!r}; give one for another agent of task "
        f"{task.name!r}: {', '.join(others) or 'none'}",
    )
    return {**default_policies(task, epsilon), role: policy}


def role_of(policy: Any) -> str:
    """The role of a learned policy."""
    task: Task = policy.task
    return task.seat_roles[task.seat(policy.agent)]


def check_fits(policy: Policy, role: str, task: Task, name: str) -> None:
    """ValueError unless a learned policy is for this role and task."""
    if not hasattr(policy, "task"):
        return
    own: Task = policy.task
    learned = role_of(policy)
    check(learned == role, f"{name}: is a policy for {learned!r}, not for {role!r}; give another")
    plays_in = getattr(policy, "plays_in", lambda maze: False)
    check(
        set(task.mazes) <= set(own.mazes) or all(plays_in(maze) for maze in task.mazes),
        f"{name}: was trained in maze {own.mazes[0].name}, not in {task.mazes[0].name}; use that "
        "maze, or train with observation window:R (on graphs, an observation of your own)",
    )
    same = ("num_chasers", "num_evaders", "num_goals", "stay_action", "move_order", "most_exits")
    for what in same:
        mine, theirs = getattr(own, what), getattr(task, what)
        check(mine == theirs, f"{name}: was trained with {what}={mine}, not {theirs}; use {mine}")


def placed(policy: Policy, task: Task, agent: str, name: str, epsilon: float) -> Policy:
    """A policy, a learned one checked by `check_fits`; it makes no random moves."""
    if hasattr(policy, "task"):  # scripted ones may be of roles that the task does not have
        check_fits(policy, task.seat_roles[task.seat(agent)], task, name)
    return policy


POLICIES = NamedPolicies(
    TaskSettings, AGENTS, is_agent, named_policy, roles_of_agent, placed, role_of
)
FAMILY = Family(TaskSettings, seat_of, GridWorld, POLICIES, MazeSides)
