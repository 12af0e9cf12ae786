"""The compiled functions that the `Simulator` calls to start and to step batches of games.

They take flat arrays (see `layout.Memory`, `layout.World`, `layout.step_rules_of`); functions
called by them take NamedTuples, with few arrays in each, as the time of compilation grows with
these. The step without options of the rules is compiled for any teams and, with constant team
sizes, for small teams of chasers and evaders and for a single runner; the step with options for any
teams. Each is a separate function, compiled on first use, as a joint function would need more
registers.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined, subroutine
from pursuit.rules.arrays import Flags, Ints, Longs, Reals, Words
from pursuit.rules.layout import (
    ACTIVE,
    AGENT_LAYERS,
    BAD_ACTION,
    CLOCK_LAYERS,
    COLLECTED_GOALS,
    ENDED_BY_RULE,
    ENDED_BY_TIME,
    EPISODE_RETURNS,
    EPSILON,
    EVENT,
    FINAL_ACTIVE,
    FINAL_EVENT,
    FINAL_GOAL,
    FINAL_MAZE,
    FINAL_POSITION,
    FINAL_STEPS,
    GOAL,
    GOING_ON,
    LISTED,
    MAZE,
    NEXT_EPSILON,
    NEXT_SLIP,
    NO_RESTART,
    OK,
    PLAIN,
    POSITION,
    REAL_LAYERS,
    RETURNS,
    SLIP,
    START,
    STEPS,
    TERMINATED,
    TRUNCATED,
    UNCHANGED,
    Memory,
    Options,
    StartRules,
    StepRules,
    Teams,
    World,
    agents_of,
    goals_of,
    no_options,
    options_of,
    search_of,
    start_rules_of,
    step_rules_of,
    teams_of,
)
from pursuit.rules.option_step import step_with_options
from pursuit.rules.starts import Start, start
from pursuit.rules.step import step, step_runners
from pursuit.rules.turn import goals_of_game, turn_of

MOST_KNOWN = 8
"""The largest number of chasers or evaders for which constant team sizes are compiled."""


@inlined
def keep_final(memory: Memory, game: int, teams: Teams, num_exits: int) -> None:
    """Copy the state and the returns at the end of an episode."""
    agents, goals, clocks, reals = memory.agents, memory.goals, memory.clocks, memory.reals
    clocks[game, FINAL_STEPS], clocks[game, FINAL_MAZE] = clocks[game, STEPS], clocks[game, MAZE]
    for agent in agents_of(teams):
        agents[game, FINAL_POSITION, agent] = agents[game, POSITION, agent]
        agents[game, FINAL_ACTIVE, agent] = agents[game, ACTIVE, agent]
        agents[game, FINAL_EVENT, agent] = agents[game, EVENT, agent]
        reals[game, EPISODE_RETURNS, agent] = reals[game, RETURNS, agent]
    for goal in goals_of(teams):
        goals[game, FINAL_GOAL, goal] = goals[game, GOAL, goal]
    for number in range(CLOCK_LAYERS, CLOCK_LAYERS + num_exits):
        clocks[game, num_exits + number] = clocks[game, number]


@inlined
def start_game(
    memory: Memory, goals: Any, game: int, rules: StartRules, world: World, scratch: Ints
) -> None:
    """Start an episode of one game with its pending settings."""
    reals = memory.reals
    for agent in agents_of(rules.teams):
        reals[game, RETURNS, agent] = reals[game, COLLECTED_GOALS, agent] = 0.0
        if reals[game, NEXT_EPSILON, agent] != UNCHANGED:
            reals[game, EPSILON, agent] = reals[game, NEXT_EPSILON, agent]
            reals[game, NEXT_EPSILON, agent] = UNCHANGED
        if rules.slips and reals[game, NEXT_SLIP, agent] != UNCHANGED:
            reals[game, SLIP, agent] = reals[game, NEXT_SLIP, agent]
            reals[game, NEXT_SLIP, agent] = UNCHANGED
    own = Start(
        memory.agents[game], memory.goals[game], memory.clocks[game], memory.streams[game],
        memory.pending[:, game], rules, world, search_of(scratch),
    )  # fmt: skip
    start(own, goals)


def finish_for(options_in: Any) -> Any:
    """The end of a step, for rules whose options `options_in` reads from `numbers`."""

    @subroutine
    def finish_episodes(
        memory: Memory, goals: Any, numbers: Longs, world: World, scratch: Ints, mode: int
    ) -> None:
        """Copy the last state of the games listed, and restart them with RESTART; with START only
        start them."""
        rules, listed = start_rules_of(numbers, options_in(numbers)), memory.pending[LISTED]
        by_rule, by_time = memory.flags[ENDED_BY_RULE], memory.flags[ENDED_BY_TIME]
        for game in listed:
            if game < 0:
                break
            if mode == START:
                by_rule[game] = by_time[game] = False
            else:
                keep_final(memory, game, rules.teams, rules.exits)
            if mode != NO_RESTART:
                start_game(memory, goals, game, rules, world, scratch)

    return finish_episodes


finish_plainly, finish_with_options = finish_for(no_options), finish_for(options_of)


@inlined
def fits(memory: Memory, actions: Ints, teams: Teams) -> bool:
    """Whether the arrays have the shapes of these teams without options, which also lets the
    compiler assume them.

    The compiler uses the branches and the constant item sizes; the item size of an array itself is
    not a constant.
    """
    num_agents = teams.chasers + teams.evaders + teams.runners
    agents, reals, clocks = memory.agents, memory.reals, memory.clocks
    if actions.shape[1] != num_agents or memory.rewards.shape[1] != num_agents:
        return False
    if agents.shape[2] != num_agents or reals.shape[2] != num_agents:
        return False
    if not is_contiguous(agents.strides, AGENT_LAYERS, num_agents, 4):
        return False
    if not is_contiguous(reals.strides, REAL_LAYERS, num_agents, 8):
        return False
    return clocks.strides[0] == CLOCK_LAYERS * 4 and clocks.strides[1] == 4


@inlined
def is_contiguous(strides: tuple[int, ...], layers: int, width: int, size: int) -> bool:
    """Whether an array [games, layers, width] of items of this size is contiguous."""
    row = width * size
    if strides[0] != layers * row or strides[1] != row or strides[2] != size:  # noqa: SIM103
        return False
    return True


@inlined
def natural(number: int) -> int:
    """The number, in a form that the compiler knows not to be negative: it checks no indices."""
    return np.int64(np.uint32(number))


@inlined
def all_allowed(actions: Ints, num_actions: int) -> bool:
    """Whether every action is in range."""
    most = np.uint32(0)
    for action in actions.flat:
        most = max(most, np.uint32(action))
    return most < num_actions


def step_each_by(step_once: Any) -> Any:
    """The loop over the games of a batch of `step`, `step_runners` or `step_with_options`.

    It cannot be their argument, as kernels that pass functions are not kept on disk.
    """

    @inlined
    def step_each(
        memory: Memory, goals: Any, actions: Ints, rules: StepRules, world: World,
        scratch: Ints, skip_ended: bool,
    ) -> None:  # fmt: skip
        """Step every game, or every game that has not ended if `skip_ended`; list those that end,
        without branches, as the processor could not predict them."""
        by_rule, by_time = memory.flags[ENDED_BY_RULE], memory.flags[ENDED_BY_TIME]
        listed, ended = memory.pending[LISTED], np.uint64(0)
        for number in range(actions.shape[0]):
            game = np.uint64(number)  # signed indices are checked for negative values
            if skip_ended and (by_rule[game] or by_time[game]):
                for agent in agents_of(rules.teams):
                    memory.rewards[game, agent] = 0.0
                continue
            turn = turn_of(memory, game, rules, world, scratch)
            end = step_once(
                turn, goals_of_game(memory, game, goals), actions[game], memory.streams[game],
                memory.rewards[game],
            )  # fmt: skip
            by_rule[game], by_time[game] = end == TERMINATED, end == TRUNCATED
            listed[ended] = game
            ended += np.uint64(end != GOING_ON)
        if ended < listed.shape[0]:
            listed[ended] = -1

    return step_each


step_each_plainly, step_each_with_options = step_each_by(step), step_each_by(step_with_options)
step_each_runner = step_each_by(step_runners)


@cache
def entry_for(chasers: int, evaders: int, runners: int, goals: int, plain: bool) -> Any:
    """The compiled step for these teams; a size of -1 is read from `numbers`.

    So are the options of the rules, unless there are none (`plain`).
    """
    chased = (chasers, evaders) != (0, 0)

    @compiled
    def step_games(
        agents: Ints, goals_: Ints, clocks: Ints, pending: Ints, reals: Reals, flags: Flags,
        rewards: NDArray[np.float32], streams: Words, numbers: Longs, coefficients: Reals,
        mazes: Longs, neighbors: Ints, facts: Ints, tables: NDArray[np.uint16], scratch: Ints,
        actions: Ints, mode: int,
    ) -> int:  # fmt: skip
        """Step every game in place; return OK, or BAD_ACTION without a step.

        The last state of a game that ends is copied. With the mode RESTART the game restarts in the
        same step; with NO_RESTART it stays as it is and gets rewards of 0. See `start_games` for
        START.
        """
        memory = Memory(agents, goals_, clocks, pending, reals, flags, rewards, streams)
        world = World(mazes, neighbors, facts, tables)
        found = teams_of(numbers)
        teams = Teams(
            chasers if chasers >= 0 else natural(found.chasers),
            evaders if evaders >= 0 else natural(found.evaders),
            runners if runners >= 0 else natural(found.runners),
            goals if goals >= 0 else found.goals,
        )
        options = PLAIN if plain else options_of(numbers)
        rules = step_rules_of(teams, numbers, coefficients, options)
        if not all_allowed(actions, rules.num_actions):
            return BAD_ACTION
        if plain and not fits(memory, actions, teams):
            return BAD_ACTION
        # Conditions on constants: only one side is compiled.
        own_goals = None if goals == 0 else memory.goals
        skip_ended = mode == NO_RESTART
        if plain:
            if chased and mode != START:
                step_each_plainly(memory, own_goals, actions, rules, world, scratch, skip_ended)
            elif mode != START:
                step_each_runner(memory, own_goals, actions, rules, world, scratch, skip_ended)
            finish_plainly(memory, own_goals, numbers, world, scratch, mode)
        else:
            if mode != START:
                step_each_with_options(
                    memory, own_goals, actions, rules, world, scratch, skip_ended
                )
            finish_with_options(memory, own_goals, numbers, world, scratch, mode)
        return OK

    return step_games


def step_games_of(teams: Teams, options: Options) -> Any:
    """The fastest step function for these teams and options, compiled on its first call."""
    goals = 0 if teams.goals == 0 else -1
    if options != PLAIN:
        return entry_for(-1, -1, -1, goals, False)
    if teams[:3] == (0, 0, 1):
        return entry_for(0, 0, 1, -1, True)
    small = 0 < teams.chasers <= MOST_KNOWN and 0 < teams.evaders <= MOST_KNOWN
    known = small and teams[2:] == (0, 0)
    return entry_for(*teams, True) if known else entry_for(-1, -1, -1, goals, True)


def start_games(step_games: Any, arrays: Sequence[Any], chosen: Flags) -> None:
    """Start a new episode in every game of the mask `chosen` [games].

    `step_games` is the step function of these games and `arrays` are its arguments before the
    actions. It starts games too, as a function of its own would take as long to compile.
    """
    memory = Memory(*arrays[: len(Memory._fields)])
    games, listed = np.flatnonzero(chosen), memory.pending[LISTED]
    listed[: len(games)], listed[len(games) :] = games, -1
    step_games(*arrays, np.empty((0, memory.rewards.shape[1]), dtype=np.int32), START)
