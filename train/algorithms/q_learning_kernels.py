"""Compiled kernels of tabular Q-learning: action choice, and updates."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled
from pursuit.rules import Games, next_below, next_uniform
from train.networks.numbering_kernels import number_state


@compiled
def choose_actions(
    q_values: Any, states: Any, position: Any, allowed: Any, streams: Any, epsilon: float,
    actions: Any, seat: int,
) -> None:  # fmt: skip
    """Epsilon-greedy actions of all games, into column `seat`; the lowest of equal actions.

    Only actions that are `allowed` [cells, actions] in the agent's cell.
    """
    num_actions = q_values.shape[1]
    for game in range(states.shape[0]):
        cell = position[game, seat]
        if epsilon > 0.0 and next_uniform(streams[game], 0) < epsilon:
            action = next_below(streams[game], 0, num_actions)
            while not allowed[cell, action]:
                action = next_below(streams[game], 0, num_actions)
            actions[game, seat] = action
        else:
            state = states[game]
            best, most = 0, -np.inf
            for action in range(num_actions):
                value = q_values[state, action]
                if value > most and allowed[cell, action]:
                    best, most = action, value
            actions[game, seat] = best


@compiled
def learn(
    q_values: Any, visits: Any, position: Any, active: Any, event: Any, goal: Any, steps: Any,
    maze: Any, exit_of: Any, numbering: Any, allowed: Any, states: Any, actions: Any, seat: int,
    rewards: Any, ended_by_rule: Any, ended_by_time: Any, done: Any, gamma: float,
    learning_rate: float, power: float,
) -> tuple[float, int]:  # fmt: skip
    """One update for each game in sequence (Watkins, 1989).

    Args:
        q_values, visits: [states, actions].
        position, active, event, goal, steps, maze, exit_of: the arrays of the games after the step.
        numbering: cells and binomials, as `number_states` takes them.
        allowed: [cells, actions] bool, the allowed actions, also for the next action.
        states: [games] int64 before the step; overwritten by those after it.
        actions, seat, rewards: the learner's actions, agent index and rewards.
        ended_by_rule, ended_by_time: [games] bool; the truncated games are bootstrapped.
        done: [games] bool, out: whether the episode ended, for the game or for the learner.
        gamma, learning_rate, power: the step size is learning_rate / visits ** power.

    Returns:
        The mean |error|, and the number of ended episodes.
    """
    games = Games(position, active, event, goal, steps, maze, exit_of)
    cells, binomials = numbering
    num_actions = q_values.shape[1]
    total, count = 0.0, 0
    for game in range(states.shape[0]):
        state, action = states[game], actions[game, seat]
        after = number_state(games, game, cells, binomials)
        terminated = ended_by_rule[game] or games.active[game, seat] == 0
        target = np.float64(rewards[game, seat])
        if not terminated:
            best = -np.inf
            for other in range(num_actions):
                if allowed[games.position[game, seat], other]:
                    best = max(best, q_values[after, other])
            target += gamma * best
        visits[state, action] += 1
        rate = learning_rate
        if power > 0.0:
            rate = learning_rate / np.float64(visits[state, action]) ** power
        error = target - q_values[state, action]
        q_values[state, action] += rate * error
        total += abs(error)
        done[game] = terminated or ended_by_time[game]
        count += done[game]
        states[game] = after
    return total / states.shape[0], count
