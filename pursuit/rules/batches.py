"""The compiled functions that the `Simulator` calls to start and to step batches of games.

They take flat arrays (see `layout.Memory`, `layout.world_of`, `layout.rules_of`); functions called
by them take NamedTuples. The step without options of the rules is compiled for any teams and, with
constant team sizes, for small teams of chasers and evaders and for a single runner; the step with
options for any teams. Each is a separate function, compiled on first use, as a joint function would
need more registers.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined, subroutine
from pursuit.rules.arrays import Flags, Ints, Longs, Reals, Words
from pursuit.rules.layout import (
    AGENT_LAYERS,
    BAD_ACTION,
    CLOCK_LAYERS,
    EPSILON,
    NEXT_SLIP,
    OK,
    PLAIN,
    REAL_LAYERS,
    SLIP,
    TERMINATED,
    TRUNCATED,
    UNCHANGED,
    Games,
    Memory,
    Options,
    Outcome,
    StepRules,
    Teams,
    World,
    agents_of,
    games_of,
    goals_of,
    next_episode_of,
    options_of,
    outcome_of,
    search_of,
    step_rules_of,
    step_scratch_of,
    teams_of,
    world_of,
)
from pursuit.rules.option_step import step_with_options
from pursuit.rules.starts import Start, start
from pursuit.rules.step import step

MOST_KNOWN = 8
"""The largest number of chasers or evaders for which constant team sizes are compiled."""


@inlined
def keep_final(games: Games, game: int, teams: Teams, num_exits: int, outcome: Outcome) -> None:
    """Copy the last state of an episode to `outcome.final`."""
    final = outcome.final
    final.steps[game], final.maze[game] = games.steps[game], games.maze[game]
    for agent in agents_of(teams):
        final.position[game, agent] = games.position[game, agent]
        final.active[game, agent] = games.active[game, agent]
        final.event[game, agent] = games.event[game, agent]
        outcome.episode_returns[game, agent] = outcome.returns[game, agent]
    for goal in goals_of(teams):
        final.goal[game, goal] = games.goal[game, goal]
    for number in range(num_exits):
        final.exit[game, number] = games.exit[game, number]


@inlined
def start_game(memory: Memory, game: int, rules: StepRules, world: World, scratch: Ints) -> None:
    """Start an episode of one game with its pending settings."""
    outcome, pending = outcome_of(memory), next_episode_of(memory)
    for agent in agents_of(rules.teams):
        outcome.returns[game, agent] = outcome.collected[game, agent] = 0.0
        if pending.epsilon[game, agent] != UNCHANGED:
            memory.reals[game, EPSILON, agent] = pending.epsilon[game, agent]
            pending.epsilon[game, agent] = UNCHANGED
        if rules.options.slips and memory.reals[game, NEXT_SLIP, agent] != UNCHANGED:
            memory.reals[game, SLIP, agent] = memory.reals[game, NEXT_SLIP, agent]
            memory.reals[game, NEXT_SLIP, agent] = UNCHANGED
    streams, search = memory.streams[game], search_of(scratch)
    start(Start(games_of(memory), game, streams, pending, rules, world, search))


@subroutine
def finish_episodes(
    memory: Memory, numbers: Longs, coefficients: Reals, world: World, scratch: Ints, restart: bool
) -> None:
    """Copy the last state of games that ended, and restart them if asked to; without options."""
    rules = step_rules_of(teams_of(numbers), numbers, coefficients, PLAIN)
    finish(memory, rules, world, scratch, restart)


@subroutine
def finish_with_options(
    memory: Memory, numbers: Longs, coefficients: Reals, world: World, scratch: Ints, restart: bool
) -> None:
    """As `finish_episodes`, with the options of the rules."""
    rules = step_rules_of(teams_of(numbers), numbers, coefficients, options_of(numbers))
    finish(memory, rules, world, scratch, restart)


@inlined
def finish(
    memory: Memory, rules: StepRules, world: World, scratch: Ints, auto_restart: bool
) -> None:
    """Copy the last state of games that ended, and restart them if `auto_restart`."""
    games, outcome = games_of(memory), outcome_of(memory)
    for game in range(outcome.terminated.shape[0]):
        if outcome.terminated[game] | outcome.truncated[game]:
            keep_final(games, game, rules.teams, rules.options.exits, outcome)
            if auto_restart:
                start_game(memory, game, rules, world, scratch)


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
def all_allowed(actions: Ints, num_actions: int) -> bool:
    """Whether every action is in range."""
    most = np.uint32(0)
    for action in actions.flat:
        most = max(most, np.uint32(action))
    return most < num_actions


@inlined
def step_each(
    memory: Memory, actions: Ints, rules: StepRules, world: World, scratch: Ints, skip_ended: bool,
    plain: bool,
) -> None:  # fmt: skip
    """Step every game, or every game that has not ended if `skip_ended`.

    `plain`, a constant, promises that the rules have no options.
    """
    games, outcome, plan = games_of(memory), outcome_of(memory), step_scratch_of(scratch)
    for game in range(actions.shape[0]):
        if skip_ended and (outcome.terminated[game] or outcome.truncated[game]):
            for agent in agents_of(rules.teams):
                outcome.rewards[game, agent] = 0.0
            continue
        if plain:
            end = step(games, game, actions, rules, world, plan, outcome)
        else:
            end = step_with_options(games, game, actions, rules, world, plan, outcome, memory)
        outcome.terminated[game] = end == TERMINATED
        outcome.truncated[game] = end == TRUNCATED


@cache
def entry_for(chasers: int, evaders: int, runners: int, goals: int, plain: bool) -> Any:
    """The compiled step for these teams; a size of -1 is read from `numbers`.

    So are the options of the rules, unless there are none (`plain`).
    """

    @compiled
    def step_games(
        agents: Ints, goals_: Ints, clocks: Ints, pending: Ints, reals: Reals, flags: Flags,
        rewards: NDArray[np.float32], streams: Words, numbers: Longs, coefficients: Reals,
        mazes: Longs, neighbors: Ints, facts: Ints, tables: NDArray[np.uint16], scratch: Ints,
        actions: Ints, auto_restart: bool,
    ) -> int:  # fmt: skip
        """Step every game in place; return OK, or BAD_ACTION without a step.

        The last state of a game that ends is copied. With `auto_restart` the game restarts in the
        same step; without it the game stays as it is and gets rewards of 0.
        """
        memory = Memory(agents, goals_, clocks, pending, reals, flags, rewards, streams)
        world = world_of(mazes, neighbors, facts, tables)
        found = teams_of(numbers)
        teams = Teams(
            chasers if chasers >= 0 else found.chasers,
            evaders if evaders >= 0 else found.evaders,
            runners if runners >= 0 else found.runners,
            goals if goals >= 0 else found.goals,
        )
        options = PLAIN if plain else options_of(numbers)
        rules = step_rules_of(teams, numbers, coefficients, options)
        if not all_allowed(actions, rules.num_actions):
            return BAD_ACTION
        if plain and not fits(memory, actions, teams):
            return BAD_ACTION
        step_each(memory, actions, rules, world, scratch, not auto_restart, plain)
        if plain:
            finish_episodes(memory, numbers, coefficients, world, scratch, auto_restart)
        else:
            finish_with_options(memory, numbers, coefficients, world, scratch, auto_restart)
        return OK

    return step_games


step_any = entry_for(-1, -1, -1, -1, True)
step_lone_runners = entry_for(0, 0, 1, -1, True)
step_any_with_options = entry_for(-1, -1, -1, -1, False)


def step_games_of(teams: Teams, options: Options) -> Any:
    """The fastest step function for these teams and options, compiled on its first call."""
    if options != PLAIN:
        return step_any_with_options
    if teams[:3] == (0, 0, 1):
        return step_lone_runners
    small = 0 < teams.chasers <= MOST_KNOWN and 0 < teams.evaders <= MOST_KNOWN
    return entry_for(*teams, True) if small and teams[2:] == (0, 0) else step_any


@compiled
def start_games(
    agents: Ints, goals: Ints, clocks: Ints, pending: Ints, reals: Reals, flags: Flags,
    rewards: NDArray[np.float32], streams: Words, numbers: Longs, coefficients: Reals,
    mazes: Longs, neighbors: Ints, facts: Ints, tables: NDArray[np.uint16], scratch: Ints,
    chosen: Flags,
) -> None:  # fmt: skip
    """Start a new episode in every game of the mask `chosen`."""
    memory = Memory(agents, goals, clocks, pending, reals, flags, rewards, streams)
    rules = step_rules_of(teams_of(numbers), numbers, coefficients, options_of(numbers))
    world = world_of(mazes, neighbors, facts, tables)
    outcome = outcome_of(memory)
    for game in range(chosen.shape[0]):
        if chosen[game]:
            start_game(memory, game, rules, world, scratch)
            outcome.terminated[game] = outcome.truncated[game] = False
