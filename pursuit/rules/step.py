"""The rules of one step of one game: legal moves, step, ended, rewards.

For starts see `starts`, for observations `pursuit.observations.observations`.

All decisions use the state before the step; the new state is written last. Of the values written,
only events and rewards are read again. Loops over `chasers_of(teams)` and the like are unrolled in
kernels with constant team sizes.

                  before            decided                       written
    position      games.position    plan.after                    games.position
    captures                        plan.captors, plan.captured   games.active, games.event
    goals         games.goal        plan.takers                   games.goal, games.event

`step` has no options; `option_step` decides on moves and captures with them. `settle` ends both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Ints
from pursuit.rules.distances import manhattan, place_of
from pursuit.rules.layout import (
    ADJACENT,
    CAPTURED,
    COLLECTED,
    ESCAPED,
    GOING_ON,
    SURROUND,
    TERMINATED,
    TRUNCATED,
    WAS_CAPTURED,
    Games,
    Outcome,
    RewardCoefficients,
    Rules,
    StepScratch,
    World,
    agents_of,
    bit_of,
    chasers_of,
    collectors_of,
    evaders_of,
    goals_of,
    runners_of,
    stay_of,
)


@inlined
def legal_moves(world: World, maze: int, cell: int) -> int:
    """The bit mask of the moves that change the cell."""
    return np.int64(world.moves[place_of(world.first_cell[maze], cell)])


class Turn(NamedTuple):
    """One game of a batch in a step.

    first_cell: the index in the arrays of `world` of the first cell of the game's maze. plan: the
    decisions of the step.
    """

    games: Games
    game: int
    rules: Rules
    world: World
    first_cell: int
    plan: StepScratch
    outcome: Outcome


@inlined
def step(
    games: Games,
    game: int,
    actions: Ints,
    rules: Rules,
    world: World,
    plan: StepScratch,
    outcome: Outcome,
) -> int:
    """Step one game; return GOING_ON, TERMINATED or TRUNCATED."""
    turn = Turn(games, game, rules, world, world.first_cell[games.maze[game]], plan, outcome)
    teams, stay = rules.teams, stay_of(world)
    for chaser in chasers_of(teams):
        plan.after[chaser] = destination(turn, chaser, actions[game, chaser])
    for evader in evaders_of(teams):
        # A captured agent stays; no branch, as the processor could not predict it.
        action = stay + (np.int64(actions[game, evader]) - stay) * is_free(turn, evader)
        plan.after[evader] = destination(turn, evader, action)
    for runner in runners_of(teams):
        plan.after[runner] = destination(turn, runner, actions[game, runner])
    return settle(turn, decide_captures(turn), 0)


@inlined
def settle(turn: Turn, num_captured: int, num_escaped: int) -> int:
    """Collect goals, write rewards and the new state, given the decisions on moves, captures and
    escapes; return as `step`."""
    games, game, rules, plan, outcome = turn.games, turn.game, turn.rules, turn.plan, turn.outcome
    teams, steps = rules.teams, games.steps[game] + 1
    collected, goals_left = decide_goals(turn)
    all_collected = collected > 0 and goals_left == 0
    end = ended(turn, num_captured + num_escaped, all_collected, steps)

    # A round of turns has two steps; its second one pays the step rewards.
    pays = not rules.options.turns or (steps & 1) == 0
    add_step_rewards(turn, pays)
    if num_captured > 0:
        add_capture_rewards(turn, num_captured, end)
    if num_escaped > 0:
        add_escape_rewards(turn, end)
    if collected > 0:
        add_goal_rewards(turn, end)
    if rules.chaser.per_evader != 0.0:
        add_per_evader_rewards(turn, pays)
    if rules.options.touches:
        add_touch_rewards(turn)
    if collected > 0:
        count_goals(turn)
    for agent in agents_of(teams):
        games.position[game, agent] = plan.after[agent]
        outcome.returns[game, agent] += outcome.rewards[game, agent]
    for i in range(num_captured):
        games.active[game, plan.captured[i]] = 0
    if num_escaped > 0:
        for evader in evaders_of(teams):
            if plan.captors[evader] < 0:
                games.active[game, evader] = 0
    if collected > 0:
        for goal in goals_of(teams):
            if plan.takers[goal] > 0:
                games.goal[game, goal] = -1
    games.steps[game] = steps
    return end


# -- decisions -------------------------------------------------------------------------------------


@inlined
def destination(turn: Turn, agent: int, action: int) -> int:
    """The cell that an agent's action leads to."""
    cell = place_of(turn.first_cell, turn.games.position[turn.game, agent])
    return turn.world.neighbors[cell, np.uint64(action)]


@inlined
def meets_evader(turn: Turn, chaser: int, evader: int) -> bool:
    """Whether a chaser meets the condition of the capture rule by the cells after the moves.

    With "surround" that is to stand where a move of the evader leads to; whether this is so of all
    such cells is decided in `option_step`.
    """
    capture, after = turn.rules.options.capture, turn.plan.after
    if capture == SURROUND:
        return leads_to(turn, after[evader], after[chaser])
    if capture == ADJACENT and leads_to(turn, after[chaser], after[evader]):
        return True
    cells = turn.games.position[turn.game]
    swapped = (after[chaser] == cells[evader]) & (after[evader] == cells[chaser])
    return (after[chaser] == after[evader]) | (swapped & (not turn.rules.chasers_first))


@inlined
def leads_to(turn: Turn, cell: int, other: int) -> bool:
    """Whether a move leads from a cell to another one."""
    place, found = place_of(turn.first_cell, cell), False
    for action in range(stay_of(turn.world)):
        found |= turn.world.neighbors[place, action] == other
    return found & (cell != other)


@inlined
def decide_captures(turn: Turn) -> int:
    """Count the captors of every evader and list the captured evaders; return their number.

    If the chasers move first, an evader that one of them reaches does not move. Exact checks are
    made only for evaders that may share a cell with a chaser according to the bits of cells.
    """
    teams, plan, game = turn.rules.teams, turn.plan, turn.game
    position = turn.games.position
    reached = np.uint64(0)
    for chaser in chasers_of(teams):
        reached |= bit_of(plan.after[chaser])
    asked = num_captured = 0
    for evader in evaders_of(teams):
        near = reached & (bit_of(position[game, evader]) | bit_of(plan.after[evader]))
        plan.captors[evader] = 0
        plan.captured[asked] = evader
        asked += (near != 0) * is_free(turn, evader)
    for i in range(asked):
        evader, captors = plan.captured[i], 0
        for chaser in chasers_of(teams):
            if turn.rules.chasers_first and plan.after[chaser] == position[game, evader]:
                plan.after[evader] = position[game, evader]
        for chaser in chasers_of(teams):
            captors += meets_evader(turn, chaser, evader)
        plan.captors[evader] = captors
        plan.captured[num_captured] = evader
        num_captured += captors > 0
    return num_captured


@inlined
def decide_goals(turn: Turn) -> tuple[int, int]:
    """Count the agents on every goal; return the numbers of goals collected and left."""
    teams, plan = turn.rules.teams, turn.plan
    collected = left = 0
    for goal in goals_of(teams):
        takers, cell = 0, turn.games.goal[turn.game, goal]
        if cell >= 0:
            for agent in collectors_of(teams):
                takers += (plan.after[agent] == cell) & may_collect(turn, agent)
            collected += takers > 0
            left += takers == 0
        plan.takers[goal] = takers
    return collected, left


@inlined
def may_collect(turn: Turn, agent: int) -> bool:
    """Whether an agent is a runner, or an evader that is free and stays in the game now."""
    if agent >= turn.rules.teams.chasers + turn.rules.teams.evaders:
        return True
    return (turn.games.active[turn.game, agent] != 0) & (turn.plan.captors[agent] == 0)


@inlined
def ended(turn: Turn, num_gone: int, all_collected: bool, steps: int) -> int:
    """TERMINATED if no evader or no goal is left; else TRUNCATED after the last step.

    `num_gone` evaders are captured or escape now.
    """
    free = -num_gone
    for evader in evaders_of(turn.rules.teams):
        free += is_free(turn, evader)
    if all_collected or (turn.rules.teams.evaders > 0 and free == 0):
        return TERMINATED
    most = turn.rules.max_steps * (2 if turn.rules.options.turns else 1)
    return TRUNCATED if steps >= most else GOING_ON


@inlined
def is_free(turn: Turn, evader: int) -> int:
    """1 if an evader was free before the step, 0 if it had been captured."""
    return np.int64(turn.games.active[turn.game, evader] != 0)


@inlined
def count_goals(turn: Turn) -> None:
    """Add the goals of this step to the goals collected by each agent; shared goals in parts."""
    plan, game = turn.plan, turn.game
    for goal in goals_of(turn.rules.teams):
        for agent in collectors_of(turn.rules.teams):
            here = plan.after[agent] == turn.games.goal[game, goal]
            if plan.takers[goal] > 0 and here and may_collect(turn, agent):
                turn.outcome.collected[game, agent] += 1.0 / plan.takers[goal]


# -- rewards ---------------------------------------------------------------------------------------


@inlined
def add_step_rewards(turn: Turn, pays: bool) -> None:
    """Write the step reward of every agent; 0 for captured evaders, and of all unless `pays`."""
    rules, events, rewards = turn.rules, turn.games.event, turn.outcome.rewards
    real, game = rewards.dtype.type, turn.game  # float32; float64 in exact solvers
    for chaser in chasers_of(rules.teams):
        earned = real(rules.chaser.step)
        if rules.chaser.distance != 0.0:
            away = nearest_evader(turn, chaser)
            earned = real(rules.chaser.step + rules.chaser.distance * away)
        events[game, chaser] = 0
        rewards[game, chaser] = earned if pays else real(0.0)
    for evader in evaders_of(rules.teams):
        earned = real(rules.evader.step)
        if rules.evader.distance != 0.0:
            away = nearest_chaser(turn, evader)
            earned = real(rules.evader.step + rules.evader.distance * away)
        events[game, evader] = 0
        rewards[game, evader] = earned if pays and is_free(turn, evader) != 0 else real(0.0)
    for runner in runners_of(rules.teams):
        earned = real(rules.runner.step)
        if rules.runner.distance != 0.0:
            away = nearest_goal(turn, runner)
            earned = real(rules.runner.step + rules.runner.distance * away)
        events[game, runner] = 0
        rewards[game, runner] = earned if pays else real(0.0)


@inlined
def pays_step(rewards: RewardCoefficients, event: int, end: int) -> bool:
    """Whether the step reward applies: no event, or an event that counts only at the end."""
    return event == 0 or (rewards.on_completion != 0.0 and end != TERMINATED)


@inlined
def add_capture_rewards(turn: Turn, num_captured: int, end: int) -> None:
    """Write the events and rewards of captures; captors of one evader share its reward equally."""
    rules, plan, game = turn.rules, turn.plan, turn.game
    events, rewards = turn.games.event, turn.outcome.rewards
    applies, real = not pays_step(rules.chaser, CAPTURED, end), rewards.dtype.type
    for i in range(num_captured):
        evader = plan.captured[i]
        share = rules.chaser.capture / plan.captors[evader]
        for chaser in chasers_of(rules.teams):
            is_captor = meets_evader(turn, chaser, evader)
            event, earned = events[game, chaser], rewards[game, chaser]
            more = real(share + (earned if event != 0 else real(0.0)))
            events[game, chaser] = event | (CAPTURED * is_captor)
            rewards[game, chaser] = more if is_captor & applies else earned
        events[game, evader] = WAS_CAPTURED
        rewards[game, evader] = real(rules.evader.capture)


@inlined
def add_escape_rewards(turn: Turn, end: int) -> None:
    """Write the events and rewards of evaders that escape, which every chaser shares in full."""
    rules, game = turn.rules, turn.game
    events, rewards = turn.games.event, turn.outcome.rewards
    applies, real = not pays_step(rules.chaser, ESCAPED, end), rewards.dtype.type
    for evader in evaders_of(rules.teams):
        if turn.plan.captors[evader] >= 0:
            continue
        events[game, evader] = ESCAPED
        rewards[game, evader] = real(rules.evader.escape)
        for chaser in chasers_of(rules.teams):
            event, earned = events[game, chaser], rewards[game, chaser]
            events[game, chaser] = event | ESCAPED
            if applies:
                before = earned if event != 0 else real(0.0)
                rewards[game, chaser] = real(rules.chaser.escape + before)


@inlined
def add_goal_rewards(turn: Turn, end: int) -> None:
    """Replace the step reward of the agents that collect a goal, and write their events."""
    rules, game = turn.rules, turn.game
    for evader in evaders_of(rules.teams):
        if turn.games.active[game, evader] != 0 and turn.plan.captors[evader] == 0:
            add_goal_reward(turn, evader, rules.evader, end)
    for runner in runners_of(rules.teams):
        add_goal_reward(turn, runner, rules.runner, end)


@inlined
def add_goal_reward(turn: Turn, agent: int, rewards: RewardCoefficients, end: int) -> None:
    """`add_goal_rewards` for one agent."""
    event, earned = goals_taken_by(turn, agent, rewards)
    turn.games.event[turn.game, agent] = event
    if not pays_step(rewards, event, end):
        turn.outcome.rewards[turn.game, agent] = earned


@inlined
def add_per_evader_rewards(turn: Turn, pays: bool) -> None:
    """Write the reward of every chaser as a sum over the evaders free before the step."""
    teams, rewards, real = turn.rules.teams, turn.rules.chaser, turn.outcome.rewards.dtype.type
    total = real(0.0)
    for evader in evaders_of(teams):
        if is_free(turn, evader) != 0:
            if turn.plan.captors[evader] > 0:
                earned = real(rewards.capture)
            elif turn.plan.captors[evader] < 0:
                earned = real(rewards.escape)
            else:
                event, earned = goals_taken_by(turn, evader, rewards)
                earned = earned if event != 0 else real(rewards.step if pays else 0.0)
            total = real(total + earned)
    for chaser in chasers_of(teams):
        turn.outcome.rewards[turn.game, chaser] = total


@inlined
def add_touch_rewards(turn: Turn) -> None:
    """Add the reward of every chaser for the evaders, free before the step, that are one move away.

    If the chasers move first, the evaders count where they stood before.
    """
    rules, plan, rewards = turn.rules, turn.plan, turn.outcome.rewards
    first = rules.chasers_first and not rules.options.turns
    for chaser in chasers_of(rules.teams):
        touched = 0
        for evader in evaders_of(rules.teams):
            stood = np.int64(turn.games.position[turn.game, evader])
            cell = stood if first else np.int64(plan.after[evader])
            touched += is_free(turn, evader) * leads_to(turn, plan.after[chaser], cell)
        earned = rewards[turn.game, chaser] + rules.chaser.touch * touched
        rewards[turn.game, chaser] = rewards.dtype.type(earned)


@inlined
def goals_taken_by(turn: Turn, agent: int, rewards: RewardCoefficients) -> tuple[int, float]:
    """The event and reward of a collector; agents on one goal share its reward equally."""
    plan, real = turn.plan, turn.outcome.rewards.dtype.type
    event, earned = 0, real(0.0)
    for goal in goals_of(turn.rules.teams):
        if plan.takers[goal] > 0 and turn.games.goal[turn.game, goal] == plan.after[agent]:
            event = COLLECTED
            earned = real(earned + rewards.goal / plan.takers[goal])
    return event, earned


@inlined
def nearest_evader(turn: Turn, chaser: int) -> int:
    """The Manhattan distance to the nearest free evader; 0 if there is none."""
    plan, nearest = turn.plan, -1
    for evader in evaders_of(turn.rules.teams):
        if turn.games.active[turn.game, evader] and plan.captors[evader] == 0:
            nearest = nearer(turn, nearest, plan.after[chaser], plan.after[evader])
    return max(nearest, 0)


@inlined
def nearest_chaser(turn: Turn, evader: int) -> int:
    """The Manhattan distance to the nearest chaser; 0 if there is none."""
    plan, nearest = turn.plan, -1
    for chaser in chasers_of(turn.rules.teams):
        nearest = nearer(turn, nearest, plan.after[evader], plan.after[chaser])
    return max(nearest, 0)


@inlined
def nearest_goal(turn: Turn, runner: int) -> int:
    """The Manhattan distance to the nearest goal that is left; 0 if there is none."""
    plan, nearest = turn.plan, -1
    for goal in goals_of(turn.rules.teams):
        cell = turn.games.goal[turn.game, goal]
        if cell >= 0 and plan.takers[goal] == 0:
            nearest = nearer(turn, nearest, plan.after[runner], cell)
    return max(nearest, 0)


@inlined
def nearer(turn: Turn, nearest: int, a: int, b: int) -> int:
    """The smaller of a distance, -1 if there is none yet, and that of two cells."""
    away = manhattan(turn.world, turn.first_cell, a, b)
    return away if nearest < 0 or away < nearest else nearest
