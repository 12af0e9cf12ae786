"""What waits for the next episodes of games on a GPU: rows of settings, and seeds of starts.

Whoever settles it, on the CPU, does not know yet which games will end. So settings are rows, which
games are given by number when they begin anew.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit import next_episode
from pursuit.compiled import compiled
from pursuit.rules import layout
from pursuit.rules.layout import NEXT_EPSILON, NEXT_LAYERS, STARTS_STREAM, UNCHANGED
from pursuit.rules.randomness import mix, next_uniform
from pursuit.task import Task

KEPT = -(2**31)
"""A number of a row that leaves a game's own as it is."""


class Settings:
    """Rows of settings, made as those of games are: by `configure`, which checks them.

    Args:
        task: of the games.
        rows: how many.

    Attributes:
        task: the argument.
        num_games: rows; for whoever takes this for a simulator.
        numbers: [NEXT_LAYERS, rows] int32; KEPT where `configure` said nothing.
        shares: [rows, agents] float64, of random moves; UNCHANGED where it said nothing.
    """

    def __init__(self, task: Task, rows: int) -> None:
        self.task, self.num_games = task, rows
        memory = layout.allocate(rows, task.num_agents, task.num_goals)
        self._coming: layout.NextEpisode = layout.named(layout.next_episode_of, memory)
        self._coming.min_start_distance[:] = task.min_start_distance
        self._told = np.zeros(NEXT_LAYERS, dtype=bool)
        self._numbers = memory.coming
        self.shares: NDArray[np.float64] = memory.reals[:, NEXT_EPSILON].copy()

    def configure(self, games: ArrayLike | None = None, **settings: Any) -> None:
        """As `Simulator.configure`, of rows.

        Raises:
            ValueError: as there.
        """
        rows = next_episode.slots(games, self.num_games)
        given = {**dict.fromkeys(("epsilon", "seat", "goals_around")), **settings}
        next_episode.configure(self.task, self._coming, rows, **given)
        names = layout.NextEpisode._fields
        for name, value in settings.items():
            name = "goals_around_marks" if name == "goals_around" else name
            if value is not None and name not in ("epsilon", "seat"):
                self._told[names.index(name)] = True
        self.shares = self._coming.epsilon.copy()

    @property
    def numbers(self) -> NDArray[np.int32]:
        """See the attributes."""
        found = np.full_like(self._numbers, KEPT)
        found[self._told] = self._numbers[self._told]
        return found

    @property
    def distances(self) -> bool:
        """Whether starts of any row must be some distance apart, or near."""
        coming = self._coming
        return bool((coming.min_start_distance > 1).any() or (coming.max_start_distance >= 0).any())


@compiled
def take_settings(coming: Any, reals: Any, rows: Any, numbers: Any, shares: Any) -> None:
    """Have each game's next episode begin with the row of settings of this number, if it is >= 0.

    rows: [games] int32; numbers and shares as those of `Settings`.
    """
    for game in range(rows.shape[0]):
        row = rows[game]
        if row < 0:
            continue
        for layer in range(NEXT_LAYERS):
            if numbers[layer, row] != KEPT:
                coming[layer, game] = numbers[layer, row]
        for agent in range(shares.shape[1]):
            if shares[row, agent] != UNCHANGED:
                reals[game, NEXT_EPSILON, agent] = shares[row, agent]


@compiled
def take_seeds(streams: Any, seeds: Any) -> None:
    """Make the next start of each game that of its seed ([games] int64), if that is >= 0.

    The streams are those of `rules.randomness.seed_starts`.
    """
    for game in range(seeds.shape[0]):
        if seeds[game] >= 0:
            streams[game, STARTS_STREAM] = mix(mix(np.uint64(seeds[game])) + np.uint64(1))


@compiled
def take_epsilon(epsilon_of: Any, shares: Any) -> None:
    """Set the present share of random moves of every agent: [games, agents] float64."""
    for game in range(shares.shape[0]):
        for agent in range(shares.shape[1]):
            epsilon_of[game, agent] = shares[game, agent]


@compiled
def draw_where(streams: Any, stream: int, wanted: Any, numbers: Any) -> None:
    """Draw one uniform float64 into `numbers` [games] where `wanted`; 0 elsewhere."""
    for game in range(numbers.shape[0]):
        numbers[game] = 0.0
        if wanted[game]:
            numbers[game] = next_uniform(streams[game], stream)
