"""Kernels of `train.networks.planning`: shortest paths in a grid, and their gradients.

Each channel has its own paths. A *known* cell has a non-zero value in some plane; paths contain
known cells only. `ways` [games, channels, places] int8 is the direction of the best path from each
known cell: north, south, east, west, or HERE, where it ends.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import allocating

HERE = 4
CHANNELS = 8
"""Number of path channels: a constant, so that the compiler can vectorise over them."""
NOWHERE = np.float32(-100.0)
"""Value of a direction that leads to an unknown cell."""


@allocating
def plan(
    planes: Any, sources: Any, costs: Any, columns: int, traced: bool, ways: Any, at: Any, out: Any,
    around: Any,
) -> None:  # fmt: skip
    """Value iteration in each game; see `train.networks.planning` for the weights.

    Gauss-Seidel sweeps in alternating directions, until convergence or for at most twice as many
    sweeps as there are known cells.

    Args:
        planes: [games, planes, places] float32; the first has 1 at the agent's cell.
        sources: [planes + 1, channels] float32.
        costs: [planes + 1, 4 * CHANNELS] float32, at least 0.
        columns: of the grid.
        traced: whether `ways` is filled.
        ways: out.
        at: [games], out: the agent's cell.
        out: [games, 5, channels], out: the values of the four directions, and the source of the
            agent's cell.
        around: [games, 9, planes], out: the planes of the cells around it.
    """
    num_planes, places = planes.shape[1], planes.shape[2]
    rows = places // columns
    index = np.empty(places, np.int32)
    place_of = np.empty(places, np.int32)
    neighbors = np.empty((places, 4), np.int32)
    source = np.empty((places, CHANNELS), np.float32)
    value = np.empty((places + 1, CHANNELS), np.float32)
    cost = np.empty((places, 4 * CHANNELS), np.float32)
    stale = np.empty(places, np.bool_)
    best = np.empty(CHANNELS, np.float32)
    for game in range(planes.shape[0]):
        index[:] = -1
        for plane in range(num_planes):
            for place in range(places):
                if planes[game, plane, place] != 0.0:
                    index[place] = 0
        known = 0
        for place in range(places):
            if index[place] == 0:
                index[place], place_of[known] = known, place
                known += 1
        for number in range(known):
            place, stale[number] = place_of[number], True
            row, column = place // columns, place % columns
            neighbors[number, 0] = index[place - columns] if row > 0 else -1
            neighbors[number, 1] = index[place + columns] if row < rows - 1 else -1
            neighbors[number, 2] = index[place + 1] if column < columns - 1 else -1
            neighbors[number, 3] = index[place - 1] if column > 0 else -1
            for channel in range(CHANNELS):
                source[number, channel] = sources[num_planes, channel]
            for entry in range(4 * CHANNELS):
                cost[number, entry] = costs[num_planes, entry]
            for plane in range(num_planes):
                here = planes[game, plane, place]
                if here != 0.0:
                    for channel in range(CHANNELS):
                        source[number, channel] += here * sources[plane, channel]
                    for entry in range(4 * CHANNELS):
                        cost[number, entry] += here * costs[plane, entry]
            for channel in range(CHANNELS):
                value[number, channel] = source[number, channel]
        for sweep in range(2 * known):
            changed = False
            for step in range(known):
                number = step if sweep % 2 == 0 else known - 1 - step
                if not stale[number]:
                    continue
                stale[number] = False
                for channel in range(CHANNELS):
                    best[channel] = value[number, channel]
                for action in range(4):
                    other = neighbors[number, action]
                    if other >= 0:
                        for channel in range(CHANNELS):
                            offer = (
                                value[other, channel] - cost[number, action * CHANNELS + channel]
                            )
                            best[channel] = offer if offer > best[channel] else best[channel]
                gained = np.float32(0.0)
                for channel in range(CHANNELS):
                    gained += best[channel] - value[number, channel]
                    value[number, channel] = best[channel]
                if gained > 0.0:
                    changed = True
                    for action in range(4):
                        if neighbors[number, action] >= 0:
                            stale[neighbors[number, action]] = True
            if not changed:
                break
        if traced:
            for number in range(known):
                for channel in range(CHANNELS):
                    most, way = source[number, channel], HERE
                    for action in range(4):
                        other = neighbors[number, action]
                        if other >= 0:
                            offer = (
                                value[other, channel] - cost[number, action * CHANNELS + channel]
                            )
                            if offer > most:
                                most, way = offer, action
                    ways[game, channel, place_of[number]] = way
        if known == 0:  # for example an agent that has left the game
            place_of[0], source[0] = 0, sources[num_planes]
            neighbors[0] = -1
        own = 0
        while own < places - 1 and planes[game, 0, own] == 0.0:
            own += 1
        number = max(index[own], 0)
        own = place_of[number]
        at[game] = own
        for channel in range(CHANNELS):
            out[game, HERE, channel] = source[number, channel]
            for action in range(4):
                other = neighbors[number, action]
                out[game, action, channel] = NOWHERE
                if other >= 0:
                    out[game, action, channel] = (
                        value[other, channel] - cost[number, action * CHANNELS + channel]
                    )
        for near in range(9):
            row, column = own // columns + near // 3 - 1, own % columns + near % 3 - 1
            inside = 0 <= row < rows and 0 <= column < columns
            for plane in range(num_planes):
                around[game, near, plane] = (
                    planes[game, plane, row * columns + column] if inside else 0.0
                )


@allocating
def trace(
    planes: Any, columns: int, ways: Any, at: Any, out: Any, gradient: Any, of_sources: Any,
    of_costs: Any,
) -> None:  # fmt: skip
    """Add to the gradients of `plan`'s weights, from the gradient of its `out`.

    The gradient of a direction flows along its best path to the source that its value comes from.
    """
    num_planes, places = planes.shape[1], planes.shape[2]
    step_of = np.array([-columns, columns, 1, -1])
    for game in range(planes.shape[0]):
        for channel in range(CHANNELS):
            for first in range(5):
                share = gradient[game, first, channel]
                if share == 0.0 or out[game, first, channel] == NOWHERE:
                    continue
                place, way = at[game], first
                for _ in range(places):
                    if way == HERE:
                        break
                    of_costs[num_planes, way * CHANNELS + channel] -= share
                    for plane in range(num_planes):
                        here = planes[game, plane, place]
                        of_costs[plane, way * CHANNELS + channel] -= share * here
                    place += step_of[way]
                    way = ways[game, channel, place]
                of_sources[num_planes, channel] += share
                for plane in range(num_planes):
                    of_sources[plane, channel] += share * planes[game, plane, place]
