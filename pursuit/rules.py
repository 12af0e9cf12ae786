"""The rule book: one game as a row of numbers, and the scalar functions that move it.

Everything here is plain scalar Python on cell numbers, compiled by Numba; `Simulator` calls the two
batched kernels at the end, `step_games` and `restart_games`, and nothing else knows the rules.

A game of A agents (chasers, then evaders, then runners) and G goals is one int32 row:

    position[A]  cell of each agent (a captured evader keeps the cell of its capture)
    active[A]    1, or 0 after capture
    event[A]     what the last step brought: a sum of COLLECTED, CAPTURED, WAS_CAPTURED
    goal[G]      cell of each goal; -1 when collected or absent
    steps        steps taken in this episode
    maze         which maze of the batch

and one uint64 row of random streams: one for starts, one per seat, one for curricula.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import allocating, compiled, inlined

NORTH, SOUTH, EAST, WEST, STAY = range(5)
UNREACHABLE = 2**31 - 1
"""The distance between two cells that no path joins."""

COLLECTED, CAPTURED, WAS_CAPTURED = 1, 2, 4

# Columns of the int64 description of a task.
(
    NUM_CHASERS,
    NUM_EVADERS,
    NUM_RUNNERS,
    NUM_GOALS,
    MAX_STEPS,
    NUM_ACTIONS,
    CHASERS_FIRST,
    START_AT_MARKS,
    NUM_MAZES,
    MAX_CELLS,
    NUM_TASK_FIELDS,
) = range(11)

# Columns of the float64 [role, ...] table of rewards.
STEP_REWARD, CAPTURE_REWARD, GOAL_REWARD, DISTANCE_REWARD, ON_COMPLETION = range(5)

# Columns of the int64 [maze, ...] description of the mazes; the goal marks follow.
CELL_OFFSET, CELL_COUNT, TABLE_OFFSET, START_MARK, NUM_GOAL_MARKS, FIRST_GOAL_MARK = range(6)

# Columns of the int32 [cell, ...] description of the cells, after the five neighbours. The last
# is a bit mask of the moves that change the cell.
ROW, COLUMN, MARK_DISTANCE, MOVE_MASK = 5, 6, 7, 8

# Columns of the int32 [game, ...] settings that take effect at the next restart; -1 is "no limit".
(
    NEXT_MAZE,
    NEXT_NUM_GOALS,
    GOAL_RADIUS,
    GOALS_AROUND_MARKS,
    MIN_START_DISTANCE,
    MAX_START_DISTANCE,
    NUM_SETTINGS,
) = range(7)

MAX_PLACEMENT_TRIES = 10_000
OK, BAD_ACTION, NO_PLACEMENT = 0, 1, 2

# -- randomness ------------------------------------------------------------------------------------


@inlined
def mix(word: Any) -> Any:
    """The output function of SplitMix64 (Steele, Lea and Flood, 2014)."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@inlined
def next_word(streams: Any, stream: int) -> Any:
    """The next 64 random bits of `streams[stream]`, which moves on."""
    streams[stream] += np.uint64(0x9E3779B97F4A7C15)
    return mix(streams[stream])


@inlined
def next_below(streams: Any, stream: int, bound: int) -> int:
    """A uniform integer from 0 to bound - 1 (bias below bound / 2**32)."""
    return np.int64(
        ((next_word(streams, stream) >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32)
    )


@inlined
def next_uniform(streams: Any, stream: int) -> float:
    """A uniform float64 in [0, 1)."""
    return np.float64(next_word(streams, stream) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@compiled
def seed_streams(streams: Any, seed: int, first_game: int) -> None:
    """Give every stream of every game its own state, a function of (seed, game, stream) alone."""
    for game in range(streams.shape[0]):
        key = mix(mix(np.uint64(seed)) + np.uint64(first_game + game))
        for stream in range(streams.shape[1]):
            streams[game, stream] = mix(key + mix(np.uint64(stream + 1)))


@compiled
def seed_starts(streams: Any, games: Any, seeds: Any) -> None:
    """Give the stream of starts (the first) of each of `games` the state that belongs to a seed."""
    for i in range(games.shape[0]):
        streams[games[i], 0] = mix(mix(seeds[i]) + np.uint64(1))


# -- distances -------------------------------------------------------------------------------------


@compiled
def breadth_first(neighbors: Any, origin: int, distances: Any, queue: Any) -> int:
    """Fill `distances` (UNREACHABLE before) with the steps from `origin`; how many were reached."""
    distances[origin] = 0
    queue[0] = origin
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        for action in range(4):
            after = neighbors[cell, action]
            if distances[after] == UNREACHABLE:
                distances[after] = distances[cell] + 1
                queue[tail] = after
                tail += 1
    return tail


@allocating
def all_distances(neighbors: Any, table: Any) -> None:
    """Fill the [cells, cells] `table` by one breadth-first search a row."""
    queue = np.empty(table.shape[0], dtype=np.int32)
    for origin in range(table.shape[0]):
        table[origin, :] = UNREACHABLE
        breadth_first(neighbors, origin, table[origin], queue)


@allocating
def longest_distance(neighbors: Any) -> int:
    """The largest finite distance between two cells, in memory linear in the cells."""
    size = neighbors.shape[0]
    queue = np.empty(size, dtype=np.int32)
    distances = np.empty(size, dtype=np.int32)
    longest = 0
    for origin in range(size):
        distances[:] = UNREACHABLE
        reached = breadth_first(neighbors, origin, distances, queue)
        longest = max(longest, distances[queue[reached - 1]])
    return longest


@compiled
def search_within(
    cells: Any, offset: int, origin: int, limit: int, target: int, scratch: Any
) -> int:
    """Breadth-first search from `origin` up to `limit` steps, ended early at `target`.

    `scratch` is int32 [2, cells of the largest maze]: row 0 holds distances and must be -1
    everywhere (`forget` restores it), row 1 the queue. How many cells were reached.
    """
    scratch[0, origin] = 0
    scratch[1, 0] = origin
    head, tail = 0, 1
    while head < tail:
        cell = scratch[1, head]
        head += 1
        if cell == target or scratch[0, cell] == limit:
            break
        for action in range(4):
            after = cells[offset + cell, action]
            if scratch[0, after] < 0:
                scratch[0, after] = scratch[0, cell] + 1
                scratch[1, tail] = after
                tail += 1
    return tail


@compiled
def forget(scratch: Any, reached: int) -> None:
    """Undo the marks that a `search_within` of `reached` cells left in `scratch`."""
    for i in range(reached):
        scratch[0, scratch[1, i]] = -1


@compiled
def distance_within(
    mazes: Any, cells: Any, tables: Any, scratch: Any, maze: int, a: int, b: int, limit: int
) -> int:
    """Steps between cells a and b, or limit + 1 where there are more (or no path)."""
    if mazes[maze, TABLE_OFFSET] >= 0:
        table = mazes[maze, TABLE_OFFSET]
        return min(np.int64(tables[table + a * mazes[maze, CELL_COUNT] + b]), limit + 1)
    offset = mazes[maze, CELL_OFFSET]
    if manhattan(cells, offset, a, b) > limit:
        return limit + 1
    reached = search_within(cells, offset, a, limit, b, scratch)
    found = scratch[0, b]
    forget(scratch, reached)
    return found if 0 <= found <= limit else limit + 1


@inlined
def manhattan(cells: Any, offset: int, a: int, b: int) -> int:
    """Rows plus columns between two cells, walls ignored."""
    a, b = offset + a, offset + b
    return abs(cells[a, ROW] - cells[b, ROW]) + abs(cells[a, COLUMN] - cells[b, COLUMN])


# -- placement -------------------------------------------------------------------------------------


@inlined
def is_taken(
    rows: Any, game: int, num_placed: int, cell: int, num_agents: int, num_goals_placed: int
) -> bool:
    """Whether one of the first agents, or one of the first goals, stands on `cell`."""
    for agent in range(num_placed):
        if rows[game, agent] == cell:
            return True
    for goal in range(num_goals_placed):
        if rows[game, 3 * num_agents + goal] == cell:
            return True
    return False


@inlined
def goals_wanted(game: int, settings: Any, task: Any) -> int:
    """How many goals the next episode of this game begins with."""
    wanted = task[NUM_GOALS]
    if settings[game, NEXT_NUM_GOALS] >= 0:
        wanted = min(wanted, np.int64(settings[game, NEXT_NUM_GOALS]))
    return wanted


@compiled
def place_agents(rows: Any, game: int, streams: Any, settings: Any, task: Any, mazes: Any) -> None:
    """Put every agent on its mark, or else on its own uniformly random cell, off marked goals."""
    maze = rows[game, -1]
    size = mazes[maze, CELL_COUNT]
    num_agents = task[NUM_CHASERS] + task[NUM_EVADERS] + task[NUM_RUNNERS]
    stream = game * (num_agents + 2)
    marked_goals = 0
    for agent in range(num_agents):
        rows[game, agent] = -1
    if task[START_AT_MARKS]:
        wanted = goals_wanted(game, settings, task)
        while marked_goals < min(wanted, mazes[maze, NUM_GOAL_MARKS]):
            rows[game, 3 * num_agents + marked_goals] = mazes[maze, FIRST_GOAL_MARK + marked_goals]
            marked_goals += 1
        if mazes[maze, START_MARK] >= 0:
            rows[game, 0] = mazes[maze, START_MARK]
        if task[NUM_GOALS] == 0:
            for i in range(min(task[NUM_EVADERS], mazes[maze, NUM_GOAL_MARKS])):
                rows[game, task[NUM_CHASERS] + i] = mazes[maze, FIRST_GOAL_MARK + i]
    for agent in range(num_agents):
        if rows[game, agent] >= 0:
            continue
        cell = next_below(streams, stream, size)
        while is_taken(rows, game, num_agents, cell, num_agents, marked_goals):
            cell = next_below(streams, stream, size)
        rows[game, agent] = cell


@compiled
def starts_apart(
    rows: Any,
    game: int,
    settings: Any,
    task: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
) -> bool:
    """Whether every chaser and evader are as far apart, and as near, as the settings ask."""
    least, most = settings[game, MIN_START_DISTANCE], settings[game, MAX_START_DISTANCE]
    if least <= 1 and most < 0:
        return True
    limit = max(least, most)
    for chaser in range(task[NUM_CHASERS]):
        for evader in range(task[NUM_CHASERS], task[NUM_CHASERS] + task[NUM_EVADERS]):
            distance = distance_within(
                mazes,
                cells,
                tables,
                scratch,
                rows[game, -1],
                rows[game, chaser],
                rows[game, evader],
                limit,
            )
            if distance < least or (most >= 0 and distance > most):
                return False
    return True


@compiled
def place_goals(
    rows: Any,
    game: int,
    streams: Any,
    settings: Any,
    task: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
) -> bool:
    """Put the goals on the marks, or on their own random cells within the radius of the settings.

    The radius counts path steps from the first runner (or the first evader where nobody runs), or
    from the nearest goal mark of the maze. Where it holds too few free cells it grows, a step at a
    time, until a goal fits.
    """
    maze = rows[game, -1]
    size, offset = mazes[maze, CELL_COUNT], mazes[maze, CELL_OFFSET]
    num_agents = task[NUM_CHASERS] + task[NUM_EVADERS] + task[NUM_RUNNERS]
    stream, first = game * (num_agents + 2), 3 * num_agents
    wanted = goals_wanted(game, settings, task)
    for goal in range(task[NUM_GOALS]):
        rows[game, first + goal] = -1
    placed = 0
    if task[START_AT_MARKS]:
        while placed < min(wanted, mazes[maze, NUM_GOAL_MARKS]):
            rows[game, first + placed] = mazes[maze, FIRST_GOAL_MARK + placed]
            placed += 1
    collector = num_agents - 1
    if task[NUM_RUNNERS] > 0:
        collector = task[NUM_CHASERS] + task[NUM_EVADERS]
    elif task[NUM_EVADERS] > 0:
        collector = task[NUM_CHASERS]
    center, radius = rows[game, collector], np.int64(settings[game, GOAL_RADIUS])
    around_marks = settings[game, GOALS_AROUND_MARKS] > 0
    while placed < wanted:
        if radius < 0:
            cell = next_below(streams, stream, size)
            while is_taken(rows, game, num_agents, cell, num_agents, placed):
                cell = next_below(streams, stream, size)
        else:
            # Count the free cells within the radius, then take one of them: exact, and bounded.
            searched = 0
            if not around_marks and mazes[maze, TABLE_OFFSET] < 0:
                searched = search_within(cells, offset, center, radius, -1, scratch)
            cell, candidates = -1, searched if searched > 0 else size
            free = 0
            for turn in range(2):
                pick = next_below(streams, stream, free) if turn == 1 else -1
                seen = 0
                for i in range(candidates):
                    other = np.int64(scratch[1, i]) if searched > 0 else i
                    if searched == 0:
                        if around_marks:
                            far = np.int64(cells[offset + other, MARK_DISTANCE])
                        else:
                            far = np.int64(
                                tables[mazes[maze, TABLE_OFFSET] + center * size + other]
                            )
                        if far > radius:
                            continue
                    if is_taken(rows, game, num_agents, other, num_agents, placed):
                        continue
                    if seen == pick:
                        cell = other
                        break
                    seen += 1
                free = seen
                if free == 0:
                    break
            forget(scratch, searched)
            if cell < 0:
                radius += 1
                if radius > size:
                    return False
                continue
        rows[game, first + placed] = cell
        placed += 1
    return True


@compiled
def restart(
    rows: Any,
    game: int,
    streams: Any,
    settings: Any,
    epsilons: Any,
    task: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
    returns: Any,
) -> bool:
    """Begin a new episode in one game: choose the maze, place agents and goals.

    Placements of the agents are drawn until they are as far apart as the settings ask, so they are
    uniform over all placements that are. False where none was found.
    """
    num_agents = task[NUM_CHASERS] + task[NUM_EVADERS] + task[NUM_RUNNERS]
    if settings[game, NEXT_MAZE] >= 0:
        rows[game, -1] = settings[game, NEXT_MAZE]
    elif task[NUM_MAZES] > 1:
        rows[game, -1] = next_below(streams, game * (num_agents + 2), task[NUM_MAZES])
    else:
        rows[game, -1] = 0
    rows[game, -2] = 0
    for agent in range(num_agents):
        returns[0, game, agent] = 0.0
        epsilons[0, game, agent] = epsilons[1, game, agent]
        rows[game, num_agents + agent] = 1
        rows[game, 2 * num_agents + agent] = 0
    for _ in range(MAX_PLACEMENT_TRIES):
        place_agents(rows, game, streams, settings, task, mazes)
        if starts_apart(rows, game, settings, task, mazes, cells, tables, scratch):
            return place_goals(rows, game, streams, settings, task, mazes, cells, tables, scratch)
    return False


# -- one step --------------------------------------------------------------------------------------


@inlined
def meet(chaser: int, chaser_after: int, evader: int, evader_after: int) -> bool:
    """Whether a move ends in one cell, or swapped the two: the rule of capture."""
    return chaser_after == evader_after or (chaser_after == evader and chaser == evader_after)


@inlined
def capture_and_move(
    rows: Any,
    game: int,
    actions: Any,
    task: Any,
    values: Any,
    cells: Any,
    offset: int,
    rewards: Any,
    chasers_move: bool,
    others_move: bool,
) -> None:
    """Find the captures as these agents move at once, then move them.

    A chaser captures an evader when both stand in one cell after the move, or when they swapped
    cells. Chasers that capture one evader together share the reward.
    """
    num_chasers, num_hunt = task[NUM_CHASERS], task[NUM_CHASERS] + task[NUM_EVADERS]
    num_agents = num_hunt + task[NUM_RUNNERS]
    first = game * num_agents
    for evader in range(num_chasers, num_hunt):
        if not rows[game, num_agents + evader]:
            continue
        before = rows[game, evader]
        after = cells[offset + before, actions[first + evader]] if others_move else before
        captors = 0
        # The first turn counts the captors, the second (only after a capture) pays them.
        for turn in range(2):
            for chaser in range(num_chasers):
                chaser_before = rows[game, chaser]
                chaser_after = (
                    cells[offset + chaser_before, actions[first + chaser]]
                    if chasers_move
                    else chaser_before
                )
                if meet(chaser_before, chaser_after, before, after):
                    if turn == 0:
                        captors += 1
                    else:
                        rows[game, 2 * num_agents + chaser] |= CAPTURED
                        rewards[game, chaser] += values[0, CAPTURE_REWARD] / captors
            if captors == 0:
                break
        if captors > 0:
            rows[game, 2 * num_agents + evader] |= WAS_CAPTURED
    for agent in range(num_agents):
        moves = chasers_move if agent < num_chasers else others_move
        captured = rows[game, 2 * num_agents + agent] & WAS_CAPTURED
        # A captured evader is left where it was caught: with its captor, or where it swapped to.
        if moves and rows[game, num_agents + agent]:
            rows[game, agent] = cells[offset + rows[game, agent], actions[first + agent]]
        if captured and rows[game, num_agents + agent]:
            rows[game, num_agents + agent] = 0


@inlined
def collect_goals(rows: Any, game: int, task: Any, values: Any, rewards: Any) -> None:
    """Give each goal to the runners and active evaders that stand on it, in equal shares."""
    num_chasers = task[NUM_CHASERS]
    num_agents = num_chasers + task[NUM_EVADERS] + task[NUM_RUNNERS]
    for goal in range(3 * num_agents, 3 * num_agents + task[NUM_GOALS]):
        takers = 0
        for turn in range(2):
            for agent in range(num_chasers, num_agents):
                if rows[game, agent] == rows[game, goal] and rows[game, num_agents + agent]:
                    if turn == 0:
                        takers += 1
                    else:
                        role = 1 if agent < num_agents - task[NUM_RUNNERS] else 2
                        rows[game, 2 * num_agents + agent] |= COLLECTED
                        rewards[game, agent] += values[role, GOAL_REWARD] / takers
            if takers == 0:
                break
        if takers > 0:
            rows[game, goal] = -1


@inlined
def nearest_manhattan(
    rows: Any,
    game: int,
    agent: int,
    first: int,
    last: int,
    num_agents: int,
    cells: Any,
    offset: int,
) -> int:
    """Rows plus columns from `agent` to the nearest active agent, or goal, of a column range."""
    nearest = -1
    for other in range(first, last):
        absent = (
            rows[game, other] < 0
            if other >= 3 * num_agents
            else rows[game, num_agents + other] == 0
        )
        if not absent:
            distance = manhattan(cells, offset, rows[game, agent], rows[game, other])
            if nearest < 0 or distance < nearest:
                nearest = distance
    return max(nearest, 0)


@inlined
def pay(
    rows: Any,
    game: int,
    task: Any,
    values: Any,
    cells: Any,
    offset: int,
    rewards: Any,
    all_done: bool,
) -> None:
    """Turn what happened in this step into rewards: those of events replace the step reward."""
    num_chasers, num_hunt = task[NUM_CHASERS], task[NUM_CHASERS] + task[NUM_EVADERS]
    num_agents = num_hunt + task[NUM_RUNNERS]
    for agent in range(num_agents):
        role = 0 if agent < num_chasers else 1 if agent < num_hunt else 2
        event = rows[game, 2 * num_agents + agent]
        if event & WAS_CAPTURED:
            rewards[game, agent] = values[role, CAPTURE_REWARD]
        elif not rows[game, num_agents + agent]:
            rewards[game, agent] = 0.0
        elif event == 0 or (values[role, ON_COMPLETION] != 0.0 and not all_done):
            reward = values[role, STEP_REWARD]
            if values[role, DISTANCE_REWARD] != 0.0:
                first, last = num_chasers, num_hunt
                if role == 1:
                    first, last = 0, num_chasers
                elif role == 2:
                    first, last = 3 * num_agents, 3 * num_agents + task[NUM_GOALS]
                reward += values[role, DISTANCE_REWARD] * nearest_manhattan(
                    rows, game, agent, first, last, num_agents, cells, offset
                )
            rewards[game, agent] = reward


@inlined
def step_game(
    rows: Any,
    game: int,
    actions: Any,
    task: Any,
    values: Any,
    cells: Any,
    offset: int,
    rewards: Any,
) -> int:
    """Move one game by one step; 0 while it goes on, 1 terminated, 2 truncated."""
    num_chasers, num_hunt = task[NUM_CHASERS], task[NUM_CHASERS] + task[NUM_EVADERS]
    num_agents = num_hunt + task[NUM_RUNNERS]
    for agent in range(num_agents):
        rows[game, 2 * num_agents + agent] = 0
        rewards[game, agent] = 0.0
    if task[CHASERS_FIRST]:
        capture_and_move(rows, game, actions, task, values, cells, offset, rewards, True, False)
        capture_and_move(rows, game, actions, task, values, cells, offset, rewards, False, True)
    else:
        capture_and_move(rows, game, actions, task, values, cells, offset, rewards, True, True)
    goals_left = 0
    if task[NUM_GOALS] > 0:
        had_goals = 0
        for goal in range(3 * num_agents, 3 * num_agents + task[NUM_GOALS]):
            had_goals += rows[game, goal] >= 0
        collect_goals(rows, game, task, values, rewards)
        for goal in range(3 * num_agents, 3 * num_agents + task[NUM_GOALS]):
            goals_left += rows[game, goal] >= 0
        # A game always has a goal left at the start of a step, unless it began with none.
        terminated = had_goals > 0 and goals_left == 0
    else:
        terminated = False
    evaders_left = 0
    for evader in range(num_chasers, num_hunt):
        evaders_left += rows[game, num_agents + evader]
    if num_hunt > num_chasers and evaders_left == 0:
        terminated = True
    rows[game, -2] += 1
    pay(rows, game, task, values, cells, offset, rewards, terminated)
    if terminated:
        return 1
    return 2 if rows[game, -2] >= task[MAX_STEPS] else 0


# -- batches ---------------------------------------------------------------------------------------


@inlined
def step_duel(
    rows: Any,
    game: int,
    actions: Any,
    task: Any,
    values: Any,
    cells: Any,
    offset: int,
    rewards: Any,
) -> int:
    """`step_game` for one chaser, one evader and nothing else, in straight lines: much faster."""
    chaser, evader = rows[game, 0], rows[game, 1]
    chaser_after = cells[offset + chaser, actions[2 * game]]
    evader_after = cells[offset + evader, actions[2 * game + 1]]
    if task[CHASERS_FIRST]:
        if chaser_after == evader:
            evader_after = evader
        chaser = chaser_after
    captured = meet(chaser, chaser_after, evader, evader_after)
    rows[game, 0], rows[game, 1] = chaser_after, evader_after
    rows[game, 3] = 0 if captured else 1
    rows[game, 4] = CAPTURED if captured else 0
    rows[game, 5] = WAS_CAPTURED if captured else 0
    rows[game, 6] += 1
    if captured:
        rewards[game, 0], rewards[game, 1] = values[0, CAPTURE_REWARD], values[1, CAPTURE_REWARD]
        return 1
    chaser_reward, evader_reward = values[0, STEP_REWARD], values[1, STEP_REWARD]
    if values[0, DISTANCE_REWARD] != 0.0 or values[1, DISTANCE_REWARD] != 0.0:
        distance = manhattan(cells, offset, chaser_after, evader_after)
        chaser_reward += values[0, DISTANCE_REWARD] * distance
        evader_reward += values[1, DISTANCE_REWARD] * distance
    rewards[game, 0], rewards[game, 1] = chaser_reward, evader_reward
    return 2 if rows[game, 6] >= task[MAX_STEPS] else 0


@inlined
def step_each(
    rows: Any,
    streams: Any,
    settings: Any,
    epsilons: Any,
    actions: Any,
    task: Any,
    values: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
    rewards: Any,
    returns: Any,
    ended: Any,
    final_rows: Any,
    auto_restart: bool,
    straight: bool,
) -> int:
    """The loop of `step_games`, compiled apart for duels where `straight` is the constant True."""
    num_agents = 2 if straight else task[NUM_CHASERS] + task[NUM_EVADERS] + task[NUM_RUNNERS]
    for game in range(rows.shape[0]):
        if not auto_restart and (ended[0, game] or ended[1, game]):
            for agent in range(num_agents):
                rewards[game, agent] = 0.0
            continue
        offset = mazes[rows[game, -1], CELL_OFFSET]
        if straight:
            outcome = step_duel(rows, game, actions, task, values, cells, offset, rewards)
        else:
            outcome = step_game(rows, game, actions, task, values, cells, offset, rewards)
        for agent in range(num_agents):
            returns[0, game, agent] += rewards[game, agent]
        ended[0, game] = outcome == 1
        ended[1, game] = outcome == 2
        if outcome > 0:
            for column in range(rows.shape[1]):
                final_rows[game, column] = rows[game, column]
            for agent in range(num_agents):
                returns[1, game, agent] = returns[0, game, agent]
            if auto_restart and not restart(
                rows,
                game,
                streams,
                settings,
                epsilons,
                task,
                mazes,
                cells,
                tables,
                scratch,
                returns,
            ):
                return NO_PLACEMENT
    return OK


@compiled
def step_games(
    rows: Any,
    streams: Any,
    settings: Any,
    epsilons: Any,
    actions: Any,
    task: Any,
    values: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
    rewards: Any,
    returns: Any,
    ended: Any,
    final_rows: Any,
    auto_restart: bool,
) -> int:
    """Move every game by one step, in place; OK, BAD_ACTION (nothing moved) or NO_PLACEMENT.

    `streams` and `actions` are flat: [games * streams], [games * agents]. `epsilons` is
    [2, games, agents]: those in force, and those from the next restart on. `returns` is
    [2, games, agents]: so far in this episode, and of the last finished one. `ended` is
    [2, games]: terminated and truncated in this step. A game that ends is copied to `final_rows`
    and, with `auto_restart`, begins anew at once; without, it stays as it is and earns nothing.
    """
    bad = 0
    for i in range(actions.shape[0]):
        bad |= np.uint32(actions[i]) >= np.uint32(task[NUM_ACTIONS])
    if bad:
        return BAD_ACTION
    if task[:4] == (1, 1, 0, 0):
        return step_each(
            rows,
            streams,
            settings,
            epsilons,
            actions,
            task,
            values,
            mazes,
            cells,
            tables,
            scratch,
            rewards,
            returns,
            ended,
            final_rows,
            auto_restart,
            True,
        )
    return step_each(
        rows,
        streams,
        settings,
        epsilons,
        actions,
        task,
        values,
        mazes,
        cells,
        tables,
        scratch,
        rewards,
        returns,
        ended,
        final_rows,
        auto_restart,
        False,
    )


@compiled
def restart_games(
    rows: Any,
    streams: Any,
    settings: Any,
    epsilons: Any,
    task: Any,
    mazes: Any,
    cells: Any,
    tables: Any,
    scratch: Any,
    returns: Any,
    chosen: Any,
) -> int:
    """Begin a new episode in every game where `chosen`; OK or NO_PLACEMENT."""
    for game in range(rows.shape[0]):
        if chosen[game] and not restart(
            rows, game, streams, settings, epsilons, task, mazes, cells, tables, scratch, returns
        ):
            return NO_PLACEMENT
    return OK


@compiled
def draw_uniform(streams: Any, stream: int, numbers: Any) -> None:
    """Fill `numbers` [games] with one uniform float64 from `stream` of every game."""
    for game in range(numbers.shape[0]):
        numbers[game] = next_uniform(streams[game], stream)
