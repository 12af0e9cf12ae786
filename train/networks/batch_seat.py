"""`BatchSeat`: the learning agents of games of one's own, and policies that play them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.observations.custom import AGENT_ID
from pursuit.rules.arrays import Array
from pursuit.simulator.batch import SeatView
from pursuit.validation import check
from train.networks.features import Features, features_between
from train.networks.policy import PolicyNetwork, logits_of
from train.networks.recurrent_policy import chosen_from, probabilities_of
from train.networks.seat import Seat
from train.settings.algorithms import STATE


@dataclass(frozen=True)
class BatchSeat(Seat):
    """An agent with discrete actions in any kind of game, or all agents of a role as a team.

    Subclasses implement `num_actions`, `limits` and `seen`; where actions can be illegal also
    `has_masks` and `allowed`, and where agents leave a game that goes on `left`.

    Attributes:
        task: the game.
        agent: name or role.
        encoding: its observation; with the suffix +id its number within the role is added.
        network: its network, by the name in the settings.
        min_probability: its policies never play actions of lower probability, unless greedy.
        team: as of `Seat`.
    """

    task: Any
    agent: str
    encoding: str = "observe"
    network: str = "auto"
    min_probability: float = 0.0
    team: bool = False
    joint: bool = False
    critic: str = ""
    NO_MEMORY: ClassVar[str] = "a game of this kind, whose policies have no memory"
    NO_TEAM: ClassVar[bool] = False
    NO_JOINT: ClassVar[str] = "games of this kind"

    def __post_init__(self) -> None:
        check(
            self.critic in ("", STATE),
            f"critic_observation={self.critic!r} in game {self.task.name!r}; use {STATE}, which is "
            "what all agents observe",
        )

    @property
    @abstractmethod
    def limits(self) -> tuple[Array, Array]:
        """The least and the largest observation [*shape]."""

    @abstractmethod
    def seen(self, batch: Any, agents: slice) -> Array:
        """[games, agents, *shape] what these agents observe; a new array."""

    @property
    def shows_id(self) -> bool:
        """Whether observations end with the number of the agent within its role."""
        return self.encoding.endswith(AGENT_ID)

    def bounds(self, batch: Any = None) -> tuple[Array, Array]:
        """As of `Seat`."""
        low, high = self.limits
        if not self.shows_id:
            return low, high
        more = np.zeros(self.team_size, dtype=low.dtype)
        return np.concatenate([low, more]), np.concatenate([high, more + 1])

    def observe(self, batch: Any, agents: slice) -> Array:
        """As of `Seat`."""
        seen = self.seen(batch, agents)
        if not self.shows_id:
            return seen
        numbers = np.arange(batch.task.num_agents)[agents] - self.task.seat(self.role)
        shown = np.eye(self.team_size, dtype=seen.dtype)[numbers]
        return np.concatenate([seen, np.broadcast_to(shown, (len(seen), *shown.shape))], axis=2)

    @cached_property
    def features(self) -> Features:
        """The features of its observation."""
        return features_between(*self.bounds(), self.network)

    @cached_property
    def critic_features(self) -> Features | None:
        """As of `Seat`."""
        return features_between(*self.critic_bounds(), "auto") if self.critic else None

    def critic_bounds(self, batch: Any = None) -> tuple[Array, Array]:
        """As of `Seat`: those of all agents, then of the number within the role."""
        more = np.zeros(self.team_size), np.ones(self.team_size)
        low, high = (np.tile(end.ravel(), self.task.num_agents) for end in self.limits)
        ends = (np.concatenate(both) for both in zip((low, high), more, strict=True))
        return tuple(end.astype(np.float32) for end in ends)  # type: ignore[return-value]

    def critic_observations(self, batch: Any) -> Array:
        """As of `Seat`: what all agents observe, and the number of the agent within its role."""
        seen = self.seen(batch, slice(0, self.task.num_agents))
        every, members = seen.reshape(len(seen), 1, -1), self.members
        numbers = np.broadcast_to(np.eye(members), (len(seen), members, members))
        found = np.concatenate([every.repeat(members, axis=1), numbers], axis=2)
        return found.astype(np.float32)

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> BatchPolicy:
        """A policy with this network."""
        return BatchPolicy(network, self, greedy)


class BatchPolicy:
    """A policy that plays a game of any kind by a network, for every agent of its role.

    Args:
        network: gives the logits.
        seat: the one that it was trained in.
        greedy: the most probable action; False draws from the distribution.
    """

    def __init__(self, network: PolicyNetwork, seat: BatchSeat, greedy: bool = True) -> None:
        self.network, self.seat, self.greedy = network, seat, greedy
        self.task, self.agent = seat.task, seat.agent

    def act(self, view: SeatView) -> NDArray[np.int32]:
        """[num_games] int32: actions; draws use the random stream of the view.

        Raises:
            ValueError: a game of other agents or observations than in training.
        """
        draws = None if self.greedy else view.uniform()
        return chosen_from(self.probabilities(view), draws)

    def probabilities(self, view: SeatView) -> NDArray[np.float64]:
        """[num_games, actions] float64: the action probabilities; ValueError as `act`."""
        own = slice(view.seat, view.seat + 1)
        observed = view.of(lambda batch: self.seat.observe(batch, own)[:, 0])
        check(
            view.task.agent_names == self.task.agent_names
            and observed.shape[1:] == self.seat.features.shape,
            f"this policy was trained in game {self.task.name!r}, not in {view.task.name!r}; use "
            "it there",
        )
        logits, allowed = logits_of(self.network, observed), None
        if self.seat.has_masks:
            allowed = view.of(lambda batch: self.seat.allowed(batch, own)[:, 0])
        return probabilities_of(logits, allowed, self.greedy, self.seat.min_probability)
