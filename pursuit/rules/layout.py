"""How games, mazes and rules lie in memory, and by which names the rule book calls them.

Agents are numbered by role, and the numbers are the seats; N games of A agents and G goals:

    agent      0 .. C-1    C .. C+E-1    C+E .. A-1          cell     0   1   2     row by row,
               chasers     evaders       runners                      3       4     blocked ones
    goal       0 .. G-1                                               5   6   7     have no number

    games.position [N, A]   games.active [N, A]   games.event [N, A]   games.goal [N, G]
    games.steps [N]         games.maze [N]        streams [N, 1 + A + 1]: starts, seats, teams

A compiled entry is handed few flat arrays, as each costs its time at every call: what has the same
shape lies stacked in one (`Memory`). The functions at the end give every layer its name, at once;
everything below an entry reads `games.position[game, agent]`. They run uncompiled as well: the
`Simulator` names the same memory by them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined

NORTH, SOUTH, EAST, WEST, STAY = range(5)
UNREACHABLE = 2**31 - 1
"""The distance between two cells that no path joins."""

CHASER, EVADER, RUNNER = range(3)
COLLECTED, CAPTURED, WAS_CAPTURED = 1, 2, 4
"""What a step brought an agent; `games.event` holds a sum of them."""

GOING_ON, TERMINATED, TRUNCATED = range(3)
OK, BAD_ACTION = range(2)
UNPLACED = -1
"""The cell of an agent that is not placed yet."""
UNCHANGED = -1.0  # the next episode's epsilon where none waits: the present one stays

# The stacked layers of the flat arrays.
POSITION, ACTIVE, EVENT, FINAL_POSITION, FINAL_ACTIVE, FINAL_EVENT, AGENT_LAYERS = range(7)
GOAL, FINAL_GOAL, GOAL_LAYERS = range(3)
STEPS, MAZE, FINAL_STEPS, FINAL_MAZE, CLOCK_LAYERS = range(5)
EPSILON, NEXT_EPSILON, RETURNS, COLLECTED_GOALS, EPISODE_RETURNS, REAL_LAYERS = range(6)
ENDED_BY_RULE, ENDED_BY_TIME, FLAG_LAYERS = range(3)
SCRATCH_DISTANCE, SCRATCH_QUEUE, SCRATCH_AFTER = range(3)
SCRATCH_CAPTORS, SCRATCH_TAKERS, SCRATCH_CAPTURED, SCRATCH_LAYERS = range(3, 7)
FIRST_CELL, NUM_CELLS, TABLE, START_MARK, NUM_GOAL_MARKS, GOAL_MARKS = range(6)
ROW, COLUMN, MARK_DISTANCE, MOVES, FACT_LAYERS = range(5)


class Teams(NamedTuple):
    """How many of each there are; known to the compiler where a kernel is made for one task."""

    chasers: int
    evaders: int
    runners: int
    goals: int


class RewardCoefficients(NamedTuple):
    """What one role is paid; see `pursuit.tasks.rewards.Rewards`."""

    step: float
    capture: float
    goal: float
    distance: float
    on_completion: float
    per_evader: float


class Rules(NamedTuple):
    """One task, as the rules need it."""

    teams: Teams
    max_steps: int
    num_actions: int
    chasers_first: bool
    start_at_marks: bool
    chaser: RewardCoefficients
    evader: RewardCoefficients
    runner: RewardCoefficients


class World(NamedTuple):
    """Mazes laid end to end; what lies in cell c of maze m is at `first_cell[m] + c`.

    first_cell, num_cells, table, start_mark, num_goal_marks: [mazes] int64; `table` is where the
        maze's distances begin in `tables`, -1 where it is too large for a table; no mark is -1.
    goal_marks: [marks, mazes] int64, cells.
    neighbors: [all cells, 5] int32, the cell after north, south, east, west, stay.
    row, column, mark_distance: [all cells] int32; steps to the nearest goal mark.
    moves: [all cells] int32, the bit mask of the moves that change the cell.
    tables: uint16, the distances between all pairs of cells, maze after maze.
    """

    first_cell: Any
    num_cells: Any
    table: Any
    start_mark: Any
    num_goal_marks: Any
    goal_marks: Any
    neighbors: Any
    row: Any
    column: Any
    mark_distance: Any
    moves: Any
    tables: Any


class Games(NamedTuple):
    """A batch of games, int32.

    position: [games, agents], cells; a captured evader keeps that of its capture.
    active: [games, agents], 1, or 0 after capture.
    event: [games, agents], what the last step brought: a sum of COLLECTED, CAPTURED, WAS_CAPTURED.
    goal: [games, goals], cells; -1 when collected or absent.
    steps: [games], taken in this episode.
    maze: [games], which maze of the world.
    """

    position: Any
    active: Any
    event: Any
    goal: Any
    steps: Any
    maze: Any


class NextEpisode(NamedTuple):
    """What takes effect as the next episode begins, [games] int32; -1 is "no limit", or "drawn".

    epsilon: [games, agents] float64, the share of random moves; NaN leaves it to the agent, and
        UNCHANGED the present one as it is, which the start of an episode puts here.
    """

    maze: Any
    num_goals: Any
    goal_radius: Any
    goals_around_marks: Any
    min_start_distance: Any
    max_start_distance: Any
    epsilon: Any


class Outcome(NamedTuple):
    """What steps led to.

    rewards: [games, agents] float32, of the last step.
    returns: [games, agents] float64, of the episode so far.
    collected: [games, agents] float64, goals collected in it so far, those shared in parts.
    terminated, truncated: [games] bool, of the last step.
    episode_returns: [games, agents] float64, of the last finished episode.
    final: the games as their last finished episode ended.
    """

    rewards: Any
    returns: Any
    collected: Any
    terminated: Any
    truncated: Any
    episode_returns: Any
    final: Games


class Search(NamedTuple):
    """Room for one search: `distance` is -1 everywhere between two of them. [cells] int32."""

    distance: Any
    queue: Any


class StepScratch(NamedTuple):
    """What is decided before anything is written, for one game after the other; int32.

    after: [agents], where each will stand.
    captors: [agents], how many chasers capture this evader; captured: those who are, in order.
    takers: [goals], how many collect this goal.
    """

    after: Any
    captors: Any
    takers: Any
    captured: Any


class Memory(NamedTuple):
    """The flat arrays of a batch, its layers named above; made by `allocate`.

    All of one game lies together: a step has few places to look at, and so few registers to lose.

    agents: [games, AGENT_LAYERS, agents] int32.
    goals: [games, GOAL_LAYERS, goals] int32.
    clocks: [games, CLOCK_LAYERS] int32.
    coming: [fields of NextEpisode but epsilon, games] int32.
    reals: [games, REAL_LAYERS, agents] float64.
    flags: [FLAG_LAYERS, games] bool.
    rewards: [games, agents] float32.
    streams: [games, 1 + agents + 1] uint64, of random numbers.
    """

    agents: Any
    goals: Any
    clocks: Any
    pending: Any
    reals: Any
    flags: Any
    rewards: Any
    streams: Any


def allocate(num_games: int, num_agents: int, num_goals: int) -> Memory:
    """Memory for a batch of games that have not begun."""
    reals = np.zeros((num_games, REAL_LAYERS, num_agents))
    reals[:, EPSILON], reals[:, NEXT_EPSILON] = np.nan, UNCHANGED
    return Memory(
        agents=np.zeros((num_games, AGENT_LAYERS, num_agents), dtype=np.int32),
        goals=np.zeros((num_games, GOAL_LAYERS, num_goals), dtype=np.int32),
        clocks=np.zeros((num_games, CLOCK_LAYERS), dtype=np.int32),
        pending=np.full((len(NextEpisode._fields) - 1, num_games), -1, dtype=np.int32),
        reals=reals,
        flags=np.zeros((FLAG_LAYERS, num_games), dtype=bool),
        rewards=np.zeros((num_games, num_agents), dtype=np.float32),
        streams=np.zeros((num_games, 1 + num_agents + 1), dtype=np.uint64),
    )


def empty_games(num_games: int, num_agents: int, num_goals: int) -> Games:
    """Games in which nobody is active and every array is 0."""
    return named(games_of, allocate(num_games, num_agents, num_goals))


def numbers_of(
    teams: Teams, max_steps: int, num_actions: int, chasers_first: bool, start_at_marks: bool
) -> Any:
    """[8] int64: the teams and the first rules, as kernels take them and `rules_of` names them."""
    rest = (max_steps, num_actions, chasers_first, start_at_marks)
    return np.array([*teams, *rest], dtype=np.int64)


def scratch_for(num_cells: int, num_agents: int, num_goals: int) -> Any:
    """Room for the plan of one game, and for a search over `num_cells` cells."""
    return np.full((SCRATCH_LAYERS, max(num_cells, num_agents, num_goals)), -1, dtype=np.int32)


def named(naming: Any, *arrays: Any) -> Any:
    """What one of the functions below returns, outside kernels: views of the arrays."""
    return getattr(naming, "py_func", naming)(*arrays)  # itself where nothing is compiled


# -- names for the layers --------------------------------------------------------------------------


@inlined
def games_of(memory: Memory) -> Games:
    """The games as they stand."""
    agents, clocks = memory.agents, memory.clocks
    return Games(
        agents[:, POSITION], agents[:, ACTIVE], agents[:, EVENT], memory.goals[:, GOAL],
        clocks[:, STEPS], clocks[:, MAZE],
    )  # fmt: skip


@inlined
def outcome_of(memory: Memory) -> Outcome:
    """What steps write beside the games."""
    agents, clocks, reals, flags = memory.agents, memory.clocks, memory.reals, memory.flags
    final = Games(
        agents[:, FINAL_POSITION], agents[:, FINAL_ACTIVE], agents[:, FINAL_EVENT],
        memory.goals[:, FINAL_GOAL], clocks[:, FINAL_STEPS], clocks[:, FINAL_MAZE],
    )  # fmt: skip
    return Outcome(
        memory.rewards, reals[:, RETURNS], reals[:, COLLECTED_GOALS], flags[ENDED_BY_RULE],
        flags[ENDED_BY_TIME], reals[:, EPISODE_RETURNS], final,
    )  # fmt: skip


@inlined
def next_episode_of(memory: Memory) -> NextEpisode:
    """The settings of the next episode."""
    pending, epsilon = memory.pending, memory.reals[:, NEXT_EPSILON]
    return NextEpisode(
        pending[0], pending[1], pending[2], pending[3], pending[4], pending[5], epsilon
    )  # fmt: skip


@inlined
def world_of(mazes: Any, neighbors: Any, facts: Any, tables: Any) -> World:
    """The mazes: [GOAL_MARKS + marks, mazes] int64, and [FACT_LAYERS, all cells] int32."""
    return World(
        mazes[FIRST_CELL], mazes[NUM_CELLS], mazes[TABLE], mazes[START_MARK],
        mazes[NUM_GOAL_MARKS], mazes[GOAL_MARKS:], neighbors, facts[ROW], facts[COLUMN],
        facts[MARK_DISTANCE], facts[MOVES], tables,
    )  # fmt: skip


@inlined
def teams_of(numbers: Any) -> Teams:
    """How many of each the task has, of the numbers of `numbers_of`."""
    return Teams(numbers[0], numbers[1], numbers[2], numbers[3])


@inlined
def rewards_of(row: Any) -> RewardCoefficients:
    """What a role is paid: float64, in the order of the fields of `RewardCoefficients`."""
    return RewardCoefficients(row[0], row[1], row[2], row[3], row[4], row[5])


@inlined
def rules_of(teams: Teams, numbers: Any, coefficients: Any) -> Rules:
    """The rules for these teams: `numbers` is the result of `numbers_of`."""
    return Rules(
        teams, numbers[4], numbers[5], numbers[6] != 0, numbers[7] != 0,
        rewards_of(coefficients[CHASER]), rewards_of(coefficients[EVADER]),
        rewards_of(coefficients[RUNNER]),
    )  # fmt: skip


@inlined
def search_of(scratch: Any) -> Search:
    """Where starts search."""
    return Search(scratch[SCRATCH_DISTANCE], scratch[SCRATCH_QUEUE])


@inlined
def step_scratch_of(scratch: Any) -> StepScratch:
    """Where a step decides."""
    after, captors = scratch[SCRATCH_AFTER], scratch[SCRATCH_CAPTORS]
    return StepScratch(after, captors, scratch[SCRATCH_TAKERS], scratch[SCRATCH_CAPTURED])


# -- who is who ------------------------------------------------------------------------------------


@inlined
def agents_of(teams: Teams) -> Any:
    """All agents."""
    return range(teams.chasers + teams.evaders + teams.runners)


@inlined
def chasers_of(teams: Teams) -> Any:
    """The chasers, who are the first."""
    return range(teams.chasers)


@inlined
def evaders_of(teams: Teams) -> Any:
    """The evaders, who come after the chasers."""
    return range(teams.chasers, teams.chasers + teams.evaders)


@inlined
def runners_of(teams: Teams) -> Any:
    """The runners, who are the last."""
    return range(teams.chasers + teams.evaders, teams.chasers + teams.evaders + teams.runners)


@inlined
def goals_of(teams: Teams) -> Any:
    """All goals."""
    return range(teams.goals)


@inlined
def collectors_of(teams: Teams) -> Any:
    """Whoever collects goals: evaders and runners."""
    return range(teams.chasers, teams.chasers + teams.evaders + teams.runners)


@inlined
def bit_of(number: int) -> Any:
    """The bit of a cell or agent in a word of those that may be meant: 64 apart share one."""
    return np.uint64(1) << (np.uint64(number) & np.uint64(63))


STARTS_STREAM = 0
"""The random stream of starts; then come one for each seat, and one for the agents of a team that
draw together."""


@inlined
def stream_of(seat: int) -> int:
    """The random stream of the policy in a seat."""
    return STARTS_STREAM + 1 + seat


@inlined
def team_stream(streams: Any) -> int:
    """The stream of a team, of those of a game; it moves on as an episode begins, and only then."""
    return streams.shape[0] - 1
