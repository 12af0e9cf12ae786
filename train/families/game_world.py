"""`GameWorld`: games of agents that are measured in returns, the base for kinds of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from pursuit.validation import Missing
from train.families.family import World
from train.families.policies import NamedPolicies, policy_named
from train.networks.seat import Seat
from train.teaching.context import SmallGameContext
from train.teaching.teacher import EpisodeMetrics


@dataclass(frozen=True)
class GameWorld(World):
    """A game of agents with policies by name, in returns; the base for kinds of one's own.

    Attributes:
        POLICIES: by name.
        solver: gives exact returns and best responses; or why there is none.
    """

    POLICIES: ClassVar[NamedPolicies]
    solver: ClassVar[Any] = Missing("no exact solution of this game is known")

    @cached_property
    def opponents(self) -> dict[str, Any]:
        """As of `World`, by agent."""
        given = self.settings
        how = (given.opponent_epsilon, given.opponent_policy)
        return {
            name: policy_named(self.POLICIES, self.saved, given.opponent, self.task, name, *how)
            for name in self.task.agent_names
            if name != self.agent
        }

    @property
    def policy_names(self) -> tuple[str, ...]:
        """The names of built-in policies."""
        return self.POLICIES.names

    def named(self, name: str, agent: str) -> Any:
        """The policy of this name for an agent; as of `policy_named`."""
        return policy_named(self.POLICIES, self.saved, name, self.task, agent)

    @property
    def context(self) -> Any:
        """As of `World`."""
        return SmallGameContext(self.task, self.agent, self.opponents, 0.0)

    def policies(self, seat: Seat) -> list[Any]:
        """As of `World`."""
        own = range(seat.number, seat.number + (seat.team_size if seat.team else 1))
        names = enumerate(self.task.agent_names)
        return [None if number in own else self.opponents.get(name) for number, name in names]

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `World`."""
        number = seat.number
        return EpisodeMetrics(
            lambda games: games.returns[:, number] > games.returns.mean(axis=1),
            lambda games: games.returns[:, number],
        )
