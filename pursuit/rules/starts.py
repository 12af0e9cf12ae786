"""Start placements of agents and goals.

Placements of all exits and agents are drawn until one satisfies the limits, so that starts are
uniform over all valid placements. Then the goals are placed one by one. `pursuit.tasks.placements`
rejects limits that are satisfied too rarely.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined, subroutine
from pursuit.rules.arrays import Ints, Words
from pursuit.rules.distances import (
    distance_within,
    forget,
    has_table,
    search_within,
    table_distance,
)
from pursuit.rules.layout import (
    ACTIVE,
    CLOCK_LAYERS,
    EVENT,
    FIRST_CELL,
    GOAL,
    GOAL_MARKS,
    GOAL_RADIUS,
    GOALS_AROUND_MARKS,
    MARK_DISTANCE,
    MAX_START_DISTANCE,
    MAZE,
    MIN_START_DISTANCE,
    NEXT_MAZE,
    NUM_CELLS,
    NUM_GOAL_MARKS,
    NUM_GOALS,
    POSITION,
    START_MARK,
    STARTS_STREAM,
    STEPS,
    UNPLACED,
    Search,
    StartRules,
    World,
    agents_of,
    chasers_of,
    evaders_of,
    goals_of,
    team_stream,
)
from pursuit.rules.randomness import next_below, next_word


class Start(NamedTuple):
    """One game of a batch at the start of an episode.

    agents, goals, clocks, streams: the rows of the game in those of `Memory`; pending: its column
    there.
    """

    agents: Ints
    goals: Ints
    clocks: Ints
    streams: Words
    pending: Ints
    rules: StartRules
    world: World
    search: Search


@inlined
def start(own: Start, goals: Any) -> None:
    """Start an episode: choose the maze, place agents and, unless `goals` is None, goals."""
    teams = own.rules.teams
    next_word(own.streams, team_stream(teams.chasers + teams.evaders + teams.runners))
    own.clocks[MAZE] = choose_maze(own.pending[NEXT_MAZE], own.streams, own.world.mazes.shape[1])
    own.clocks[STEPS] = 0
    for agent in agents_of(teams):
        own.agents[ACTIVE, agent] = 1
        own.agents[EVENT, agent] = 0
    place_agents(own)
    while not starts_apart(own) or starts_on_exit(own):
        place_agents(own)
    if goals is not None:
        place_goals(own)


@inlined
def choose_maze(asked: int, streams: Words, count: int) -> int:
    """The maze `asked`, or a random one of `count` if it is -1."""
    if asked >= 0:
        return np.int64(asked)
    return next_below(streams, STARTS_STREAM, count) if count > 1 else 0


@inlined
def goals_wanted(start: Start) -> int:
    """The number of goals at the start of the episode."""
    wanted = start.rules.teams.goals
    if start.pending[NUM_GOALS] >= 0:
        wanted = min(wanted, np.int64(start.pending[NUM_GOALS]))
    return wanted


@inlined
def is_taken(start: Start, agents: range, cell: int, num_goals: int, num_exits: int) -> bool:
    """Whether one of these agents, or of the first goals or exits, is on `cell`."""
    for agent in agents:
        if start.agents[POSITION, agent] == cell:
            return True
    for goal in range(num_goals):
        if start.goals[GOAL, goal] == cell:
            return True
    return is_exit(start.clocks[CLOCK_LAYERS:], cell, num_exits)


@inlined
def is_exit(exits: Ints, cell: int, num_exits: int) -> bool:
    """Whether one of the first exits is on `cell`."""
    for number in range(num_exits):
        if exits[number] == cell:
            return True
    return False


@inlined
def draw_free_cell(start: Start, agents: range, num_goals: int, num_exits: int) -> int:
    """A uniformly random cell without one of these agents and of the first goals and exits."""
    size = start.world.mazes[NUM_CELLS, start.clocks[MAZE]]
    cell = next_below(start.streams, STARTS_STREAM, size)
    while is_taken(start, agents, cell, num_goals, num_exits):
        cell = next_below(start.streams, STARTS_STREAM, size)
    return cell


@inlined
def place_exits(start: Start, num_goals: int) -> None:
    """Place the exits of the maze, or draw different cells without an evader or a marked goal."""
    count, fixed = start.rules.exits, start.rules.fixed_exits
    for number in range(count):
        if fixed.shape[0] > 0:
            cell = fixed[start.clocks[MAZE] * count + number]
        else:
            cell = draw_free_cell(start, evaders_of(start.rules.teams), num_goals, number)
        start.clocks[CLOCK_LAYERS + number] = cell


@inlined
def starts_on_exit(start: Start) -> bool:
    """Whether an evader is on an exit."""
    for evader in evaders_of(start.rules.teams):
        cell = start.agents[POSITION, evader]
        if is_exit(start.clocks[CLOCK_LAYERS:], cell, start.rules.exits):
            return True
    return False


@inlined
def place_goals_on_marks(start: Start) -> int:
    """Place goals on the marks of the maze; return how many."""
    if not start.rules.at_marks:
        return 0
    maze = start.clocks[MAZE]
    count = min(goals_wanted(start), start.world.mazes[NUM_GOAL_MARKS, maze])
    for goal in range(count):
        start.goals[GOAL, goal] = start.world.mazes[GOAL_MARKS + goal, maze]
    return count


@inlined
def place_agents(start: Start) -> None:
    """Place every agent on its mark, or on a uniformly random free cell without a marked goal; then
    the exits."""
    teams, world, position = start.rules.teams, start.world, start.agents[POSITION]
    maze = start.clocks[MAZE]
    for agent in agents_of(teams):
        position[agent] = UNPLACED
    marked_goals = place_goals_on_marks(start)
    if start.rules.at_marks:
        if world.mazes[START_MARK, maze] >= 0:
            position[0] = world.mazes[START_MARK, maze]
        if teams.goals == 0:
            mark = 0
            for evader in evaders_of(teams):
                if mark < world.mazes[NUM_GOAL_MARKS, maze]:
                    position[evader] = world.mazes[GOAL_MARKS + mark, maze]
                    mark += 1
    for agent in agents_of(teams):
        if position[agent] < 0:
            position[agent] = draw_free_cell(start, agents_of(teams), marked_goals, 0)
    place_exits(start, marked_goals)


@inlined
def starts_apart(start: Start) -> bool:
    """Whether the distances between chasers and evaders are within the limits."""
    pending, world = start.pending, start.world
    least, most = pending[MIN_START_DISTANCE], pending[MAX_START_DISTANCE]
    if least <= 1 and most < 0:
        return True
    limit, maze, cells = max(least, most), start.clocks[MAZE], start.agents[POSITION]
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
    goals, exits = start.goals[GOAL], start.rules.exits
    for goal in goals_of(start.rules.teams):
        goals[goal] = -1
    placed = place_goals_on_marks(start)
    radius = np.int64(start.pending[GOAL_RADIUS])
    while placed < goals_wanted(start):
        if radius < 0:
            cell = draw_free_cell(start, agents_of(start.rules.teams), placed, exits)
        else:
            count = list_free_cells(start, placed, radius)
            while count == 0:
                radius += 1
                count = list_free_cells(start, placed, radius)
            cell = np.int64(start.search.queue[next_below(start.streams, STARTS_STREAM, count)])
        goals[placed] = cell
        placed += 1


@subroutine
def list_free_cells(start: Start, num_goals: int, radius: int) -> int:
    """Fill `search.queue` with the free cells within the radius; return how many.

    Only the first `num_goals` goals have been placed.
    """
    world, search, maze = start.world, start.search, start.clocks[MAZE]
    around_marks = start.pending[GOALS_AROUND_MARKS] > 0
    first, size = world.mazes[FIRST_CELL, maze], world.mazes[NUM_CELLS, maze]
    teams = start.rules.teams  # the centre is the first runner or, without runners, first evader
    collector = teams.chasers + teams.evaders if teams.runners > 0 else teams.chasers
    center = np.int64(start.agents[POSITION, collector])
    if not around_marks and not has_table(world, maze):
        size = search_within(world, maze, center, radius, -1, search)
        forget(search, size)
    count = 0
    for i in range(size):
        if around_marks:
            cell, away = i, np.int64(world.facts[MARK_DISTANCE, first + i])
        elif has_table(world, maze):
            cell, away = i, table_distance(world, maze, center, i)
        else:
            cell, away = np.int64(search.queue[i]), radius
        exits, agents = start.rules.exits, agents_of(teams)
        if away <= radius and not is_taken(start, agents, cell, num_goals, exits):
            search.queue[count] = cell
            count += 1
    return count
