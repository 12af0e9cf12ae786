"""The learning player of a small game, and policies that play it by a trained network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pursuit.rules.arrays import Array
from pursuit.validation import check
from scripted_agents.games.simulator import INDEX, GameTask, StateView
from train.networks.arm_policy import ArmSeat
from train.networks.features import Features, features_for
from train.networks.policy import NUMBERS_AT_ONCE, NetworkPolicy, PolicyNetwork, Seat


@dataclass(frozen=True)
class SmallGameSeat:
    """A player of a small game: the `Player` of these games.

    Attributes:
        task: the game.
        agent: the player, by name.
        encoding: its observation.
        network: its network, by the name in the settings.
        min_probability: its policies never play actions of lower probability, unless greedy.
    """

    task: GameTask
    agent: str
    encoding: str = INDEX
    network: str = "auto"
    min_probability: float = 0.0
    continuous: ClassVar[bool] = False
    members: ClassVar[int] = 1
    frame_stack: ClassVar[int] = 1

    @property
    def number(self) -> int:
        """The index of the player."""
        return self.task.seat(self.agent)

    @property
    def role(self) -> str:
        """The player."""
        return self.agent

    @property
    def num_actions(self) -> int:
        """The number of different actions."""
        return self.task.num_actions(self.agent)

    @cached_property
    def legal(self) -> NDArray[np.bool_]:
        """[states, actions] bool: the legal actions."""
        return self.task.legal(self.agent)

    @cached_property
    def has_masks(self) -> bool:
        """Whether an action is not legal in some state."""
        return not self.legal.all()

    def masks(self, view: StateView) -> NDArray[np.bool_] | None:
        """[games, actions]: the legal actions; None where all always are."""
        return self.legal[view.state] if self.has_masks else None

    @cached_property
    def observed(self) -> Array:
        """[states, *shape]: the observation in every state."""
        return self.task.observations(self.agent, self.encoding)

    @cached_property
    def features(self) -> Features:
        """The features of its observation."""
        shape, states = self.observed.shape[1:], self.task.game.num_states
        if self.encoding == INDEX:
            high = np.array([states - 1], dtype=np.int32)
            return features_for(
                Features("index", shape, high, np.arange(states + 1), states), self.network
            )
        largest = np.abs(self.observed).max(axis=0)
        kind = "planes" if len(shape) == 3 else "flat"
        return features_for(Features(kind, shape, np.maximum(largest, 1e-6)), self.network)  # type: ignore[arg-type]

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> SmallGamePolicy:
        """A policy with this network."""
        seat: Any = self
        return SmallGamePolicy(network, seat, greedy)


class SmallGamePolicy(NetworkPolicy):
    """A policy that plays a small game with a network; a `StatePolicy`."""

    seat: SmallGameSeat  # type: ignore[assignment]
    task: GameTask  # type: ignore[assignment]

    def act(self, view: StateView) -> NDArray[np.int32]:  # type: ignore[override]
        """[num_games] int32: actions; draws use the random stream of the view."""
        draws = None if self.greedy else view.uniform()
        seen = view.observe(self.encoding)
        return self.choose(view, seen, draws, self.seat.masks(view))  # type: ignore[arg-type]

    def _check(self, view: StateView, observations: Array) -> None:  # type: ignore[override]
        check_same_game(self.task, view.task)

    def state_probabilities(self) -> NDArray[np.float64]:
        """[states, actions] float64: the action probabilities in every state."""
        seat, states = self.seat, self.task.game.num_states
        found = np.empty((states, seat.num_actions))
        at_once = max(NUMBERS_AT_ONCE // max(seat.observed[0].size, 64), 1)
        for first in range(0, states, at_once):
            rows = slice(first, first + at_once)
            allowed = seat.legal[rows] if seat.has_masks else None
            found[rows] = self.probabilities(seat.observed[rows], allowed)
        return found

    def table(self, task: GameTask) -> NDArray[np.float64]:
        """The probabilities of all legal actions, as of `SmallGame.table`; ValueError in another
        game."""
        check_same_game(self.task, task)
        return task.flat(self.agent, self.state_probabilities())


def check_same_game(own: GameTask, task: GameTask) -> None:
    """ValueError unless a game has the players, states and legal actions of the training, `own`."""
    mine, theirs = own.game, task.game
    check(
        mine is theirs
        or (mine.players == theirs.players and mine.states == theirs.states
            and mine.actions == theirs.actions),
        f"this policy was trained in game {own.name!r} with {mine.num_states} states, and players, "
        f"states or legal actions of {task.name!r} with {theirs.num_states} differ; use it there",
    )  # fmt: skip


AnySeat = Seat | ArmSeat | SmallGameSeat
"""The learning agent of any task."""
