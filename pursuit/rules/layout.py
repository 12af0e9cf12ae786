"""The memory layout of games, mazes and rules, and the names of their arrays.

Agent indices (seats) are ordered by role. Shapes for N games of A agents and G goals:

    agent      0 .. C-1    C .. C+E-1    C+E .. A-1          cell     0   1   2     row by row,
               chasers     evaders       runners                      3       4     blocked ones
    goal       0 .. G-1                                               5   6   7     have no number

    games.position [N, A]   games.active [N, A]   games.event [N, A]   games.goal [N, G]
    games.steps [N]         games.maze [N]        games.exit [N, X]
    streams [N, 1 + A + 1]: starts, seats, teams; one more of slips in tasks with slips

Each array argument of a compiled function costs time at every call, so arrays of the same shape are
stacked in one (`Memory`). The rules read `turn.agents[POSITION, agent]`, in the rows of one game.
`games_of` and its like return named views of the layers, `games.position[game, agent]`, for the
`Simulator`, observations and policies.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Flags, Ints, Longs, Reals, Words
from pursuit.rules.terms import ADJACENT as ADJACENT
from pursuit.rules.terms import CELL as CELL
from pursuit.rules.terms import CHASER as CHASER
from pursuit.rules.terms import EVADER as EVADER
from pursuit.rules.terms import PLAIN as PLAIN
from pursuit.rules.terms import RUNNER as RUNNER
from pursuit.rules.terms import SURROUND as SURROUND
from pursuit.rules.terms import Options as Options
from pursuit.rules.terms import RewardCoefficients as RewardCoefficients
from pursuit.rules.terms import StartRules as StartRules
from pursuit.rules.terms import StepRules as StepRules
from pursuit.rules.terms import Teams as Teams
from pursuit.rules.terms import no_options as no_options
from pursuit.rules.terms import numbers_of as numbers_of
from pursuit.rules.terms import options_of as options_of
from pursuit.rules.terms import start_rules_of as start_rules_of
from pursuit.rules.terms import step_rules_of as step_rules_of
from pursuit.rules.terms import teams_of as teams_of

NORTH, SOUTH, EAST, WEST, STAY = range(5)
"""The actions in a maze; see `stay_of` for graphs."""
UNREACHABLE = 2**31 - 1
"""The distance between two cells without a connecting path."""

COLLECTED, CAPTURED, WAS_CAPTURED, ESCAPED = 1, 2, 4, 8
"""Events of an agent in a step; `games.event` holds a sum of them."""

GOING_ON, TERMINATED, TRUNCATED = range(3)
OK, BAD_ACTION = range(2)
NO_RESTART, RESTART, START = range(3)  # what a call of a step kernel does besides a step
UNPLACED = -1  # the cell of an agent that is not placed yet
UNCHANGED = -1.0  # no pending epsilon: the current one remains

# The stacked layers of the flat arrays.
POSITION, ACTIVE, EVENT, FINAL_POSITION, FINAL_ACTIVE, FINAL_EVENT, AGENT_LAYERS = range(7)
GOAL, FINAL_GOAL, GOAL_LAYERS = range(3)
NEXT_MAZE, NUM_GOALS, GOAL_RADIUS, GOALS_AROUND_MARKS = range(4)
MIN_START_DISTANCE, MAX_START_DISTANCE, LISTED, PENDING_LAYERS = range(4, 8)
STEPS, MAZE, FINAL_STEPS, FINAL_MAZE, CLOCK_LAYERS = range(5)
EPSILON, NEXT_EPSILON, RETURNS, COLLECTED_GOALS, EPISODE_RETURNS, REAL_LAYERS = range(6)
SLIP, NEXT_SLIP = REAL_LAYERS, REAL_LAYERS + 1  # only in tasks with slips
ENDED_BY_RULE, ENDED_BY_TIME, FLAG_LAYERS = range(3)
AFTER, CAPTORS, TAKERS, CAUGHT, TARGET, SEARCH_DISTANCE, SEARCH_QUEUE, SCRATCH_LAYERS = range(8)
FIRST_CELL, NUM_CELLS, TABLE, START_MARK, DIRECTED, NUM_GOAL_MARKS, GOAL_MARKS = range(7)
ROW, COLUMN, MARK_DISTANCE, MOVES, FACT_LAYERS = range(5)


class World(NamedTuple):
    """Concatenated arrays of all mazes, made by `pursuit.mazes.maze_arrays.lay_out`.

    mazes: [GOAL_MARKS + marks, mazes] int64. Row FIRST_CELL: cell c of the maze has the index
        FIRST_CELL + c; TABLE: the index of its distances in `tables`, -1 if it is too large for a
        table; START_MARK and, from GOAL_MARKS on, the goal marks: cells, or -1; DIRECTED: 1 for a
        graph in which a path back can have another length.
    neighbors: [all cells, moves + 1] int32, the cell after each move, and after stay.
    facts: [FACT_LAYERS, all cells] int32. ROW, COLUMN; MARK_DISTANCE: steps to the nearest goal
        mark; MOVES: the bit mask of the moves that change the cell.
    tables: uint16, the distances from every cell to every other, maze after maze.
    """

    mazes: Longs
    neighbors: Ints
    facts: Ints
    tables: NDArray[np.uint16]


class Games(NamedTuple):
    """A batch of games, int32.

    position: [games, agents], cells; a captured evader stays in the cell of its capture.
    active: [games, agents], 1, or 0 after capture or escape.
    event: [games, agents], the last step's events: a sum of COLLECTED, CAPTURED, WAS_CAPTURED,
        ESCAPED (of an evader that escapes, and of all chasers then).
    goal: [games, goals], cells; -1 when collected or absent.
    steps: [games], steps of this episode.
    maze: [games], index of the maze.
    exit: [games, exits], cells; -1 when absent.
    """

    position: Ints
    active: Ints
    event: Ints
    goal: Ints
    steps: Ints
    maze: Ints
    exit: Ints


class NextEpisode(NamedTuple):
    """Pending settings of the next episode, [games] int32; -1 is "no limit", or "drawn".

    epsilon: [games, agents] float64, the probability of random moves; NaN uses the agent's own, and
        UNCHANGED keeps the present one. It is UNCHANGED after the start of an episode.
    """

    maze: Ints
    num_goals: Ints
    goal_radius: Ints
    goals_around_marks: Ints
    min_start_distance: Ints
    max_start_distance: Ints
    epsilon: Reals


class Outcome(NamedTuple):
    """The results of steps.

    rewards: [games, agents] float32, of the last step.
    returns: [games, agents] float64, of the episode so far.
    collected: [games, agents] float64, goals collected in it so far; shared goals in parts.
    terminated, truncated: [games] bool, of the last step.
    episode_returns: [games, agents] float64, of the last finished episode.
    final: the last state of the last finished episode.
    """

    rewards: NDArray[np.floating]
    returns: Reals
    collected: Reals
    terminated: Flags
    truncated: Flags
    episode_returns: Reals
    final: Games


class Search(NamedTuple):
    """Scratch memory of a search, [cells] int32; `distance` is -1 everywhere between searches."""

    distance: Ints
    queue: Ints


class Memory(NamedTuple):
    """The flat arrays of a batch, with the layers named above; created by `allocate`.

    The data of one game is adjacent, so that a step needs few addresses and registers.

    agents: [games, AGENT_LAYERS, agents] int32.
    goals: [games, GOAL_LAYERS, goals] int32.
    clocks: [games, CLOCK_LAYERS + 2 * exits] int32: the clocks, the exits, the final exits.
    pending: [PENDING_LAYERS, games] int32, the fields of NextEpisode except epsilon; in row
        LISTED the games that end in this step, or are to start (`batches.start_games`), then -1.
    reals: [games, REAL_LAYERS, agents] float64; with slips two more layers.
    flags: [FLAG_LAYERS, games] bool.
    rewards: [games, agents] float32.
    streams: [games, 1 + agents + 1] uint64, of random numbers; with slips one more.
    """

    agents: Ints
    goals: Ints
    clocks: Ints
    pending: Ints
    reals: Reals
    flags: Flags
    rewards: NDArray[np.float32]
    streams: Words


def allocate(
    num_games: int, num_agents: int, num_goals: int, num_exits: int = 0, slips: bool = False
) -> Memory:
    """Memory of a batch of games before their first episode."""
    reals = np.zeros((num_games, REAL_LAYERS + 2 * slips, num_agents))
    reals[:, EPSILON], reals[:, NEXT_EPSILON] = np.nan, UNCHANGED
    reals[:, NEXT_SLIP:] = UNCHANGED
    return Memory(
        agents=np.zeros((num_games, AGENT_LAYERS, num_agents), dtype=np.int32),
        goals=np.zeros((num_games, GOAL_LAYERS, num_goals), dtype=np.int32),
        clocks=np.zeros((num_games, CLOCK_LAYERS + 2 * num_exits), dtype=np.int32),
        pending=np.full((PENDING_LAYERS, num_games), -1, dtype=np.int32),
        reals=reals,
        flags=np.zeros((FLAG_LAYERS, num_games), dtype=bool),
        rewards=np.zeros((num_games, num_agents), dtype=np.float32),
        streams=np.zeros((num_games, 1 + num_agents + 1 + slips), dtype=np.uint64),
    )


def empty_games(num_games: int, num_agents: int, num_goals: int, num_exits: int = 0) -> Games:
    """Games without active agents, with all arrays 0."""
    return named_views(games_of, allocate(num_games, num_agents, num_goals, num_exits))


def copied_games(games: Games, chosen: Any) -> Games:
    """Copies of the chosen games, in memory like that of a batch, as a kernel is compiled again for
    arrays of another layout."""
    parts = [array[chosen] for array in games]
    sizes = (parts[array].shape[1] for array in (0, 3, 6))
    own = empty_games(len(parts[0]), *sizes)
    for array, part in zip(own, parts, strict=True):
        array[:] = part
    return own


def scratch_for(num_cells: int, num_agents: int, num_goals: int) -> Ints:
    """Scratch memory of the step of one game and of a search over `num_cells` cells.

    The decisions of a step before the state is written: AFTER, the cells of the agents after it;
    CAPTORS, the number of captors of an evader, -1 if it escapes; TAKERS, the number of agents that
    collect a goal; CAUGHT, the captured evaders, in order; TARGET, the cells that agents move to
    unless another agent is in the way.
    """
    return np.full((SCRATCH_LAYERS, max(num_cells, num_agents, num_goals)), -1, dtype=np.int32)


def named_views(naming: Any, *arrays: Any) -> Any:
    """The result of one of the functions below, outside kernels: views of the arrays."""
    return getattr(naming, "py_func", naming)(*arrays)  # some are no kernels


# -- names for the layers --------------------------------------------------------------------------


@inlined
def games_of(memory: Memory) -> Games:
    """The current state of the games."""
    agents, clocks = memory.agents, memory.clocks
    return Games(
        agents[:, POSITION], agents[:, ACTIVE], agents[:, EVENT], memory.goals[:, GOAL],
        clocks[:, STEPS], clocks[:, MAZE],
        clocks[:, CLOCK_LAYERS : (CLOCK_LAYERS + clocks.shape[1]) // 2],
    )  # fmt: skip


def outcome_of(memory: Memory) -> Outcome:
    """The results of steps."""
    agents, clocks, reals, flags = memory.agents, memory.clocks, memory.reals, memory.flags
    final = Games(
        agents[:, FINAL_POSITION], agents[:, FINAL_ACTIVE], agents[:, FINAL_EVENT],
        memory.goals[:, FINAL_GOAL], clocks[:, FINAL_STEPS], clocks[:, FINAL_MAZE],
        clocks[:, (CLOCK_LAYERS + clocks.shape[1]) // 2 :],
    )  # fmt: skip
    return Outcome(
        memory.rewards, reals[:, RETURNS], reals[:, COLLECTED_GOALS], flags[ENDED_BY_RULE],
        flags[ENDED_BY_TIME], reals[:, EPISODE_RETURNS], final,
    )  # fmt: skip


def next_episode_of(memory: Memory) -> NextEpisode:
    """The pending settings of the next episode."""
    epsilon = memory.reals[:, NEXT_EPSILON]
    return NextEpisode(*memory.pending[:LISTED], epsilon)  # type: ignore[call-arg]


@inlined
def stay_of(neighbors: Ints) -> int:
    """The number of the action stay, which is the number of moves."""
    return neighbors.shape[1] - 1


@inlined
def search_of(scratch: Ints) -> Search:
    """The scratch memory of searches."""
    return Search(scratch[SEARCH_DISTANCE], scratch[SEARCH_QUEUE])


# -- agent indices ---------------------------------------------------------------------------------


@inlined
def agents_of(teams: Teams) -> range:
    """All agents."""
    return range(teams.chasers + teams.evaders + teams.runners)


@inlined
def chasers_of(teams: Teams) -> range:
    """The chasers, which come first."""
    return range(teams.chasers)


@inlined
def evaders_of(teams: Teams) -> range:
    """The evaders, after the chasers."""
    return range(teams.chasers, teams.chasers + teams.evaders)


@inlined
def runners_of(teams: Teams) -> range:
    """The runners, which come last."""
    return range(teams.chasers + teams.evaders, teams.chasers + teams.evaders + teams.runners)


@inlined
def goals_of(teams: Teams) -> range:
    """All goals."""
    return range(teams.goals)


@inlined
def collectors_of(teams: Teams) -> range:
    """The agents that collect goals: evaders and runners."""
    return range(teams.chasers, teams.chasers + teams.evaders + teams.runners)


@inlined
def bit_of(number: int) -> np.uint64:
    """The bit of a cell or agent in a 64-bit word; numbers 64 apart share a bit."""
    return np.uint64(1) << (np.uint64(number) & np.uint64(63))


STARTS_STREAM = 0
"""The random stream of starts; it is followed by one for each agent, and by one for teams that draw
joint actions."""


@inlined
def stream_of(seat: int) -> int:
    """The index of the random stream of the policy of an agent."""
    return STARTS_STREAM + 1 + seat


@inlined
def team_stream(num_agents: int) -> int:
    """The index of the stream of a team; it advances only at the start of an episode."""
    return STARTS_STREAM + 1 + num_agents


@inlined
def slip_stream(num_agents: int) -> int:
    """The index of the stream of slips, in tasks that have them."""
    return team_stream(num_agents) + 1
