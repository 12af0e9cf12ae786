"""Batches: the two compiled entries that the `Simulator` calls, `step_games` and `start_games`.

They take flat arrays (see `layout.Memory`, `layout.world_of`, `layout.rules_of`); nothing below
them does. The one general step is compiled three times: as it stands, for a duel and for a runner
alone, whose teams are constants there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled, inlined
from pursuit.rules.layout import (
    BAD_ACTION,
    EPSILON,
    GOING_ON,
    NO_PLACEMENT,
    OK,
    TERMINATED,
    TRUNCATED,
    Games,
    Memory,
    Outcome,
    Rules,
    Teams,
    World,
    agents_of,
    games_of,
    goals_of,
    next_episode_of,
    outcome_of,
    plan_of,
    rules_of,
    search_of,
    teams_of,
    world_of,
)
from pursuit.rules.starts import start
from pursuit.rules.step import step


@inlined
def keep_final(games: Games, game: int, teams: Teams, outcome: Outcome) -> None:
    """Keep what an episode ended with."""
    final = outcome.final
    final.steps[game], final.maze[game] = games.steps[game], games.maze[game]
    for agent in agents_of(teams):
        final.position[game, agent] = games.position[game, agent]
        final.active[game, agent] = games.active[game, agent]
        final.event[game, agent] = games.event[game, agent]
        outcome.episode_returns[game, agent] = outcome.returns[game, agent]
    for goal in goals_of(teams):
        final.goal[game, goal] = games.goal[game, goal]


@inlined
def start_game(memory: Memory, game: int, rules: Rules, world: World, scratch: Any) -> bool:
    """Begin an episode of one game with the settings that waited for it."""
    outcome, coming = outcome_of(memory), next_episode_of(memory)
    epsilon = memory.reals[EPSILON]
    for agent in agents_of(rules.teams):
        outcome.returns[game, agent] = 0.0
        epsilon[game, agent] = coming.epsilon[game, agent]
    return start(games_of(memory), game, memory.streams, coming, rules, world, search_of(scratch))


@inlined
def fits(memory: Memory, actions: Any, teams: Teams) -> bool:
    """Whether the arrays are those of these teams; it also tells the compiler their width."""
    num_agents = teams.chasers + teams.evaders + teams.runners
    if memory.agents.shape[2] != num_agents or memory.reals.shape[2] != num_agents:
        return False
    return memory.rewards.shape[1] == num_agents and actions.shape[1] == num_agents


@inlined
def step_each(
    memory: Memory, actions: Any, rules: Rules, world: World, scratch: Any, skip_ended: bool
) -> int:
    """Move every game by one step, or every game that goes on; OK or BAD_ACTION (of what shape)."""
    if not fits(memory, actions, rules.teams):
        return BAD_ACTION
    games, outcome, plan = games_of(memory), outcome_of(memory), plan_of(scratch)
    for game in range(actions.shape[0]):
        if skip_ended and (outcome.terminated[game] or outcome.truncated[game]):
            for agent in agents_of(rules.teams):
                outcome.rewards[game, agent] = 0.0
            continue
        end = step(games, game, actions, rules, world, plan, outcome)
        outcome.terminated[game] = end == TERMINATED
        outcome.truncated[game] = end == TRUNCATED
        if end != GOING_ON:
            keep_final(games, game, rules.teams, outcome)
    return OK


@compiled
def step_games(
    agents: Any,
    goals: Any,
    clocks: Any,
    coming: Any,
    reals: Any,
    flags: Any,
    rewards: Any,
    streams: Any,
    numbers: Any,
    pay: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    scratch: Any,
    actions: Any,
    auto_restart: bool,
) -> int:
    """Move every game by one step, in place; OK, BAD_ACTION (nothing moved) or NO_PLACEMENT.

    A game that ends is kept as final and, with `auto_restart`, begins anew at once; without, it
    stays as it is and earns nothing.
    """
    memory = Memory(agents, goals, clocks, coming, reals, flags, rewards, streams)
    teams, world = teams_of(numbers), world_of(mazes, neighbors, facts, tables)
    rules = rules_of(teams, numbers, pay)
    most = np.uint32(0)
    for action in actions.flat:
        most = max(most, np.uint32(action))
    if most >= rules.num_actions:
        return BAD_ACTION
    if teams == Teams(1, 1, 0, 0):
        duel = rules_of(Teams(1, 1, 0, 0), numbers, pay)
        done = step_each(memory, actions, duel, world, scratch, not auto_restart)
    elif teams == Teams(0, 0, 1, teams.goals):
        alone = rules_of(Teams(0, 0, 1, teams.goals), numbers, pay)
        done = step_each(memory, actions, alone, world, scratch, not auto_restart)
    else:
        done = step_each(memory, actions, rules, world, scratch, not auto_restart)
    if done != OK or not auto_restart:
        return done
    outcome = outcome_of(memory)
    for game in range(actions.shape[0]):
        ended = outcome.terminated[game] | outcome.truncated[game]
        if ended and not start_game(memory, game, rules, world, scratch):
            return NO_PLACEMENT
    return OK


@compiled
def start_games(
    agents: Any,
    goals: Any,
    clocks: Any,
    coming: Any,
    reals: Any,
    flags: Any,
    rewards: Any,
    streams: Any,
    numbers: Any,
    pay: Any,
    mazes: Any,
    neighbors: Any,
    facts: Any,
    tables: Any,
    scratch: Any,
    chosen: Any,
) -> int:
    """Begin a new episode in every game where `chosen`; OK or NO_PLACEMENT."""
    memory = Memory(agents, goals, clocks, coming, reals, flags, rewards, streams)
    rules = rules_of(teams_of(numbers), numbers, pay)
    world = world_of(mazes, neighbors, facts, tables)
    outcome = outcome_of(memory)
    for game in range(chosen.shape[0]):
        if chosen[game]:
            if not start_game(memory, game, rules, world, scratch):
                return NO_PLACEMENT
            outcome.terminated[game] = outcome.truncated[game] = False
    return OK
