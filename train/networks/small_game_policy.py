"""The learning player of a small game, and policies that play it by a trained network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from pursuit.rules import Games
from pursuit.rules.arrays import Array
from pursuit.rules.layout import empty_games
from pursuit.validation import Plain, check, text_of
from scripted_agents.games.simulator import INDEX, GameSimulator, GameTask, StateView
from scripted_agents.games.small_game import longest_play
from train.networks.features import Features, features_between, features_for
from train.networks.numbering import SeatNumbering
from train.networks.policy import NUMBERS_AT_ONCE, NetworkPolicy, PolicyNetwork
from train.networks.seat import Seat


@dataclass(frozen=True)
class SmallGameSeat(Seat):
    """A player of a small game.

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
    NO_NUMBERS: ClassVar[str] = ""
    NO_MEMORY: ClassVar[str] = "a small game, whose exact results need policies without memory"

    @property
    def num_actions(self) -> int:
        """The number of different actions."""
        return self.task.num_actions(self.agent)

    @property
    def described(self) -> Plain:
        """As of `Seat`."""
        task, game = self.task, self.task.game
        named = {"game": task.name, "max_steps": task.max_steps}
        return {**named, "players": game.players, "states": game.num_states}

    @property
    def action_names(self) -> list[str]:
        """As of `Seat`."""
        return [text_of(action) for action in self.task.game.action_lists[self.number]]

    @cached_property
    def legal(self) -> NDArray[np.bool_]:
        """[states, actions] bool: the legal actions."""
        return self.task.legal(self.agent)

    @cached_property
    def has_masks(self) -> bool:
        """Whether an action is not legal in some state."""
        return not self.legal.all()

    def allowed(self, batch: GameSimulator, agents: slice) -> NDArray[np.bool_]:
        """As of `Seat`."""
        return self.legal[batch.state][:, None]

    def bounds(self, batch: GameSimulator) -> tuple[Array, Array]:
        """As of `Seat`."""
        return self.observed.min(axis=0), self.observed.max(axis=0)

    def observe(self, batch: GameSimulator, agents: slice) -> Array:
        """As of `Seat`."""
        return self.observed[batch.state][:, None]

    def probabilities_of(
        self, policy: Any, batch: GameSimulator, agents: slice
    ) -> NDArray[np.float64]:
        """As of `Seat`, from the table of the policy."""
        return self.task.rows(self.agent, policy.table(self.task), batch.state)[:, None]

    @cached_property
    def numbering(self) -> SeatNumbering:
        """As of `Seat`: those of the game."""
        return GameNumbers(self)

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
        low, high = self.observed.min(axis=0), self.observed.max(axis=0)
        if self.encoding != INDEX:
            return features_between(low, high, self.network)
        states = self.task.game.num_states
        seen = Features("index", high.shape, high, np.arange(states + 1), states)
        return features_for(seen, self.network)

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> SmallGamePolicy:
        """A policy with this network."""
        return SmallGamePolicy(network, self, greedy)  # type: ignore[arg-type]


class SmallGamePolicy(NetworkPolicy):
    """A policy that plays a small game with a network; a `StatePolicy`."""

    seat: SmallGameSeat  # type: ignore[assignment]
    task: GameTask  # type: ignore[assignment]

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

    def table_rows(self, task: GameTask) -> int:
        """As of `LearnedPolicy`: the states of the game."""
        return task.game.num_states

    def state_table(self, task: GameTask) -> NDArray[np.float64]:
        """As of `LearnedPolicy`."""
        return self.state_probabilities()

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


class GameNumbers(SeatNumbering):
    """The states of a small game, as those of a game whose learner is in the cell of this number.

    Args:
        seat: the learner.
    """

    def __init__(self, seat: SmallGameSeat) -> None:
        task = seat.task
        self.seat, self.allowed = seat, seat.legal
        self.count, self.goal_sets = task.game.num_states, [1]
        # Cells that make the base of all digits 1, so that a state is their sum.
        self.for_kernels = (1 if task.num_agents < 3 else 0, np.ones((3, 1), dtype=np.int64))
        self._games = empty_games(0, task.num_agents, 0)

    def games(self, batch: GameSimulator) -> Games:
        """As of `SeatNumbering`."""
        if len(self._games.steps) != batch.num_games:
            self._games = empty_games(batch.num_games, batch.task.num_agents, 0)
            self._games.active[:] = 1
        self._games.position[:, self.seat.number] = batch.state
        return self._games

    def policy(self, q_values: NDArray[np.float64]) -> SmallGameTable:
        """As of `SeatNumbering`."""
        return SmallGameTable(self.seat, q_values)

    def of_index(self, observation: Tensor) -> Tensor:
        """As of `SeatNumbering`."""
        return observation[:, 0].long()

    def check(self, discount: float) -> None:
        """As of `SeatNumbering`."""
        game = self.seat.task.game
        if discount >= 1.0 and game.rewards[:, self.seat.number].max() > 0.0:
            check(
                longest_play(game) is not None,
                f"gamma={discount} in {self.seat.task.name!r}, which can go on forever, makes "
                "values unbounded; use a lower gamma, such as 0.95",
            )


class SmallGameTable:
    """The greedy policy of a table of action values in a small game; it follows changes of them.

    Args:
        seat: the player.
        q_values: [states, actions] float64.
    """

    def __init__(self, seat: SmallGameSeat, q_values: NDArray[np.float64]) -> None:
        self.seat, self.q_values = seat, q_values
        self.task, self.agent = seat.task, seat.agent

    def _best(self, states: Any) -> NDArray[np.int64]:
        """[states] the legal action with the largest value, the lowest of equal ones."""
        return np.where(self.seat.legal[states], self.q_values[states], -np.inf).argmax(axis=1)

    def act(self, view: StateView) -> NDArray[np.int32]:
        """[num_games] int32: the best actions; ValueError in another game."""
        check_same_game(self.task, view.task)
        return self._best(view.state).astype(np.int32)

    def table(self, task: GameTask) -> NDArray[np.float64]:
        """As of `SmallGame.table`: 1 for the greedy action; ValueError in another game."""
        check_same_game(self.task, task)
        return task.flat(self.agent, np.eye(self.seat.num_actions)[self._best(slice(None))])
