"""The rules of one step of one game: legal moves, step, ended, rewards.

For starts see `starts`, for observations `pursuit.observations.observations`.

All decisions use the state before the step; the new state is written last. Of the values written,
only events and rewards are read again. Loops over `chasers_of(teams)` and the like are unrolled in
kernels with constant team sizes.

                  before            decided                       written
    position      games.position    plan.after                    games.position
    captures                        plan.captors, meet            games.active, games.event
    goals         games.goal        plan.takers                   games.goal, games.event
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.captures import captures
from pursuit.rules.distances import manhattan, place_of
from pursuit.rules.layout import (
    CAPTURED,
    COLLECTED,
    GOING_ON,
    TERMINATED,
    TRUNCATED,
    WAS_CAPTURED,
    Games,
    Outcome,
    RewardCoefficients,
    Rules,
    StepScratch,
    Teams,
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


@inlined
def step(
    games: Games,
    game: int,
    actions: Any,
    rules: Rules,
    world: World,
    plan: StepScratch,
    outcome: Outcome,
) -> int:
    """Step one game; return GOING_ON, TERMINATED or TRUNCATED."""
    teams, first_cell = rules.teams, world.first_cell[games.maze[game]]
    steps, stay = games.steps[game] + 1, stay_of(world)
    for chaser in chasers_of(teams):
        plan.after[chaser] = destination(
            games, game, chaser, actions[game, chaser], world, first_cell
        )
    for evader in evaders_of(teams):
        # A captured agent stays; no branch, as the processor could not predict it.
        action = stay + (np.int64(actions[game, evader]) - stay) * is_free(games, game, evader)
        plan.after[evader] = destination(games, game, evader, action, world, first_cell)
    for runner in runners_of(teams):
        plan.after[runner] = destination(
            games, game, runner, actions[game, runner], world, first_cell
        )
    num_captured = decide_captures(games, game, rules, plan)
    collected, goals_left = decide_goals(games, game, teams, plan)
    all_collected = collected > 0 and goals_left == 0
    end = ended(games, game, rules, num_captured, all_collected, steps)

    add_step_rewards(games, game, rules, world, first_cell, plan, outcome)
    if num_captured > 0 or collected > 0:
        add_event_rewards(games, game, rules, plan, outcome, num_captured, collected, end)
    if rules.chaser.per_evader != 0.0:
        add_per_evader_rewards(games, game, rules, plan, outcome)
    if collected > 0:
        count_goals(games, game, teams, plan, outcome)
    for agent in agents_of(teams):
        games.position[game, agent] = plan.after[agent]
        outcome.returns[game, agent] += outcome.rewards[game, agent]
    for i in range(num_captured):
        games.active[game, plan.captured[i]] = 0
    if collected > 0:
        for goal in goals_of(teams):
            if plan.takers[goal] > 0:
                games.goal[game, goal] = -1
    games.steps[game] = steps
    return end


# -- decisions -------------------------------------------------------------------------------------


@inlined
def destination(
    games: Games, game: int, agent: int, action: int, world: World, first_cell: int
) -> int:
    """The cell that an agent's action leads to."""
    return world.neighbors[place_of(first_cell, games.position[game, agent]), np.uint64(action)]


@inlined
def meet(
    games: Games, game: int, chaser: int, evader: int, rules: Rules, plan: StepScratch
) -> bool:
    """Whether a chaser captures an evader."""
    cells, after = games.position[game], plan.after
    return captures(rules.chasers_first, cells[chaser], after[chaser], cells[evader], after[evader])


@inlined
def decide_captures(games: Games, game: int, rules: Rules, plan: StepScratch) -> int:
    """Count the captors of every evader and list the captured evaders; return their number.

    If the chasers move first, an evader that one of them reaches does not move. Exact checks are
    made only for evaders that may share a cell with a chaser according to the bits of cells.
    """
    reached = np.uint64(0)
    for chaser in chasers_of(rules.teams):
        reached |= bit_of(plan.after[chaser])
    asked = num_captured = 0
    for evader in evaders_of(rules.teams):
        near = reached & (bit_of(games.position[game, evader]) | bit_of(plan.after[evader]))
        plan.captors[evader] = 0
        plan.captured[asked] = evader
        asked += (near != 0) * is_free(games, game, evader)
    for i in range(asked):
        evader, captors = plan.captured[i], 0
        for chaser in chasers_of(rules.teams):
            if rules.chasers_first and plan.after[chaser] == games.position[game, evader]:
                plan.after[evader] = games.position[game, evader]
        for chaser in chasers_of(rules.teams):
            captors += meet(games, game, chaser, evader, rules, plan)
        plan.captors[evader] = captors
        plan.captured[num_captured] = evader
        num_captured += captors > 0
    return num_captured


@inlined
def decide_goals(games: Games, game: int, teams: Teams, plan: StepScratch) -> tuple[int, int]:
    """Count the agents on every goal; return the numbers of goals collected and left."""
    collected = left = 0
    for goal in goals_of(teams):
        takers, cell = 0, games.goal[game, goal]
        if cell >= 0:
            for agent in collectors_of(teams):
                takers += (plan.after[agent] == cell) & may_collect(games, game, agent, teams, plan)
            collected += takers > 0
            left += takers == 0
        plan.takers[goal] = takers
    return collected, left


@inlined
def may_collect(games: Games, game: int, agent: int, teams: Teams, plan: StepScratch) -> bool:
    """Whether an agent is a runner, or an evader that is free and is not captured now."""
    if agent >= teams.chasers + teams.evaders:
        return True
    return (games.active[game, agent] != 0) & (plan.captors[agent] == 0)


@inlined
def ended(
    games: Games, game: int, rules: Rules, num_captured: int, all_collected: bool, steps: int
) -> int:
    """TERMINATED if no evader or no goal is left; else TRUNCATED after the last step."""
    free = -num_captured
    for evader in evaders_of(rules.teams):
        free += is_free(games, game, evader)
    if all_collected or (rules.teams.evaders > 0 and free == 0):
        return TERMINATED
    return TRUNCATED if steps >= rules.max_steps else GOING_ON


@inlined
def is_free(games: Games, game: int, evader: int) -> int:
    """1 if an evader was free before the step, 0 if it had been captured."""
    return np.int64(games.active[game, evader] != 0)


@inlined
def count_goals(games: Games, game: int, teams: Teams, plan: StepScratch, outcome: Outcome) -> None:
    """Add the goals of this step to the goals collected by each agent; shared goals in parts."""
    for goal in goals_of(teams):
        for agent in collectors_of(teams):
            here = plan.after[agent] == games.goal[game, goal]
            if plan.takers[goal] > 0 and here and may_collect(games, game, agent, teams, plan):
                outcome.collected[game, agent] += 1.0 / plan.takers[goal]


# -- rewards ---------------------------------------------------------------------------------------


@inlined
def add_step_rewards(
    games: Games,
    game: int,
    rules: Rules,
    world: World,
    first_cell: int,
    plan: StepScratch,
    outcome: Outcome,
) -> None:
    """Write the step reward of every agent; 0 for captured evaders."""
    teams, real = rules.teams, outcome.rewards.dtype.type  # float32; float64 in exact solvers
    for chaser in chasers_of(teams):
        earned = real(rules.chaser.step)
        if rules.chaser.distance != 0.0:
            away = nearest_evader(games, game, chaser, teams, world, first_cell, plan)
            earned = real(rules.chaser.step + rules.chaser.distance * away)
        games.event[game, chaser] = 0
        outcome.rewards[game, chaser] = earned
    for evader in evaders_of(teams):
        earned = real(rules.evader.step)
        if rules.evader.distance != 0.0:
            away = nearest_chaser(evader, teams, world, first_cell, plan)
            earned = real(rules.evader.step + rules.evader.distance * away)
        games.event[game, evader] = 0
        free = is_free(games, game, evader) != 0
        outcome.rewards[game, evader] = earned if free else real(0.0)
    for runner in runners_of(teams):
        earned = real(rules.runner.step)
        if rules.runner.distance != 0.0:
            away = nearest_goal(games, game, runner, teams, world, first_cell, plan)
            earned = real(rules.runner.step + rules.runner.distance * away)
        games.event[game, runner] = 0
        outcome.rewards[game, runner] = earned


@inlined
def add_event_rewards(
    games: Games,
    game: int,
    rules: Rules,
    plan: StepScratch,
    outcome: Outcome,
    num_captured: int,
    collected: int,
    end: int,
) -> None:
    """Replace the step reward of agents that have an event."""
    teams = rules.teams
    if num_captured > 0:
        add_capture_rewards(games, game, rules, plan, outcome, num_captured, end)
    if collected > 0:
        for evader in evaders_of(teams):
            if games.active[game, evader] != 0 and plan.captors[evader] == 0:
                event, earned = goals_taken_by(
                    games, game, evader, teams, rules.evader, plan, outcome
                )
                games.event[game, evader] = event
                if not pays_step(rules.evader, event, end):
                    outcome.rewards[game, evader] = earned
        for runner in runners_of(teams):
            event, earned = goals_taken_by(games, game, runner, teams, rules.runner, plan, outcome)
            games.event[game, runner] = event
            if not pays_step(rules.runner, event, end):
                outcome.rewards[game, runner] = earned


@inlined
def pays_step(rewards: RewardCoefficients, event: int, end: int) -> bool:
    """Whether the step reward applies: no event, or an event that counts only at the end."""
    return event == 0 or (rewards.on_completion != 0.0 and end != TERMINATED)


@inlined
def add_capture_rewards(
    games: Games,
    game: int,
    rules: Rules,
    plan: StepScratch,
    outcome: Outcome,
    num_captured: int,
    end: int,
) -> None:
    """Write the events and rewards of captures; captors of one evader share its reward equally."""
    applies, real = not pays_step(rules.chaser, CAPTURED, end), outcome.rewards.dtype.type
    for i in range(num_captured):
        evader = plan.captured[i]
        share = rules.chaser.capture / plan.captors[evader]
        for chaser in chasers_of(rules.teams):
            met = meet(games, game, chaser, evader, rules, plan)
            event, earned = games.event[game, chaser], outcome.rewards[game, chaser]
            more = real(share + (earned if event != 0 else real(0.0)))
            games.event[game, chaser] = event | (CAPTURED * met)
            outcome.rewards[game, chaser] = more if met & applies else earned
        games.event[game, evader] = WAS_CAPTURED
        outcome.rewards[game, evader] = real(rules.evader.capture)


@inlined
def add_per_evader_rewards(
    games: Games, game: int, rules: Rules, plan: StepScratch, outcome: Outcome
) -> None:
    """Write the reward of every chaser as a sum over the evaders free before the step."""
    teams, rewards, real = rules.teams, rules.chaser, outcome.rewards.dtype.type
    total = real(0.0)
    for evader in evaders_of(teams):
        if is_free(games, game, evader) != 0:
            if plan.captors[evader] > 0:
                earned = real(rewards.capture)
            else:
                event, earned = goals_taken_by(games, game, evader, teams, rewards, plan, outcome)
                earned = earned if event != 0 else real(rewards.step)
            total = real(total + earned)
    for chaser in chasers_of(teams):
        outcome.rewards[game, chaser] = total


@inlined
def goals_taken_by(
    games: Games,
    game: int,
    agent: int,
    teams: Teams,
    rewards: RewardCoefficients,
    plan: StepScratch,
    outcome: Outcome,
) -> tuple[int, float]:
    """The event and reward of a collector; agents on one goal share its reward equally."""
    real = outcome.rewards.dtype.type
    event, earned = 0, real(0.0)
    for goal in goals_of(teams):
        if plan.takers[goal] > 0 and games.goal[game, goal] == plan.after[agent]:
            event = COLLECTED
            earned = real(earned + rewards.goal / plan.takers[goal])
    return event, earned


@inlined
def nearest_evader(
    games: Games,
    game: int,
    chaser: int,
    teams: Teams,
    world: World,
    first_cell: int,
    plan: StepScratch,
) -> int:
    """The Manhattan distance to the nearest free evader; 0 if there is none."""
    nearest = -1
    for evader in evaders_of(teams):
        if games.active[game, evader] and plan.captors[evader] == 0:
            away = manhattan(world, first_cell, plan.after[chaser], plan.after[evader])
            if nearest < 0 or away < nearest:
                nearest = away
    return max(nearest, 0)


@inlined
def nearest_chaser(
    evader: int, teams: Teams, world: World, first_cell: int, plan: StepScratch
) -> int:
    """The Manhattan distance to the nearest chaser; 0 if there is none."""
    nearest = -1
    for chaser in chasers_of(teams):
        away = manhattan(world, first_cell, plan.after[evader], plan.after[chaser])
        if nearest < 0 or away < nearest:
            nearest = away
    return max(nearest, 0)


@inlined
def nearest_goal(
    games: Games,
    game: int,
    runner: int,
    teams: Teams,
    world: World,
    first_cell: int,
    plan: StepScratch,
) -> int:
    """The Manhattan distance to the nearest goal that is left; 0 if there is none."""
    nearest = -1
    for goal in goals_of(teams):
        if games.goal[game, goal] >= 0 and plan.takers[goal] == 0:
            away = manhattan(world, first_cell, plan.after[runner], games.goal[game, goal])
            if nearest < 0 or away < nearest:
                nearest = away
    return max(nearest, 0)
