"""The kernels of the encodings: whoever and whatever is not in view is absent.

`table` and `begin` are the sight of the task (`pursuit.rules.sight`), both None where it is full.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled
from pursuit.rules.layout import Games
from pursuit.rules.sight import (
    COLLECTED_PLANE,
    GOAL,
    GOALS_PLANE,
    IN_VIEW_PLANE,
    MAZE_PLANES,
    SELF,
    UNSEEN,
    code_of,
    goal_in_view,
    goal_rank,
    has_collected,
    in_view,
    view_of,
)


@compiled
def encode_index(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    size: int,
    out: Any,
) -> None:
    """Fill `out` [games, seats, entities + 1] with the places of the ones of "one_hot"."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    last = num_agents + num_goals
    padding = (last + 1) * size
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            own = np.uintp(order[seat, 0])  # unsigned: faster
            view = view_of(begin, games, game, own)
            at = games.position[game, own]
            out[game, seat, 0] = at if games.active[game, own] else padding
            for entity in range(1, num_agents):  # oneself, who is always in view, is done
                agent = np.uintp(order[seat, entity])
                cell = games.position[game, agent]
                shown = (games.active[game, agent] != 0) & in_view(table, view, cell)
                out[game, seat, entity] = entity * size + cell if shown else padding
            for number in range(num_goals):
                cell = goal_in_view(games, table, view, game, number)
                entity = num_agents + goal_rank(games, table, view, game, number)
                out[game, seat, entity] = entity * size + cell if cell >= 0 else padding
            place = last * size + at
            out[game, seat, last] = place if has_collected(games, game, own) else padding


@compiled
def encode_one_hot(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    size: int,
    out: Any,
) -> None:
    """Fill `out` [games, seats, (entities + 1) * size] with a row for each entity."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    out[:] = 0.0
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            own = order[seat, 0]
            view = view_of(begin, games, game, own)
            for entity in range(num_agents):
                agent = order[seat, entity]
                cell = games.position[game, agent]
                if games.active[game, agent] and in_view(table, view, cell):
                    out[game, seat, entity * size + cell] = 1.0
            for number in range(num_goals):
                cell = goal_in_view(games, table, view, game, number)
                if cell >= 0:
                    entity = num_agents + goal_rank(games, table, view, game, number)
                    out[game, seat, entity * size + cell] = 1.0
            if has_collected(games, game, own):
                last = num_agents + num_goals
                out[game, seat, last * size + games.position[game, own]] = 1.0


@compiled
def encode_positions(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    out: Any,
) -> None:
    """Fill `out` [games, seats, entities + 1] with 1 + cell, 0 for gone, and just collected."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        for seat in range(out.shape[1]):
            own = order[seat, 0]
            view = view_of(begin, games, game, own)
            for entity in range(num_agents):
                agent = order[seat, entity]
                cell = games.position[game, agent]
                shown = games.active[game, agent] and in_view(table, view, cell)
                out[game, seat, entity] = cell + 1 if shown else 0
            for number in range(num_goals):
                entity = num_agents + goal_rank(games, table, view, game, number)
                out[game, seat, entity] = goal_in_view(games, table, view, game, number) + 1
            out[game, seat, num_agents + num_goals] = has_collected(games, game, own)


@compiled
def encode_grid(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    team_size: Any,
    places: Any,
    out: Any,
) -> None:
    """Draw the entities into `out` [games, seats, flattened grid], already holding the maze."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        where = places[games.maze[game]]
        for seat in range(out.shape[1]):
            view = view_of(begin, games, game, order[seat, 0])
            for number in range(num_goals):
                cell = goal_in_view(games, table, view, game, number)
                if cell >= 0:
                    out[game, seat, where[cell]] = GOAL
            # From the least important to oneself, so that who matters more is drawn over.
            team = team_size[seat]
            for turn in range(num_agents):
                entity = team - 1 - turn if turn < team - 1 else turn + 1
                if turn == num_agents - 1:
                    entity = 0
                agent = order[seat, entity]
                cell = games.position[game, agent]
                if games.active[game, agent] and in_view(table, view, cell):
                    out[game, seat, where[cell]] = code_of(entity, team)


@compiled
def encode_planes(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    team_size: Any,
    places: Any,
    out: Any,
) -> None:
    """Mark the entities in `out` [games, seats, planes, flattened plane], already with the maze."""
    games = Games(position, active, event, goal, steps, maze)
    num_agents, num_goals = position.shape[1], goal.shape[1]
    for game in range(out.shape[0]):
        where = places[games.maze[game]]
        for seat in range(out.shape[1]):
            own = order[seat, 0]
            view = view_of(begin, games, game, own)
            for number in range(num_goals):
                cell = goal_in_view(games, table, view, game, number)
                if cell >= 0:
                    out[game, seat, GOALS_PLANE, where[cell]] = 1.0
            for entity in range(num_agents):
                agent = order[seat, entity]
                cell = games.position[game, agent]
                if games.active[game, agent] and in_view(table, view, cell):
                    out[game, seat, code_of(entity, team_size[seat]) - SELF, where[cell]] = 1.0
            if has_collected(games, game, own):
                out[game, seat, COLLECTED_PLANE, where[games.position[game, own]]] = 1.0


@compiled
def hide_grid(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    hidden_maze: Any,
    places: Any,
    background: Any,
    reach: int,
    columns: int,
    out: Any,
) -> None:
    """Leave in `out` [games, seats, flattened grid] of the maze only what is within view.

    `background` is [mazes, flattened grid], `columns` the width of a row of it, and `reach` 1 where
    walls lie beside cells, which are seen with them.
    """
    games = Games(position, active, event, goal, steps, maze)
    for game in range(out.shape[0]):
        number = games.maze[game]
        for seat in range(out.shape[1]):
            own = order[seat, 0]
            if not hidden_maze[own]:
                continue
            view = view_of(begin, games, game, own)
            for place in range(out.shape[2]):
                out[game, seat, place] = UNSEEN
            for cell in range(begin[begin.shape[0] - 1, number]):
                if in_view(table, view, cell):
                    for down in range(-reach, reach + 1):
                        for right in range(-reach, reach + 1):
                            place = places[number, cell] + down * columns + right
                            out[game, seat, place] = background[number, place]


@compiled
def mark_view(
    position: Any,
    active: Any,
    event: Any,
    goal: Any,
    steps: Any,
    maze: Any,
    table: Any,
    begin: Any,
    order: Any,
    hidden_maze: Any,
    places: Any,
    out: Any,
) -> None:
    """Mark what is within view in `out` [games, seats, planes, flattened plane]; hide the rest.

    Only of those who know no more of the maze is the rest hidden.
    """
    games = Games(position, active, event, goal, steps, maze)
    for game in range(out.shape[0]):
        number = games.maze[game]
        for seat in range(out.shape[1]):
            own = order[seat, 0]
            view = view_of(begin, games, game, own)
            for cell in range(begin[begin.shape[0] - 1, number]):
                place = places[number, cell]
                if in_view(table, view, cell):
                    out[game, seat, IN_VIEW_PLANE, place] = 1.0
                elif hidden_maze[own]:
                    for plane in range(MAZE_PLANES, IN_VIEW_PLANE):
                        out[game, seat, plane, place] = 0.0
