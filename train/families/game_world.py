"""`GameWorld`: games of agents that are measured in returns, the base for kinds of one's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar

from pursuit.validation import Missing, check
from scripted_agents.exact.references import ReturnSolver
from train.evaluation.return_contest import ReturnContest
from train.families.family import TaskWorld
from train.families.policies import NamedPolicies, policy_named
from train.networks.seat import Seat
from train.settings.checks import EVALUATION_SEED
from train.settings.task_form import TaskForm
from train.teaching.teacher import EpisodeMetrics


@dataclass(frozen=True)
class GameWorld(TaskWorld):
    """A game of agents with policies by name, in returns; the base for kinds of one's own.

    Attributes:
        POLICIES: by name; the first is that of the random policy.
        ZERO_SUM: whether there are two sides, whose returns always add up to 0.
        SOLVER: gives exact returns and best responses; or why there is none.
    """

    POLICIES: ClassVar[NamedPolicies]
    ZERO_SUM: ClassVar[bool] = False
    SOLVER: ClassVar[ReturnSolver | Missing] = Missing("no solver of this game is known")

    @property
    def solver(self) -> ReturnSolver | Missing:
        """As the class says; or why this game is not solved."""
        return self.SOLVER

    @cached_property
    def own(self) -> tuple[str, ...]:
        """The agents that learn: one, or with `team` all of a role."""
        task, first = self.task, self.task.seat(self.agent)
        roles = zip(task.agent_names, task.seat_roles, strict=True)
        if self.team and self.agent in task.seat_roles:
            return tuple(name for name, role in roles if role == self.agent)
        return (task.agent_names[first],)

    @cached_property
    def opponents(self) -> dict[str, Any]:
        """As of `TaskWorld`, by agent."""
        given, roles = self.settings, zip(self.task.agent_names, self.task.seat_roles, strict=True)
        how = (given.opponent_epsilon, given.opponent_policy)
        return {
            name: policy_named(self.POLICIES, self.saved, given.opponent, self.task, role, *how)
            for name, role in roles
            if name not in self.own
        }

    @property
    def policy_names(self) -> tuple[str, ...]:
        """The names of built-in policies."""
        return self.POLICIES.names

    def named(self, name: str, agent: str) -> Any:
        """The policy of this name for an agent or role; as of `policy_named`."""
        return policy_named(self.POLICIES, self.saved, name, self.task, agent)

    def policies(self, seat: Seat) -> list[Any]:
        """As of `TaskWorld`."""
        return [self.opponents.get(name) for name in self.task.agent_names]

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `TaskWorld`."""
        seats = [self.task.seat(name) for name in self.own]
        return EpisodeMetrics(
            lambda games: games.returns[:, seats].mean(axis=1) > games.returns.mean(axis=1),
            lambda games: games.returns[:, seats].mean(axis=1),
        )

    def bounded(self, discount: float) -> bool:
        """As of `TaskWorld`: without discount returns are those within the time limit."""
        return discount == 1.0

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> Any:
        """As of `TaskWorld`."""
        agent = self.agent if len(self.own) > 1 else self.own[0]
        random = self.named(self.policy_names[0], self.task.seat_roles[self.task.seat(agent)])
        how = (self.BATCH, episodes, seed, self.solver, random)
        return ReturnContest(self.task, agent, self.opponents, *how)


def policies_by_name(
    form: type[TaskForm], makers: Mapping[str, Callable[[Any, str, float], Any]]
) -> NamedPolicies:
    """The policies of a kind of game: these, and those of runs.

    Args:
        form: of the settings of its tasks.
        makers: by name (task, agent or role, share of random moves) -> the policy.
    """

    def placed(policy: Any, task: Any, role: str, name: str, epsilon: float) -> Any:
        own = policy.seat.role
        check(own == role, f"{name}: is a policy of {own}, not of {role}; give another")
        check(policy.task == task, f"{name}: was trained in {policy.task}, not in {task}")
        check(epsilon == 0.0, f"{name} with opponent_epsilon={epsilon}; leave it out")
        return policy

    return NamedPolicies(
        form,
        tuple(makers),
        makers.__contains__,
        lambda name, task, agent, epsilon: makers[name](task, agent, epsilon),
        lambda name, task: tuple(dict.fromkeys(task.seat_roles)),
        placed,
        attrgetter("seat.role"),
        {},
    )
