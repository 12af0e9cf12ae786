"""Shapley's iteration over all places of a chase, with exact steps of policy evaluation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu

from scripted_agents.game_kernels import (
    CHASERS,
    count_following,
    fill_following,
    respond,
    shapley,
)
from scripted_agents.places import Places, distinct_moves

TOLERANCE = 1e-10
"""How exact the values are, relative to the largest, where floats allow it."""

SPACINGS = 8
"""Changes below this many spacings of floats at the largest value are rounding."""

MIXED = 1e-7
"""Difference in steps above which optimal play must be random; the values are that exact."""

NEWTON_SWEEPS, MAX_SWEEPS = 100, 1000

PLACES_A_REPORT = 20_000
"""Places between two reports: some tenths of a second."""

Values = NDArray[np.float64]
Report = Callable[[float], None]
"""Told the share of the work that is done, in [0, 1]."""


def silent(share: float) -> None:
    """Report nothing."""


class Game:
    """The game between a team and an evader, and what both play in it so far.

    Args:
        places: where they can be.
        discount: of each step.
        chasers_first: whether the chasers move first.
        report: told how far it is.

    Attributes:
        chaser_policy: [teams, cells, joint actions] float64, of the last sweep.
        evader_policy: [teams, cells, actions] float64.
        mixed: [teams, cells] bool, whether there is no pure saddle point.
        share: of the work done before the sweep that is going on, and after it, for the reports.
    """

    def __init__(
        self, places: Places, discount: float, chasers_first: bool, report: Report
    ) -> None:
        self.places, self.discount, self.chasers_first = places, discount, chasers_first
        self.report, self.share = report, (0.0, 0.0)
        teams, size = len(places.teams), places.size
        self.chaser_policy = np.zeros((teams, size, len(places.parts)))
        self.evader_policy = np.zeros((teams, size, places.neighbors.shape[1]))
        self.mixed = np.zeros((teams, size), dtype=bool)
        self._useful = distinct_moves(places.neighbors)
        # Teams that are one another but for names are looked at once.
        self._numbers = places.sorted_teams
        self._rows = np.full(teams, -1, dtype=np.int64)
        self._rows[self._numbers] = np.arange(len(self._numbers))
        self._rows = self._rows[places.twins]

    def start(self) -> Values:
        """Values of 0."""
        return np.zeros((len(self.places.teams), self.places.size))

    def sweep(self, values: Values) -> tuple[Values, float]:
        """The values one step further back, and the largest change; sets both policies."""
        places, target = self.places, np.empty_like(values)
        least_mixed = max(MIXED, SPACINGS * 10 * float(np.spacing(values.max())))
        many = max(PLACES_A_REPORT // places.size, 1)
        change = 0.0
        for first in range(0, len(self._numbers), many):
            last = min(first + many, len(self._numbers))
            found = shapley(
                values, target, places.teams, places.nexts, self._numbers, places.neighbors,
                self._useful, self.discount, self.chasers_first, least_mixed,
                self.chaser_policy, self.evader_policy, self.mixed, first, last,
            )  # fmt: skip
            change = max(change, float(found))
            done = last / len(self._numbers)
            self.report((1.0 - done) * self.share[0] + done * self.share[1])
        return target[places.twins], change

    def evaluated(self) -> Values:
        """The values of the two policies as they are, by a sparse linear solve."""
        places, numbers = self.places, self._numbers
        policies = (self.chaser_policy, self.evader_policy)
        arrays = (places.teams, places.nexts, numbers)
        entries = count_following(*arrays, places.neighbors, *policies)
        rows = len(numbers) * places.size
        starts, columns = np.empty(rows + 1, dtype=np.int32), np.empty(entries, dtype=np.int32)
        chances = np.empty(entries)
        fill_following(
            *arrays, self._rows, places.neighbors, self.chasers_first, *policies,
            starts, columns, chances,
        )  # fmt: skip
        used = starts[-1]
        following = csr_array((chances[:used], columns[:used], starts), shape=(rows, rows))
        ones = places.apart[numbers].ravel().astype(np.float64)
        # Whoever is never caught has the value of all steps, exactly; a solve would lose digits.
        reached = ones > following.sum(axis=1) + 1e-9
        count, before = int(reached.sum()), 0
        while count > before:
            reached |= following @ reached > 0.0
            count, before = int(reached.sum()), count
        going = np.flatnonzero(reached)
        values = np.where(ones > 0.0, 1.0 / (1.0 - self.discount), 0.0)
        if len(going):
            within = following[going]
            known = np.where(reached, 0.0, values)
            system = eye_array(len(going)) - self.discount * within[:, going]
            right = 1.0 + self.discount * (within @ known)
            values[going] = splu(csc_array(system)).solve(right)
        values = values.reshape(len(numbers), places.size)
        return values[self._rows]

    def answered(self, values: Values) -> Values:
        """The values of the chasers' best responses to the evader's policy as it is.

        By policy iteration from what is best at `values`; sets the chasers' policy.
        """
        places = self.places
        choice = np.zeros(values.shape, dtype=np.int16)
        groups = np.arange(len(places.parts), dtype=np.int64)
        everything = np.ones((1, 1, len(groups)))
        while True:
            before, target = choice.copy(), np.empty_like(values)
            respond(
                values, target, places.teams, places.nexts, self._numbers, places.neighbors,
                CHASERS, groups, self.discount, self.chasers_first, everything,
                self.evader_policy, choice, 0, len(self._numbers),
            )  # fmt: skip
            self.chaser_policy[:] = 0.0
            np.put_along_axis(self.chaser_policy, choice[..., None].astype(np.int64), 1.0, axis=2)
            following = self.evaluated()
            if (choice == before).all() or not (following < values).any():
                return following
            values = following

    def spread(self, values: Values) -> None:
        """Give the teams that were not looked at what their twins have."""
        self.mixed = self.mixed[self.places.twins]
        self.evader_policy = self.evader_policy[self.places.twins]
        self.places.rename(self.chaser_policy)


def solve_steps(game: Game, horizon: int) -> tuple[Values, int]:
    """Backward induction over `horizon` steps, or until nothing changes: values, and sweeps."""
    values = game.start()
    for sweeps in range(1, horizon + 1):
        game.share = (sweeps - 1) / horizon, sweeps / horizon
        values, change = game.sweep(values)
        if change == 0.0:
            break
    return values, sweeps


def solve_for_ever(game: Game) -> tuple[Values, int]:
    """The game without an end: its values, and the sweeps it took.

    Shapley's map shrinks differences by the discount. Evaluating the two policies that a sweep
    found is Newton's method (Pollatschek and Avi-Itzhak, 1969): a few sweeps where it works, but it
    may circle. So its result is kept only where the next change is smaller than without it; after
    NEWTON_SWEEPS the evader's policy alone is kept and answered exactly, which costs more but is
    sure to converge, from below (Hoffman and Karp, 1966).

    Raises:
        ValueError: no convergence within MAX_SWEEPS.
    """
    discount = game.discount
    values, plain, bound, jumped = game.start(), game.start(), np.inf, False
    largest_change = 1.0
    for sweeps in range(1, MAX_SWEEPS):
        following, change = game.sweep(values)
        if jumped and change > discount * bound:
            values, jumped = plain, False
            continue
        largest = max(1.0, float(following.max()))
        smallest = max(
            TOLERANCE * largest * (1.0 - discount) / discount,
            SPACINGS * float(np.spacing(largest)),
        )
        if change <= smallest:
            return following, sweeps
        largest_change = max(largest_change, change)
        span = np.log(largest_change / smallest)
        game.share = (
            game.share[1],
            max(game.share[1], float(np.log(largest_change / change) / span)),
        )
        plain, bound, jumped = following, change, sweeps < NEWTON_SWEEPS
        values = game.evaluated() if jumped else game.answered(following)
    raise ValueError(
        f"no convergence within {MAX_SWEEPS} sweeps at discount {discount}; take a smaller one, or "
        "a horizon"
    )
