"""`BatchSeat`: the learning agents of games of one's own, and policies that play them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from pursuit.simulator.batch import Batch, SeatView
from pursuit.validation import check
from train.networks.features import Features, features_for
from train.networks.layers import float32_inference
from train.networks.policy import PolicyNetwork
from train.networks.recurrent_policy import chosen_from, probabilities_of
from train.networks.seat import Seat


@dataclass(frozen=True)
class BatchSeat(Seat):
    """An agent with discrete actions in any kind of game, or all agents of a role as a team.

    Subclasses implement `num_actions`, `bounds` and `observe`; where actions can be illegal also
    `has_masks` and `allowed`, and where agents leave a game that goes on `left`.

    Attributes:
        task: the game. `task.seat_roles`, the role of every agent, allows teams.
        agent: name or role.
        encoding: its observation.
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

    @property
    def role(self) -> str:
        """The role of the agent; where agents have none its name."""
        roles = getattr(self.task, "seat_roles", self.task.agent_names)
        return str(roles[self.number])

    @property
    def team_size(self) -> int:
        """As of `Seat`."""
        return tuple(getattr(self.task, "seat_roles", self.task.agent_names)).count(self.role)

    @abstractmethod
    def bounds(self, batch: Any) -> tuple[Array, Array]:
        """As of `Seat`; they do not depend on the games, and `batch` can be None."""

    @cached_property
    def features(self) -> Features:
        """The features of its observation."""
        low, high = self.bounds(None)
        largest = np.maximum(np.maximum(np.abs(low), np.abs(high)).astype(np.float64), 1e-6)
        kind: Any = "planes" if low.ndim == 3 else "flat"
        return features_for(Features(kind, low.shape, largest), self.network)

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
            ValueError: another game than that of the training.
        """
        own = slice(view.seat, view.seat + 1)

        def seen(batch: Batch[Any]) -> Array:
            return self.seat.observe(batch, own)[:, 0]

        def legal(batch: Batch[Any]) -> Array:
            return self.seat.allowed(batch, own)[:, 0]

        observed = view.of(seen)
        check(
            view.task.agent_names == self.task.agent_names
            and observed.shape[1:] == self.seat.features.shape,
            f"this policy was trained in game {self.task.name!r}, not in {view.task.name!r}; use "
            "it there",
        )
        device = next(self.network.parameters()).device
        with float32_inference(self.network):
            logits = self.network.logits(torch.from_numpy(observed).to(device))
        allowed = view.of(legal) if self.seat.has_masks else None
        found = probabilities_of(logits, allowed, self.greedy, self.seat.min_probability)
        return chosen_from(found, None if self.greedy else view.uniform())
