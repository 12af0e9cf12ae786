"""Policies of players of enumerated games: tables, and the named ones."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check, check_probability, unknown
from scripted_agents.games import tables
from scripted_agents.games.encoding import mended
from scripted_agents.games.simulator import GameTask, StateView
from scripted_agents.games.small_game import KEPT, Behaviour, SmallGame, longest_play
from scripted_agents.games.solve import SmallEquilibrium, check_zero_sum, equilibrium
from scripted_agents.names import (
    EQUILIBRIUM,
    GAME_AGENTS,
    GAME_DISCOUNT,
    POLICIES,
    UNIFORM,
    is_custom_policy,
)


class TableAgent:
    """A policy by a table of probabilities, played by one player of one game.

    Args:
        task: the game.
        player: by name.
        policy: as of `SmallGame.table`: a function of a state, or a flat array.
        epsilon: the probability of a uniformly random legal action.
        name: in tables and results.

    Raises:
        ValueError: an unknown player, no distribution, or epsilon outside [0, 1].
    """

    def __init__(
        self,
        task: GameTask,
        player: str,
        policy: Behaviour,
        epsilon: float = 0.0,
        name: str = "table",
    ) -> None:
        self.task, self.agent, self.name = task, player, name
        self.epsilon = check_probability("epsilon", epsilon)
        game, self._seat = task.game, task.seat(player)
        self._own = game.table(player, policy)
        self._offsets = game.offsets(self._seat)
        self._sums = tables.row_sums(self._own, self._offsets)
        numbers = np.arange(task.num_actions(player), dtype=np.float64)
        every = np.broadcast_to(numbers, (game.num_states, len(numbers)))
        self._numbers = task.flat(player, every).astype(np.int32)

    def __repr__(self) -> str:
        return self.name + (f"(epsilon={self.epsilon:g})" if self.epsilon else "")

    def act(self, view: StateView) -> NDArray[np.int32]:
        """[num_games] int32, drawn with the player's random numbers; ValueError in other games."""
        check(
            view.task.game is self.task.game and view.seat == self._seat,
            f"{self!r} is a policy of {self.agent} in game {self.task.name!r}; use it there",
        )
        actions = np.empty(view.num_games, dtype=np.int32)
        tables.draw_actions(
            self._offsets, self._sums, self._numbers, view.state, view.epsilon, self.epsilon,
            view.streams, self._seat, actions,
        )  # fmt: skip
        return actions

    def table(self, task: GameTask) -> NDArray[np.float64]:
        """The probabilities of all legal actions, as of `SmallGame.table`, random ones included."""
        uniform = uniform_table(task.game, self.agent)
        return (1.0 - self.epsilon) * self._own + self.epsilon * uniform


def uniform_table(game: SmallGame, player: str) -> NDArray[np.float64]:
    """Every legal action with the same probability, as of `SmallGame.table`."""
    sizes = np.diff(game.offsets(game.player(player)))
    return 1.0 / np.repeat(sizes, sizes)


@lru_cache(maxsize=KEPT)
def solved(game: SmallGame) -> SmallEquilibrium:
    """The equilibrium that `equilibrium` agents play, computed once.

    Undiscounted in a game that always ends; otherwise with the discount `GAME_DISCOUNT`.

    Raises:
        ValueError: not a zero-sum game of two players.
    """
    check_zero_sum(game)  # quick
    longest = longest_play(game)
    return equilibrium(game, GAME_DISCOUNT) if longest is None else equilibrium(game, 1.0, longest)


def named_agent(name: str, task: GameTask, player: str, epsilon: float = 0.0) -> TableAgent:
    """The policy of this name for a player.

    Args:
        name: one of `GAME_AGENTS`, or package.module:Name of a function of a state that returns
            probabilities (see `SmallGame.table`).
        task: the game.
        player: by name.
        epsilon: the probability of a uniformly random legal action.

    Raises:
        ValueError: an unknown name, no distribution, or an equilibrium of another kind of game.
    """
    check_probability("opponent_epsilon", epsilon)
    if name == UNIFORM:
        return TableAgent(task, player, uniform_table(task.game, player), 0.0, name)
    if name == EQUILIBRIUM:
        return TableAgent(task, player, solved(task.game).policies[player], epsilon, name)
    check(
        is_custom_policy(name),
        unknown("policy", name, GAME_AGENTS) + ", or package.module:Name of a function of a state",
    )
    behaviour: Behaviour = POLICIES.get(name)  # type: ignore[assignment]
    with mended(f"policy {name!r}"):
        return TableAgent(task, player, behaviour, epsilon, name)
