"""The rewards of one step of one game, and its events."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import inlined
from pursuit.rules.distances import manhattan
from pursuit.rules.layout import (
    CAPTURED,
    COLLECTED,
    ESCAPED,
    TERMINATED,
    WAS_CAPTURED,
    RewardCoefficients,
    chasers_of,
    evaders_of,
    goals_of,
    runners_of,
)
from pursuit.rules.turn import Turn, is_free, leads_to, meets_evader


@inlined
def add_step_rewards(turn: Turn, pays: bool) -> None:
    """Write the step reward of every agent; 0 for captured evaders, and of all unless `pays`."""
    rules = turn.rules
    for chaser in chasers_of(rules.teams):
        add_step_reward(turn, chaser, rules.chaser, nearest_evader, pays)
    for evader in evaders_of(rules.teams):
        earns = pays and is_free(turn, evader) != 0
        add_step_reward(turn, evader, rules.evader, nearest_chaser, earns)
    for runner in runners_of(rules.teams):
        add_step_reward(turn, runner, rules.runner, nearest_goal, pays)


@inlined
def add_step_reward(
    turn: Turn, agent: int, coefficients: RewardCoefficients, nearest: Any, earns: bool
) -> None:
    """`add_step_rewards` for one agent; `nearest` is one of the functions at the end."""
    rewards = turn.outcome.rewards
    real = rewards.dtype.type  # float32; float64 in exact solvers
    earned = real(coefficients.step)
    if coefficients.distance != 0.0:
        earned = real(coefficients.step + coefficients.distance * nearest(turn, agent))
    turn.games.event[turn.game, agent] = 0
    rewards[turn.game, agent] = earned if earns else real(0.0)


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
