"""Exact expectations of episodes of enumerated games: returns, lengths, and their bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pursuit.validation import whole
from scripted_agents.exact.tolerances import TIE
from scripted_agents.games.small_game import SmallGame, check_game
from scripted_agents.games.solve import (
    Policies,
    Values,
    chain_of,
    check_objective,
    replies_of,
    respond,
    returns_of,
)

NEGLIGIBLE = 1e-15
"""Probability that an episode still goes on, below which further steps are not counted."""


class Played(NamedTuple):
    """What is expected of an episode with a time limit.

    Attributes:
        returns: [players] float64, the sums of rewards.
        steps: the number of steps.
        ended: the probability that the game ends in time.
    """

    returns: Values
    steps: float
    ended: float


def play_of(game: SmallGame, policies: Policies, max_steps: int) -> Played:
    """The exact expectations of an episode of at most `max_steps` steps, from the starts.

    Arguments and errors are those of `returns_of`.
    """
    step, rewards = chain_of(game, policies)
    backwards = step.T.tocsr()
    at, returns, steps = game.start, np.zeros(len(game.players)), 0.0
    for _ in range(whole("max_steps", max_steps, 1)):
        returns = returns + at @ rewards
        steps += float(at.sum())
        at = backwards @ at
        if at.sum() < NEGLIGIBLE:
            break
    return Played(returns, steps, min(max(1.0 - float(at.sum()), 0.0), 1.0))


def play_of_response(
    game: SmallGame, player: str, policies: Policies, max_steps: int
) -> tuple[float, float, float]:
    """The exact expectations of an episode in which a player plays its best response within the
    time limit, which may depend on the time: its return, the steps, and the probability of an end.

    Of equally good actions it takes the first. Arguments and errors are those of `respond`.
    """
    replies = replies_of(game, [player], policies)
    stops = 1.0 - replies.step.sum(axis=1)
    gained = np.stack([replies.rewards, np.ones_like(stops), stops], axis=1)
    totals = np.zeros((game.num_states, 3))
    for _ in range(whole("max_steps", max_steps, 1)):
        chosen = replies.best(totals[:, 0], 1.0, TIE)
        before, totals = totals, gained[chosen] + replies.step[chosen] @ totals
        if np.array_equal(totals, before):
            break
    mean, steps, ended = (game.start @ totals).tolist()
    return mean, steps, min(max(ended, 0.0), 1.0)


def values_along(
    game: SmallGame,
    policies: Policies,
    visits: Sequence[Sequence[int]],
    discount: float = 0.95,
    horizon: int | None = None,
) -> list[Values]:
    """By episode [states, players] float64: the expected discounted returns from each of its
    states on, with a horizon within the steps that are left of it.

    Args:
        visits: by episode the numbers of its states, from its start on.
        game, policies, discount, horizon: as of `returns_of`, and so are the errors.
    """
    if horizon is None:
        values = returns_of(game, policies, discount)
        return [values[list(states)] for states in visits]
    check_objective(discount, horizon)
    step, rewards = chain_of(game, policies)
    values = np.zeros_like(rewards)
    found = [np.zeros((len(states), len(game.players))) for states in visits]
    for at in range(horizon - 1, -1, -1):
        values = rewards + discount * (step @ values)
        for own, states in zip(found, visits, strict=True):
            if at < len(states):
                own[at] = values[states[at]]
    return found


def return_range(
    game: SmallGame, player: str, discount: float = 0.95, horizon: int | None = None
) -> tuple[float, float]:
    """The least and the largest expected return of a player from the starts, whatever all play.

    Arguments and errors are those of `returns_of`.
    """
    check_game(game)
    ends = []
    for sign in (-1.0, 1.0):  # all players as one, for or against this player
        rewards = np.zeros_like(game.rewards)
        rewards[:, game.player(player)] = sign * game.rewards[:, game.player(player)]
        one = respond(replace(game, rewards=rewards), game.players, {}, discount, horizon)
        ends.append(sign * one.mean_over_starts)
    return ends[0], ends[1]
