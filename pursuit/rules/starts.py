"""Start placements of agents and goals.

Placements of all agents are drawn until one satisfies the limits, so that starts are uniform over
all valid placements. Then the goals are placed one by one. `pursuit.tasks.placements` rejects
limits that are satisfied too rarely.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import inlined, subroutine
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
    Rules,
    Search,
    World,
    agents_of,
    bit_of,
    chasers_of,
    evaders_of,
    goals_of,
    team_stream,
)
from pursuit.rules.randomness import next_below, next_word


@inlined
def start(
    games: Games,
    game: int,
    streams: Any,
    pending: NextEpisode,
    rules: Rules,
    world: World,
    search: Search,
) -> None:
    """Start an episode: choose the maze, place agents and goals."""
    next_word(streams[game], team_stream(streams[game]))
    games.maze[game] = choose_maze(pending.maze[game], streams[game], world)
    games.steps[game] = 0
    for agent in agents_of(rules.teams):
        games.active[game, agent] = 1
        games.event[game, agent] = 0
    place_agents(games, game, streams[game], pending, rules, world)
    while not starts_apart(games, game, pending, rules, world, search):
        place_agents(games, game, streams[game], pending, rules, world)
    if rules.teams.goals > 0:
        place_goals(games, game, streams[game], pending, rules, world, search)


@inlined
def choose_maze(asked: int, streams: Any, world: World) -> int:
    """The maze `asked`, or a random one if it is -1."""
    if asked >= 0:
        return np.int64(asked)
    count = world.num_cells.shape[0]
    return next_below(streams, STARTS_STREAM, count) if count > 1 else 0


@inlined
def goals_wanted(game: int, pending: NextEpisode, rules: Rules) -> int:
    """The number of goals at the start of the episode."""
    wanted = rules.teams.goals
    if pending.num_goals[game] >= 0:
        wanted = min(wanted, np.int64(pending.num_goals[game]))
    return wanted


@inlined
def is_taken(games: Games, game: int, cell: int, rules: Rules, num_goals: int) -> bool:
    """Whether an agent, or one of the first `num_goals` goals, is on `cell`."""
    for agent in agents_of(rules.teams):
        if games.position[game, agent] == cell:
            return True
    for goal in range(num_goals):
        if games.goal[game, goal] == cell:
            return True
    return False


@inlined
def draw_free_cell(
    games: Games, game: int, streams: Any, rules: Rules, world: World, num_goals: int, taken: Any
) -> int:
    """A uniformly random cell without an agent and without one of the first goals.

    `taken` has the bits of occupied cells. Exact checks are needed only if a bit is set and there
    are more cells than bits.
    """
    size = world.num_cells[games.maze[game]]
    cell = next_below(streams, STARTS_STREAM, size)
    while taken & bit_of(cell) != 0 and (
        size <= 64 or is_taken(games, game, cell, rules, num_goals)
    ):
        cell = next_below(streams, STARTS_STREAM, size)
    return cell


@inlined
def cells_taken(games: Games, game: int, rules: Rules, num_goals: int) -> Any:
    """The bits of the cells of placed agents and of the first goals."""
    taken = np.uint64(0)
    for agent in agents_of(rules.teams):
        cell = games.position[game, agent]
        taken |= bit_of(cell) if cell >= 0 else np.uint64(0)
    for goal in range(num_goals):
        cell = games.goal[game, goal]
        taken |= bit_of(cell) if cell >= 0 else np.uint64(0)
    return taken


@inlined
def place_goals_on_marks(
    games: Games, game: int, pending: NextEpisode, rules: Rules, world: World
) -> int:
    """Place goals on the marks of the maze; return how many."""
    if not rules.start_at_marks:
        return 0
    maze = games.maze[game]
    count = min(goals_wanted(game, pending, rules), world.num_goal_marks[maze])
    for goal in range(count):
        games.goal[game, goal] = world.goal_marks[goal, maze]
    return count


@inlined
def place_agents(
    games: Games, game: int, streams: Any, pending: NextEpisode, rules: Rules, world: World
) -> None:
    """Place every agent on its mark, or on a uniformly random free cell without a marked goal."""
    teams, maze = rules.teams, games.maze[game]
    for agent in agents_of(teams):
        games.position[game, agent] = UNPLACED
    marked_goals = place_goals_on_marks(games, game, pending, rules, world)
    if rules.start_at_marks:
        if world.start_mark[maze] >= 0:
            games.position[game, 0] = world.start_mark[maze]
        if teams.goals == 0:
            mark = 0
            for evader in evaders_of(teams):
                if mark < world.num_goal_marks[maze]:
                    games.position[game, evader] = world.goal_marks[mark, maze]
                    mark += 1
    taken = cells_taken(games, game, rules, marked_goals)
    for agent in agents_of(rules.teams):
        if games.position[game, agent] < 0:
            cell = draw_free_cell(games, game, streams, rules, world, marked_goals, taken)
            games.position[game, agent] = cell
            taken |= bit_of(cell)


@inlined
def starts_apart(
    games: Games, game: int, pending: NextEpisode, rules: Rules, world: World, search: Search
) -> bool:
    """Whether the distances between chasers and evaders are within the limits."""
    least, most = pending.min_start_distance[game], pending.max_start_distance[game]
    if least <= 1 and most < 0:
        return True
    limit, maze, cells = max(least, most), games.maze[game], games.position[game]
    for chaser in chasers_of(rules.teams):
        for evader in evaders_of(rules.teams):
            distance = distance_within(world, search, maze, cells[chaser], cells[evader], limit)
            if distance < least or (most >= 0 and distance > most):
                return False
    return True


@inlined
def first_collector(rules: Rules) -> int:
    """The centre of the goal radius: the first runner or, without runners, the first evader."""
    teams = rules.teams
    return teams.chasers + teams.evaders if teams.runners > 0 else teams.chasers


@subroutine
def place_goals(
    games: Games,
    game: int,
    streams: Any,
    pending: NextEpisode,
    rules: Rules,
    world: World,
    search: Search,
) -> None:
    """Place the goals on the marks, or on random free cells within the goal radius.

    The radius is the path distance from the first runner (without runners, the first evader), or
    from the nearest goal mark of the maze. If there are too few free cells, it is increased by one
    until a goal fits.
    """
    for goal in goals_of(rules.teams):
        games.goal[game, goal] = -1
    placed = place_goals_on_marks(games, game, pending, rules, world)
    radius = np.int64(pending.goal_radius[game])
    around_marks = pending.goals_around_marks[game] > 0
    while placed < goals_wanted(game, pending, rules):
        if radius < 0:
            taken = cells_taken(games, game, rules, placed)
            cell = draw_free_cell(games, game, streams, rules, world, placed, taken)
        else:
            count = list_free_cells(games, game, rules, world, search, placed, radius, around_marks)
            while count == 0:
                radius += 1
                count = list_free_cells(
                    games, game, rules, world, search, placed, radius, around_marks
                )
            cell = np.int64(search.queue[next_below(streams, STARTS_STREAM, count)])
        games.goal[game, placed] = cell
        placed += 1


@subroutine
def list_free_cells(
    games: Games,
    game: int,
    rules: Rules,
    world: World,
    search: Search,
    num_goals: int,
    radius: int,
    around_marks: bool,
) -> int:
    """Fill `search.queue` with the free cells within the radius; return how many.

    Only the first `num_goals` goals have been placed.
    """
    maze = games.maze[game]
    first, size = world.first_cell[maze], world.num_cells[maze]
    center = np.int64(games.position[game, first_collector(rules)])
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
        if away <= radius and not is_taken(games, game, cell, rules, num_goals):
            search.queue[count] = cell
            count += 1
    return count
