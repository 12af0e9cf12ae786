"""Exploitability of mixtures of snapshots.

Fictitious play and double oracle converge in a mixture of past policies, not in the last policy. A
mixture draws one snapshot per game, which the opponent does not observe. Its exploitability is
bounded from above by responses that know the snapshot, and from below by responses that do not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from train.evaluation.sides import PolicyTable, Sides
from train.files import Plain
from train.self_play.pool import Member
from train.self_play.side import Side, usual_least
from train.settings.self_play import NASH_SAMPLING

RESPONSES = 8
"""Best responses to single snapshots that are played against a whole mixture; each takes an exact
evaluation for every snapshot."""
MIXED = ("uniform", *NASH_SAMPLING)
"""Sampling rules that play a mixture of snapshots: all equally likely, or the Nash mixture; with
others the last policies are played."""


def mixture_bounds(
    game: Sides, role: str, tables: PolicyTable, shares: NDArray[np.float64]
) -> tuple[float, float]:
    """Bounds of the exploitability of a mixture that draws one table per game.

    Upper: the opponent knows the table. Lower: the best single response, among those to their
    average in every state and to `RESPONSES` of the tables, the most probable ones.

    Args:
        game: of two sides, whose policies are tables.
        role: of the mixture.
        tables: [n, ...] as of `Sides.table`.
        shares: [n] probabilities of the tables.

    Returns:
        Lower and upper bound of the mean over all starts, in the unit of `Sides.replies`.
    """
    reply, gain = game.replies(role)
    each = [reply(table) for table in tables]
    upper = float(shares @ [gained for _, gained in each])
    average, _ = reply(np.tensordot(shares, tables, axes=1))
    likely = np.argsort(-shares, kind="stable")[:: max(len(shares) // RESPONSES, 1)]
    responses = [each[number][0] for number in likely] + [average]
    gains = [float(shares @ [gain(table, one) for table in tables]) for one in responses]
    lower = max(0.0, *gains)  # exploitability is never negative
    return lower, max(lower, upper)


def mixture_nash_conv(
    game: Sides,
    kept: Mapping[str, Sequence[Member]],
    mixtures: Mapping[str, Mapping[str, float]] | None,
    min_probability: float = 0.0,
) -> tuple[float, float] | None:
    """Bounds of NashConv of mixtures of the snapshots in the pools.

    Args:
        game: of all sides.
        kept: the snapshots of each role.
        mixtures: shares of the snapshots by role and name; None for equal shares.
        min_probability: snapshots do not play actions below it, as the policies that are evaluated.

    Returns:
        None if a role does not learn or has no snapshot, if a snapshot is no table, or if a mixture
        has other policies than snapshots.
    """
    if len(kept) != 2 or not all(kept.values()):
        return None
    bounds = []
    for role, members in kept.items():
        equal = {member.name: 1.0 / len(members) for member in members}
        by_name = equal if mixtures is None else mixtures.get(role, {})
        shares = np.array([by_name.get(member.name, 0.0) for member in members])
        if not game.are_tables(()):
            return None
        policies = [member.policy_once() for member in members]
        if shares.sum() < 1.0 - 1e-6 or not game.are_tables(policies):
            return None
        tables = np.stack([game.table(policy, min_probability) for policy in policies])
        drawn = shares > 0.0
        bounds.append(mixture_bounds(game, role, tables[drawn], shares[drawn] / shares.sum()))
    lower, upper = (sum(ends) for ends in zip(*bounds, strict=True))
    return lower, upper


def snapshot_nash_convs(
    sides: Mapping[str, Side], nash_conv: Callable[[dict[str, Policy]], float]
) -> dict[str, float]:
    """NashConv of the learned sides with their last and with their averaged weights, also without
    the actions below `usual_least`: "last", "average", "last_likely" and "average_likely".

    Args:
        sides: those that learn.
        nash_conv: of policies of these.
    """
    found = {}
    for name, average in (("last", False), ("average", True)):
        for suffix, share in (("", 0.0), ("_likely", 1.0)):
            policies = {}
            for role, side in sides.items():
                least = share * usual_least(side.parts.seat.num_actions)
                policies[role] = side.policy_with(average, least)
            found[name + suffix] = nash_conv(policies)
    return found


def snapshot_results(
    game: Sides,
    sampling: str,
    kept: Mapping[str, Sequence[Member]],
    mixtures: Mapping[str, Mapping[str, float]] | None,
    min_probability: float,
) -> Plain:
    """ "mixture_nash_conv" where it is known, and the diversity of the snapshots in the pools.

    Arguments as in `mixture_nash_conv`, and the sampling rule; `mixtures` are the Nash mixtures of
    the run, if it has any.
    """
    results: Plain = {}
    if sampling in MIXED:
        shares = mixtures if sampling in NASH_SAMPLING else None
        bounds = mixture_nash_conv(game, kept, shares, min_probability)
        results |= {} if bounds is None else {"mixture_nash_conv": bounds}
    return {**results, **game.diversity(kept)}
