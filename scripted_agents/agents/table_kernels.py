"""Compiled sampling of actions from policy tables, for one agent and for teams."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled
from pursuit.rules.layout import NUM_CELLS, Games, World, stay_of, stream_of, team_stream
from pursuit.rules.randomness import draw_action, mix, next_uniform
from pursuit.rules.turn import legal_moves


@compiled
def sample_table(
    games: Games, streams: Any, epsilon_of: Any, seat: int, opponents: Any, world: World,
    cumulative: Any, table_offsets: Any, default: float, actions: Any,
) -> None:  # fmt: skip
    """Fill `actions` [games] from a policy table, given as cumulative sums over the actions.

    The other cell is that of the first active opponent. `cumulative` is [all pairs, actions]; the
    pairs of maze m start at `table_offsets[m]`.
    """
    stream = stream_of(seat)
    num_actions = cumulative.shape[1]
    empty = stay_of(world.neighbors) if num_actions > stay_of(world.neighbors) else 0
    for game in range(actions.shape[0]):
        actions[game] = 0
        maze, own = np.int64(games.maze[game]), np.int64(games.position[game, seat])
        other = np.int64(-1)
        for i in range(opponents.shape[0]):
            if other < 0 and games.active[game, opponents[i]]:
                other = np.int64(games.position[game, opponents[i]])
        if other < 0 or not games.active[game, seat]:
            continue
        epsilon = epsilon_of[game, seat]
        if np.isnan(epsilon):
            epsilon = default
        if epsilon > 0.0 and next_uniform(streams[game], stream) < epsilon:
            every = legal_moves(world, maze, own)
            actions[game] = draw_action(every, every, 0.0, empty, False, streams[game], stream)
            continue
        pair = table_offsets[maze] + own * world.mazes[NUM_CELLS, maze] + other
        draw = next_uniform(streams[game], stream) * cumulative[pair, num_actions - 1]
        while actions[game] < num_actions - 1 and draw >= cumulative[pair, actions[game]]:
            actions[game] += 1


@compiled
def draw_together(streams: Any, num_agents: int, steps: Any, first: int, numbers: Any) -> None:
    """Fill `numbers` [games] with uniform float64 in [0, 1), the same for all calls of a team in a
    step, and independent of those of other teams.

    They are a function of the step, of the first seat of the team, and of the stream of teams,
    which advances with every episode; the call advances no stream.
    """
    for game in range(numbers.shape[0]):
        step = np.uint64(steps[game] + 1) ^ np.uint64(first) << np.uint64(32)
        word = mix(streams[game, team_stream(num_agents)]) ^ mix(step)
        numbers[game] = np.float64(mix(word) >> np.uint64(11)) * (1.0 / 9007199254740992.0)
