"""The step of one game with the options of the rules: slips, collisions, captures, exits.

A *phase* is the move of some agents at once: of all of them, or with `chasers_first` of the chasers
and then of all others. With turns a step has only one of the two phases. `plan.after` holds the
cells as far as the moves are decided.
"""

from __future__ import annotations

import numpy as np

from pursuit.compilation.compiled import inlined, subroutine
from pursuit.rules.arrays import Ints, Words
from pursuit.rules.distances import place_of
from pursuit.rules.layout import (
    ACTIVE,
    AFTER,
    CAPTORS,
    CAUGHT,
    CELL,
    CLOCK_LAYERS,
    MOVES,
    POSITION,
    SLIP,
    STEPS,
    SURROUND,
    TARGET,
    agents_of,
    chasers_of,
    evaders_of,
    slip_stream,
    stay_of,
)
from pursuit.rules.randomness import draw_action
from pursuit.rules.starts import is_exit
from pursuit.rules.step import settle
from pursuit.rules.step_rewards import Earned
from pursuit.rules.turn import Goals, Turn, destination, is_free, meets_evader


@inlined
def step_with_options(
    turn: Turn, goals: Goals, actions: Ints, streams: Words, rewards: Earned
) -> int:
    """Step one game; arguments and result as of `step.step`. Slips are drawn from their stream."""
    rules, plan = turn.rules, turn.plan
    options, chasers = rules.options, rules.teams.chasers
    agents = chasers + rules.teams.evaders + rules.teams.runners
    chasers_to_move = not options.turns or (turn.clocks[STEPS] & 1) == 0
    others_to_move = not options.turns or (turn.clocks[STEPS] & 1) == 1
    for agent in agents_of(rules.teams):
        cell = turn.agents[POSITION, agent]
        plan[AFTER, agent], plan[TARGET, agent], plan[CAPTORS, agent] = cell, cell, 0
        moves = chasers_to_move if agent < chasers else others_to_move
        if moves and turn.agents[ACTIVE, agent] != 0:
            action = np.int64(actions[agent])
            if options.slips:
                action = slipped(turn, agent, action, streams)
            plan[TARGET, agent] = destination(turn, agent, action)
    num_captured = 0
    if not rules.chasers_first:
        move_together(turn, 0, agents)
        num_captured = capture_evaders(turn, num_captured)
    else:
        if chasers_to_move:
            move_together(turn, 0, chasers)
            num_captured = capture_evaders(turn, num_captured)
        if others_to_move:
            move_together(turn, chasers, agents)
            if options.recheck:
                num_captured = capture_evaders(turn, num_captured)
    num_escaped = 0
    for evader in evaders_of(rules.teams):
        stays_in_game = is_free(turn.agents, evader) != 0 and plan[CAPTORS, evader] == 0
        if stays_in_game and is_exit(
            turn.clocks[CLOCK_LAYERS:], plan[AFTER, evader], options.exits
        ):
            plan[CAPTORS, evader] = -1
            num_escaped += 1
    return settle(turn, goals, rewards, num_captured, num_escaped)


@inlined
def slipped(turn: Turn, agent: int, action: int, streams: Words) -> int:
    """The action, or with the chance of a slip any move that changes the cell."""
    chance = turn.reals[SLIP, agent]
    cell = turn.agents[POSITION, agent]
    every = np.int64(turn.facts[MOVES, place_of(turn.first_cell, cell)])
    stream = slip_stream(turn.agents.shape[1])
    if every == 0:
        return action
    return draw_action(1 << action, every, chance, 0, False, streams, stream)


# -- collisions ------------------------------------------------------------------------------------


@subroutine
def move_together(turn: Turn, first: int, last: int) -> None:
    """Decide on the moves of the agents from `first` to `last` - 1, which move at once."""
    plan = turn.plan
    for agent in range(first, last):
        if plan[CAPTORS, agent] > 0:
            continue
        if not turn.rules.options.block or not is_blocked(turn, agent, first, last):
            plan[AFTER, agent] = plan[TARGET, agent]


@inlined
def is_blocked(turn: Turn, agent: int, first: int, last: int) -> bool:
    """Whether a solid agent was in the target of an agent before the phase, or has this target."""
    plan, cells = turn.plan, turn.agents[POSITION]
    target = plan[TARGET, agent]
    if target == cells[agent]:
        return False
    for other in agents_of(turn.rules.teams):
        if other == agent or not is_solid(turn, agent, other):
            continue
        moves = first <= other < last
        if (cells[other] if moves else plan[AFTER, other]) == target:
            return True
        if moves and plan[TARGET, other] == target:
            return True
    return False


@inlined
def is_solid(turn: Turn, agent: int, other: int) -> bool:
    """Whether an agent cannot enter the cell of another one.

    That are agents of one role, and, where they do not capture in one cell, chasers and evaders;
    not evaders that have left the game.
    """
    if turn.agents[ACTIVE, other] == 0 or turn.plan[CAPTORS, other] > 0:
        return False
    own, its = role_of(turn, agent), role_of(turn, other)
    return own == its or (own + its == 1 and turn.rules.options.capture != CELL)


@inlined
def role_of(turn: Turn, agent: int) -> int:
    """CHASER, EVADER or RUNNER: 0, 1 or 2."""
    chasers, evaders = turn.rules.teams.chasers, turn.rules.teams.evaders
    return np.int64(agent >= chasers) + np.int64(agent >= chasers + evaders)


# -- captures --------------------------------------------------------------------------------------


@subroutine
def capture_evaders(turn: Turn, num_captured: int) -> int:
    """Count the captors of the evaders that are captured by the present cells, and list these
    evaders after the first `num_captured`; return their number."""
    plan, options = turn.plan, turn.rules.options
    for evader in evaders_of(turn.rules.teams):
        if is_free(turn.agents, evader) == 0 or plan[CAPTORS, evader] > 0:
            continue
        captors = 0
        for chaser in chasers_of(turn.rules.teams):
            captors += meets_evader(turn, chaser, evader)
        if captors >= options.n_catch and (
            options.capture != SURROUND or is_surrounded(turn, plan[AFTER, evader])
        ):
            plan[CAPTORS, evader] = captors
            plan[CAUGHT, num_captured] = evader
            num_captured += 1
    return num_captured


@inlined
def is_surrounded(turn: Turn, cell: int) -> bool:
    """Whether every cell that a move leads to from `cell` holds a chaser."""
    first, plan = turn.first_cell, turn.plan
    for action in range(stay_of(turn.neighbors)):
        after = turn.neighbors[first + cell, action]
        held = after == cell
        for chaser in chasers_of(turn.rules.teams):
            held |= plan[AFTER, chaser] == after
        if not held:
            return False
    return True
