"""One step of one game, in six verbs: legal moves, step, ended, rewards (start: `starts`; observe:
`pursuit.observations`).

Everything is decided from what stood before the step; what follows is written last, and what was
written is never read again. Loops run over `chasers_of(teams)` and the like: where a kernel is
made for a task whose teams the compiler knows, they dissolve. Where it does not know them, numbers
are made unsigned: a signed index is asked at every use whether it is negative.

                  before            decided                       written
    position      games.position    plan.after                    games.position
    captures                        plan.captors, meet            games.active, games.event
    goals         games.goal        plan.takers                   games.goal, games.event
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import inlined
from pursuit.rules.distances import manhattan
from pursuit.rules.layout import (
    CAPTURED,
    COLLECTED,
    GOING_ON,
    TERMINATED,
    TRUNCATED,
    WAS_CAPTURED,
    Games,
    Outcome,
    Pay,
    Plan,
    Rules,
    Teams,
    World,
    bit_of,
    chasers_of,
    collectors_of,
    evaders_of,
    goals_of,
    runners_of,
)


@inlined
def legal_moves(world: World, maze: int, cell: int) -> int:
    """The bit mask of the moves that change the cell."""
    return np.int64(world.moves[np.uint64(world.first_cell[np.uint64(maze)] + cell)])


@inlined
def step(
    games: Games, game: int, actions: Any, rules: Rules, world: World, plan: Plan, outcome: Outcome
) -> int:
    """Move one game by one step; GOING_ON, TERMINATED or TRUNCATED."""
    teams, first_cell = rules.teams, world.first_cell[np.uint64(games.maze[game])]
    steps = games.steps[game] + 1
    for number in chasers_of(teams):
        chaser = np.uint64(number)
        plan.after[chaser] = destination(games, game, chaser, actions, world, first_cell)
    for number in evaders_of(teams):
        evader = np.uint64(number)
        cell = destination(games, game, evader, actions, world, first_cell)
        plan.after[evader] = cell if games.active[game, evader] else games.position[game, evader]
    for runner in runners_of(teams):
        plan.after[runner] = destination(games, game, runner, actions, world, first_cell)
    captures, captors = decide_captures(games, game, rules, plan)
    collected, goals_left = decide_goals(games, game, teams, plan)
    end = ended(games, game, rules, plan, collected > 0 and goals_left == 0, steps)

    for number in chasers_of(teams):
        chaser = np.uint64(number)
        event, earned = 0, np.float32(0.0)
        if captors & bit_of(chaser) != 0:
            event, earned = captures_of(games, game, chaser, rules, plan, captures)
        if pays_step(rules.chaser, event, end):
            earned = np.float32(rules.chaser.step)
            if rules.chaser.distance != 0.0:
                away = nearest_evader(games, game, chaser, teams, world, first_cell, plan)
                earned = np.float32(rules.chaser.step + rules.chaser.distance * away)
        write(games, game, chaser, event, earned, plan, outcome)
    for number in evaders_of(teams):
        evader = np.uint64(number)
        event, earned, active = 0, np.float32(0.0), games.active[game, evader] != 0
        if captures > 0 and plan.captors[evader] > 0:
            event, earned = WAS_CAPTURED, np.float32(rules.evader.capture)
        else:
            if collected > 0 and active:
                event, earned = goals_taken_by(games, game, evader, teams, rules.evader, plan)
            due = active & pays_step(rules.evader, event, end)
            earned = np.float32(rules.evader.step) if due else earned
            if rules.evader.distance != 0.0 and due:
                away = nearest_chaser(evader, teams, world, first_cell, plan)
                earned = np.float32(rules.evader.step + rules.evader.distance * away)
        write(games, game, evader, event, earned, plan, outcome)
    for runner in runners_of(teams):
        event, earned = 0, np.float32(0.0)
        if collected > 0:
            event, earned = goals_taken_by(games, game, runner, teams, rules.runner, plan)
        if pays_step(rules.runner, event, end):
            earned = np.float32(rules.runner.step)
            if rules.runner.distance != 0.0:
                away = nearest_goal(games, game, runner, teams, world, first_cell, plan)
                earned = np.float32(rules.runner.step + rules.runner.distance * away)
        write(games, game, runner, event, earned, plan, outcome)
    for i in range(captures):
        games.active[game, np.uint64(plan.captured[i])] = 0
    if collected > 0:
        for goal in goals_of(teams):
            if plan.takers[goal] > 0:
                games.goal[game, goal] = -1
    games.steps[game] = steps
    return end


@inlined
def write(
    games: Games, game: int, agent: int, event: int, earned: float, plan: Plan, outcome: Outcome
) -> None:
    """Write where an agent stands, what the step brought it and what it is paid."""
    games.position[game, agent] = plan.after[agent]
    games.event[game, agent] = event
    outcome.rewards[game, agent] = earned
    outcome.returns[game, agent] += earned


# -- decisions -------------------------------------------------------------------------------------


@inlined
def destination(
    games: Games, game: int, agent: int, actions: Any, world: World, first_cell: int
) -> int:
    """The cell that an agent's action leads to."""
    # Unsigned indices: a signed one, loaded from memory, is first asked whether it is negative.
    cell = np.uint64(first_cell + games.position[game, agent])
    return world.neighbors[cell, np.uint64(actions[game, agent])]


@inlined
def meet(games: Games, game: int, chaser: int, evader: int, rules: Rules, plan: Plan) -> bool:
    """Whether a chaser captures an evader: they end in one cell, or moved at once and swapped."""
    before, after = games.position[game, chaser], plan.after[chaser]
    other_before, other_after = games.position[game, evader], plan.after[evader]
    swapped = (after == other_before) & (before == other_after)
    return (after == other_after) | (swapped & (not rules.chasers_first))


@inlined
def decide_captures(games: Games, game: int, rules: Rules, plan: Plan) -> tuple[int, Any]:
    """Count the captors of every evader and list who is captured; how many are, and who captures.

    Captors are told by the bits of their numbers: whose bit is not set, captures nobody. Where the
    chasers move first, whoever they reach moves no more. Whether an evader may meet anybody is told
    by the bits of cells, and only then is every chaser asked.
    """
    captures, came_from, came_to, who = 0, np.uint64(0), np.uint64(0), np.uint64(0)
    for number in chasers_of(rules.teams):
        chaser = np.uint64(number)
        came_from |= bit_of(games.position[game, chaser])
        came_to |= bit_of(plan.after[chaser])
    for number in evaders_of(rules.teams):
        evader = np.uint64(number)
        captors, before, after = 0, games.position[game, evader], plan.after[evader]
        reached = came_to & bit_of(before)
        if rules.chasers_first:
            passed = reached
        else:
            passed = np.uint64(0) if came_from & bit_of(after) == 0 else reached
        if games.active[game, evader] != 0 and (passed | (came_to & bit_of(after))) != 0:
            if rules.chasers_first:
                for number in chasers_of(rules.teams):
                    chaser = np.uint64(number)
                    if plan.after[chaser] == before:
                        plan.after[evader] = before
            for number in chasers_of(rules.teams):
                chaser = np.uint64(number)
                met = meet(games, game, chaser, evader, rules, plan)
                captors += met
                who |= bit_of(chaser) if met else np.uint64(0)
        plan.captors[evader] = captors
        plan.captured[captures] = evader
        captures += captors > 0
    return captures, who


@inlined
def decide_goals(games: Games, game: int, teams: Teams, plan: Plan) -> tuple[int, int]:
    """Count the takers of every goal; how many goals are collected, and how many are left."""
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
def may_collect(games: Games, game: int, agent: int, teams: Teams, plan: Plan) -> bool:
    """Whether an evader is free, and stays so; a runner always is."""
    if agent >= teams.chasers + teams.evaders:
        return True
    return (games.active[game, agent] != 0) & (plan.captors[agent] == 0)


@inlined
def ended(
    games: Games, game: int, rules: Rules, plan: Plan, all_collected: bool, steps: int
) -> int:
    """TERMINATED when no evader is left, or no goal; else TRUNCATED when time is up."""
    free = 0
    for number in evaders_of(rules.teams):
        evader = np.uint64(number)
        free += (games.active[game, evader] != 0) & (plan.captors[evader] == 0)
    if all_collected or (rules.teams.evaders > 0 and free == 0):
        return TERMINATED
    return TRUNCATED if steps >= rules.max_steps else GOING_ON


# -- rewards ---------------------------------------------------------------------------------------


@inlined
def pays_step(pay: Pay, event: int, end: int) -> bool:
    """Whether the step reward is due: nothing happened, or nothing that counts before the end."""
    return event == 0 or (pay.on_completion != 0.0 and end != TERMINATED)


@inlined
def captures_of(
    games: Games, game: int, chaser: int, rules: Rules, plan: Plan, captures: int
) -> tuple[int, float]:
    """The event and the reward of a chaser: captors of one evader share it equally."""
    event, earned = 0, np.float32(0.0)
    for i in range(captures):
        evader = np.uint64(plan.captured[i])
        if meet(games, game, chaser, evader, rules, plan):
            event = CAPTURED
            earned = np.float32(earned + rules.chaser.capture / plan.captors[evader])
    return event, earned


@inlined
def goals_taken_by(
    games: Games, game: int, agent: int, teams: Teams, pay: Pay, plan: Plan
) -> tuple[int, float]:
    """The event and the reward of a collector: those who arrive at once share a goal equally."""
    event, earned = 0, np.float32(0.0)
    for goal in goals_of(teams):
        if plan.takers[goal] > 0 and games.goal[game, goal] == plan.after[agent]:
            event = COLLECTED
            earned = np.float32(earned + pay.goal / plan.takers[goal])
    return event, earned


@inlined
def nearest_evader(
    games: Games, game: int, chaser: int, teams: Teams, world: World, first_cell: int, plan: Plan
) -> int:
    """Rows plus columns to the nearest evader that is free; 0 where none is."""
    nearest = -1
    for evader in evaders_of(teams):
        if games.active[game, evader] and plan.captors[evader] == 0:
            away = manhattan(world, first_cell, plan.after[chaser], plan.after[evader])
            if nearest < 0 or away < nearest:
                nearest = away
    return max(nearest, 0)


@inlined
def nearest_chaser(evader: int, teams: Teams, world: World, first_cell: int, plan: Plan) -> int:
    """Rows plus columns to the nearest chaser; 0 where none is."""
    nearest = -1
    for chaser in chasers_of(teams):
        away = manhattan(world, first_cell, plan.after[evader], plan.after[chaser])
        if nearest < 0 or away < nearest:
            nearest = away
    return max(nearest, 0)


@inlined
def nearest_goal(
    games: Games, game: int, runner: int, teams: Teams, world: World, first_cell: int, plan: Plan
) -> int:
    """Rows plus columns to the nearest goal that is left; 0 where none is."""
    nearest = -1
    for goal in goals_of(teams):
        if games.goal[game, goal] >= 0 and plan.takers[goal] == 0:
            away = manhattan(world, first_cell, plan.after[runner], games.goal[game, goal])
            if nearest < 0 or away < nearest:
                nearest = away
    return max(nearest, 0)
