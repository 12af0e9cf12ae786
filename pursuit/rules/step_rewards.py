"""The rewards of one step of one game, and its events."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import inlined
from pursuit.rules.arrays import Ints
from pursuit.rules.distances import manhattan
from pursuit.rules.layout import (
    ACTIVE,
    AFTER,
    CAPTORS,
    CAPTURED,
    CAUGHT,
    COLLECTED,
    ESCAPED,
    EVENT,
    POSITION,
    TAKERS,
    TERMINATED,
    WAS_CAPTURED,
    RewardCoefficients,
    chasers_of,
    evaders_of,
    goals_of,
    runners_of,
)
from pursuit.rules.turn import Goals, Turn, is_free, leads_to, meets_evader

Earned: TypeAlias = NDArray[np.floating]
"""[agents] the rewards of a game: float32; float64 in exact solvers."""


@inlined
def add_step_rewards(turn: Turn, goals: Goals, rewards: Earned, pays: bool) -> None:
    """Write the step reward of every agent; 0 for captured evaders, and of all unless `pays`."""
    rules, agents = turn.rules, turn.agents
    for chaser in chasers_of(rules.teams):
        away = nearest_evader(turn, chaser) if rules.chaser.distance != 0.0 else 0
        write_step_reward(rules.chaser, away, pays, agents, rewards, chaser)
    for evader in evaders_of(rules.teams):
        away = nearest_chaser(turn, evader) if rules.evader.distance != 0.0 else 0
        earns = pays and is_free(agents, evader) != 0
        write_step_reward(rules.evader, away, earns, agents, rewards, evader)
    for runner in runners_of(rules.teams):
        away = nearest_goal(turn, goals, runner) if rules.runner.distance != 0.0 else 0
        write_step_reward(rules.runner, away, pays, agents, rewards, runner)


@inlined
def write_step_reward(
    coefficients: RewardCoefficients, away: int, earns: bool, agents: Ints, rewards: Earned,
    agent: int,
) -> None:  # fmt: skip
    """`add_step_rewards` for one agent at this distance."""
    real = rewards.dtype.type  # float32; float64 in exact solvers
    earned = real(coefficients.step)
    if coefficients.distance != 0.0:
        earned = real(coefficients.step + coefficients.distance * away)
    agents[EVENT, agent] = 0
    rewards[agent] = earned if earns else real(0.0)


@inlined
def pays_step(rewards: RewardCoefficients, event: int, end: int) -> bool:
    """Whether the step reward applies: no event, or an event that counts only at the end."""
    return event == 0 or (rewards.on_completion != 0.0 and end != TERMINATED)


@inlined
def add_capture_rewards(turn: Turn, rewards: Earned, num_captured: int, end: int) -> None:
    """Write the events and rewards of captures; captors of one evader share its reward equally."""
    rules, plan = turn.rules, turn.plan
    events = turn.agents[EVENT]
    applies, real = not pays_step(rules.chaser, CAPTURED, end), rewards.dtype.type
    for i in range(num_captured):
        evader = plan[CAUGHT, i]
        share = rules.chaser.capture / plan[CAPTORS, evader]
        for chaser in chasers_of(rules.teams):
            is_captor = meets_evader(turn, chaser, evader)
            event, earned = events[chaser], rewards[chaser]
            more = real(share + (earned if event != 0 else real(0.0)))
            events[chaser] = event | (CAPTURED * is_captor)
            rewards[chaser] = more if is_captor & applies else earned
        events[evader] = WAS_CAPTURED
        rewards[evader] = real(rules.evader.capture)


@inlined
def add_escape_rewards(turn: Turn, rewards: Earned, end: int) -> None:
    """Write the events and rewards of evaders that escape, which every chaser shares in full."""
    rules = turn.rules
    events = turn.agents[EVENT]
    applies, real = not pays_step(rules.chaser, ESCAPED, end), rewards.dtype.type
    for evader in evaders_of(rules.teams):
        if turn.plan[CAPTORS, evader] >= 0:
            continue
        events[evader] = ESCAPED
        rewards[evader] = real(rules.evader.escape)
        for chaser in chasers_of(rules.teams):
            event, earned = events[chaser], rewards[chaser]
            events[chaser] = event | ESCAPED
            if applies:
                before = earned if event != 0 else real(0.0)
                rewards[chaser] = real(rules.chaser.escape + before)


@inlined
def add_goal_rewards(turn: Turn, goals: Ints, rewards: Earned, end: int) -> None:
    """Replace the step reward of the agents that collect a goal, and write their events."""
    rules = turn.rules
    for evader in evaders_of(rules.teams):
        if turn.agents[ACTIVE, evader] != 0 and turn.plan[CAPTORS, evader] == 0:
            add_goal_reward(turn, goals, rewards, evader, rules.evader, end)
    for runner in runners_of(rules.teams):
        add_goal_reward(turn, goals, rewards, runner, rules.runner, end)


@inlined
def add_goal_reward(
    turn: Turn, goals: Ints, rewards: Earned, agent: int, coefficients: RewardCoefficients, end: int
) -> None:
    """`add_goal_rewards` for one agent."""
    event, earned = goals_taken_by(turn, goals, rewards, agent, coefficients.goal)
    turn.agents[EVENT, agent] = event
    if not pays_step(coefficients, event, end):
        rewards[agent] = earned


@inlined
def add_per_evader_rewards(turn: Turn, goals: Goals, rewards: Earned, pays: bool) -> None:
    """Write the reward of every chaser as a sum over the evaders free before the step."""
    teams, coefficients, real = turn.rules.teams, turn.rules.chaser, rewards.dtype.type
    total = real(0.0)
    for evader in evaders_of(teams):
        if is_free(turn.agents, evader) != 0:
            if turn.plan[CAPTORS, evader] > 0:
                earned = real(coefficients.capture)
            elif turn.plan[CAPTORS, evader] < 0:
                earned = real(coefficients.escape)
            else:
                event, earned = goals_taken_by(turn, goals, rewards, evader, coefficients.goal)
                earned = earned if event != 0 else real(coefficients.step if pays else 0.0)
            total = real(total + earned)
    for chaser in chasers_of(teams):
        rewards[chaser] = total


@inlined
def add_touch_rewards(turn: Turn, rewards: Earned) -> None:
    """Add the reward of every chaser for the evaders, free before the step, that are one move away.

    If the chasers move first, the evaders count where they stood before.
    """
    rules, plan = turn.rules, turn.plan
    first = rules.chasers_first and not rules.options.turns
    for chaser in chasers_of(rules.teams):
        touched = 0
        for evader in evaders_of(rules.teams):
            stood = np.int64(turn.agents[POSITION, evader])
            cell = stood if first else np.int64(plan[AFTER, evader])
            touched += is_free(turn.agents, evader) * leads_to(
                turn.neighbors, turn.first_cell, plan[AFTER, chaser], cell
            )
        earned = rewards[chaser] + rules.chaser.touch * touched
        rewards[chaser] = rewards.dtype.type(earned)


@inlined
def goals_taken_by(
    turn: Turn, goals: Goals, rewards: Earned, agent: int, worth: float
) -> tuple[int, float]:
    """The event and reward of a collector; agents on one goal share its `worth` equally."""
    plan, real = turn.plan, rewards.dtype.type
    event, earned = 0, real(0.0)
    if goals is None:
        return event, earned
    for number in goals_of(turn.rules.teams):
        if plan[TAKERS, number] > 0 and goals[number] == plan[AFTER, agent]:
            event = COLLECTED
            earned = real(earned + worth / plan[TAKERS, number])
    return event, earned


@inlined
def nearest_evader(turn: Turn, chaser: int) -> int:
    """The Manhattan distance to the nearest free evader; 0 if there is none."""
    plan, nearest = turn.plan, -1
    for evader in evaders_of(turn.rules.teams):
        if turn.agents[ACTIVE, evader] and plan[CAPTORS, evader] == 0:
            nearest = nearer(nearest, distance(turn, chaser, plan[AFTER, evader]))
    return max(nearest, 0)


@inlined
def nearest_chaser(turn: Turn, evader: int) -> int:
    """The Manhattan distance to the nearest chaser; 0 if there is none."""
    plan, nearest = turn.plan, -1
    for chaser in chasers_of(turn.rules.teams):
        nearest = nearer(nearest, distance(turn, evader, plan[AFTER, chaser]))
    return max(nearest, 0)


@inlined
def nearest_goal(turn: Turn, goals: Goals, runner: int) -> int:
    """The Manhattan distance to the nearest goal that is left; 0 if there is none."""
    plan, nearest = turn.plan, -1
    if goals is None:
        return 0
    for goal in goals_of(turn.rules.teams):
        cell = goals[goal]
        if cell >= 0 and plan[TAKERS, goal] == 0:
            nearest = nearer(nearest, distance(turn, runner, cell))
    return max(nearest, 0)


@inlined
def nearer(nearest: int, away: int) -> int:
    """The smaller of two distances, the first of which is -1 if there is none yet."""
    return away if nearest < 0 or away < nearest else nearest


@inlined
def distance(turn: Turn, agent: int, cell: int) -> int:
    """The Manhattan distance of an agent after the step from a cell."""
    return manhattan(turn.facts, turn.first_cell, turn.plan[AFTER, agent], cell)
