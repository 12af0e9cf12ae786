"""Start placements of agents and goals.

Placements of all exits and agents are drawn until one satisfies the limits, so that starts are
uniform over all valid placements. Then the goals are placed one by one. `pursuit.tasks.placements`
rejects limits that are satisfied too rarely.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined, subroutine
from pursuit.rules.arrays import Words
from pursuit.rules.distances import (
    distance_within,
    forget,
    has_table,
    search_within,
    table_distance,
)
from pursuit.rules.layout import (
    STARTS_STREAM,
    UNPLACED,
    Games,
    NextEpisode,
    Search,
    StepRules,
    World,
    agents_of,
    chasers_of,
    evaders_of,
    goals_of,
    team_stream,
)
from pursuit.rules.randomness import next_below, next_word


class Start(NamedTuple):
    """One game of a batch at the start of an episode; `streams` are those of the game."""

    games: Games
    game: int
    streams: Words
    pending: NextEpisode
    rules: StepRules
    world: World
    search: Search


@inlined
def start(own: Start) -> None:
    """Start an episode: choose the maze, place agents and goals."""
    games, game, teams = own.games, own.game, own.rules.teams
    next_word(own.streams, team_stream(teams.chasers + teams.evaders + teams.runners))
    games.maze[game] = choose_maze(own.pending.maze[game], own.streams, own.world)
    games.steps[game] = 0
    for agent in agents_of(teams):
        games.active[game, agent] = 1
        games.event[game, agent] = 0
    place_agents(own)
    while not starts_apart(own) or starts_on_exit(own):
        place_agents(own)
    if teams.goals > 0:
        place_goals(own)


@inlined
def choose_maze(asked: int, streams: Words, world: World) -> int:
    """The maze `asked`, or a random one if it is -1."""
    if asked >= 0:
        return np.int64(asked)
    count = world.num_cells.shape[0]
    return next_below(streams, STARTS_STREAM, count) if count > 1 else 0


@inlined
def goals_wanted(start: Start) -> int:
    """The number of goals at the start of the episode."""
    wanted = start.rules.teams.goals
    if start.pending.num_goals[start.game] >= 0:
        wanted = min(wanted, np.int64(start.pending.num_goals[start.game]))
    return wanted


@inlined
def is_taken(start: Start, agents: range, cell: int, num_goals: int, num_exits: int) -> bool:
    """Whether one of these agents, or of the first goals or exits, is on `cell`."""
    for agent in agents:
        if start.games.position[start.game, agent] == cell:
            return True
    for goal in range(num_goals):
        if start.games.goal[start.game, goal] == cell:
            return True
    return is_exit(start.games, start.game, cell, num_exits)


@inlined
def is_exit(games: Games, game: int, cell: int, num_exits: int) -> bool:
    """Whether one of the first exits is on `cell`."""
    for number in range(num_exits):
        if games.exit[game, number] == cell:
            return True
    return False


@inlined
def draw_free_cell(start: Start, agents: range, num_goals: int, num_exits: int) -> int:
    """A uniformly random cell without one of these agents and of the first goals and exits."""
    size = start.world.num_cells[start.games.maze[start.game]]
    cell = next_below(start.streams, STARTS_STREAM, size)
    while is_taken(start, agents, cell, num_goals, num_exits):
        cell = next_below(start.streams, STARTS_STREAM, size)
    return cell


@inlined
def place_exits(start: Start, num_goals: int) -> None:
    """Place the exits of the maze, or draw different cells without an evader or a marked goal."""
    count, fixed = start.rules.options.exits, start.rules.fixed_exits
    for number in range(count):
        if fixed.shape[0] > 0:
            cell = fixed[start.games.maze[start.game] * count + number]
        else:
            cell = draw_free_cell(start, evaders_of(start.rules.teams), num_goals, number)
        start.games.exit[start.game, number] = cell


@inlined
def starts_on_exit(start: Start) -> bool:
    """Whether an evader is on an exit."""
    for evader in evaders_of(start.rules.teams):
        cell = start.games.position[start.game, evader]
        if is_exit(start.games, start.game, cell, start.rules.options.exits):
            return True
    return False


@inlined
def place_goals_on_marks(start: Start) -> int:
    """Place goals on the marks of the maze; return how many."""
    if not start.rules.start_at_marks:
        return 0
    maze = start.games.maze[start.game]
    count = min(goals_wanted(start), start.world.num_goal_marks[maze])
    for goal in range(count):
        start.games.goal[start.game, goal] = start.world.goal_marks[goal, maze]
    return count


@inlined
def place_agents(start: Start) -> None:
    """Place every agent on its mark, or on a uniformly random free cell without a marked goal; then
    the exits."""
    teams, world, position = start.rules.teams, start.world, start.games.position
    game, maze = start.game, start.games.maze[start.game]
    for agent in agents_of(teams):
        position[game, agent] = UNPLACED
    marked_goals = place_goals_on_marks(start)
    if start.rules.start_at_marks:
        if world.start_mark[maze] >= 0:
            position[game, 0] = world.start_mark[maze]
        if teams.goals == 0:
            mark = 0
            for evader in evaders_of(teams):
                if mark < world.num_goal_marks[maze]:
                    position[game, evader] = world.goal_marks[mark, maze]
                    mark += 1
    for agent in agents_of(teams):
        if position[game, agent] < 0:
            position[game, agent] = draw_free_cell(start, agents_of(teams), marked_goals, 0)
    place_exits(start, marked_goals)


@inlined
def starts_apart(start: Start) -> bool:
    """Whether the distances between chasers and evaders are within the limits."""
    pending, game, world = start.pending, start.game, start.world
    least, most = pending.min_start_distance[game], pending.max_start_distance[game]
    if least <= 1 and most < 0:
        return True
    limit, maze, cells = max(least, most), start.games.maze[game], start.games.position[game]
    for chaser in chasers_of(start.rules.teams):
        for evader in evaders_of(start.rules.teams):
            chased = cells[evader]
            distance = distance_within(world, start.search, maze, cells[chaser], chased, limit)
            if distance < least or (most >= 0 and distance > most):
                return False
    return True


@subroutine
def place_goals(start: Start) -> None:
    """Place the goals on the marks, or on random free cells within the goal radius.

    The radius is the path distance from the first runner (without runners, the first evader), or
    from the nearest goal mark of the maze. If there are too few free cells, it is increased by one
    until a goal fits.
    """
    goals, game, exits = start.games.goal, start.game, start.rules.options.exits
    for goal in goals_of(start.rules.teams):
        goals[game, goal] = -1
    placed = place_goals_on_marks(start)
    radius = np.int64(start.pending.goal_radius[game])
    while placed < goals_wanted(start):
        if radius < 0:
            cell = draw_free_cell(start, agents_of(start.rules.teams), placed, exits)
        else:
            count = list_free_cells(start, placed, radius)
            while count == 0:
                radius += 1
                count = list_free_cells(start, placed, radius)
            cell = np.int64(start.search.queue[next_below(start.streams, STARTS_STREAM, count)])
        goals[game, placed] = cell
        placed += 1


@subroutine
def list_free_cells(start: Start, num_goals: int, radius: int) -> int:
    """Fill `search.queue` with the free cells within the radius; return how many.

    Only the first `num_goals` goals have been placed.
    """
    world, search, maze = start.world, start.search, start.games.maze[start.game]
    around_marks = start.pending.goals_around_marks[start.game] > 0
    first, size = world.first_cell[maze], world.num_cells[maze]
    teams = start.rules.teams  # the centre is the first runner or, without runners, first evader
    collector = teams.chasers + teams.evaders if teams.runners > 0 else teams.chasers
    center = np.int64(start.games.position[start.game, collector])
    if not around_marks and not has_table(world, maze):
        size = search_within(world, maze, center, radius, -1, search)
        forget(search, size)
    count = 0
    for i in range(size):
        if around_marks:
            cell, away = i, np.int64(world.mark_distance[first + i])
        elif has_table(world, maze):
            cell, away = i, table_distance(world, maze, center, i)
        else:
            cell, away = np.int64(search.queue[i]), radius
        exits, agents = start.rules.options.exits, agents_of(teams)
        if away <= radius and not is_taken(start, agents, cell, num_goals, exits):
            search.queue[count] = cell
            count += 1
    return count
