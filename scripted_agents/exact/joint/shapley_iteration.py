"""Shapley's iteration over all states of a zero-sum game, with exact steps of policy evaluation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scripted_agents.exact.joint.layout import NO_SLIPS, Store, places_within
from scripted_agents.exact.joint.matrix_games import fill_strategies, sweep_games
from scripted_agents.exact.joint.opponents import lay_out_others
from scripted_agents.exact.joint.slips import fill_move_chances
from scripted_agents.exact.joint.states import JointStates
from scripted_agents.exact.joint.sweeps import Problem, Quantity, filled_store
from scripted_agents.exact.tolerances import JOINT_TOLERANCE, MAX_SWEEPS

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SPACINGS = 8
"""Changes below this many spacings of floats at the largest value are rounding."""

LEAST_MIXED = 1e-7
"""Difference in value above which optimal play must be random; the values are that exact."""

STATES_A_REPORT = 20_000
"""States between two reports: some tenths of a second."""

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]
OnProgress = Callable[[float], None]
"""Called with the fraction of the work done, in [0, 1]."""


def silent(share: float) -> None:
    """Report nothing."""


def restricted(store: Store, rows: Mask, columns: Mask) -> Store:
    """The transitions of the game in which both players may use only some of their options.

    Args:
        store: of two players who both decide, so that every pair of options is a joint action.
        rows, columns: [states, actions] bool of the row and of the column player; at least one
            option of each in every state. No moves may slip.
    """
    state = np.repeat(np.arange(len(store.shape)), store.shape[:, 0])
    within = places_within(store.shape[:, 0])
    pair, edge = store.pairs[state] + within, store.edges[state] + within
    row, column = np.divmod(store.joints[edge], columns.shape[1])
    may = rows[state, row]
    kept = may & columns[state, column]
    totals = np.bincount(state[kept], minlength=len(store.shape))
    shape = store.shape.copy()
    all_columns = np.maximum(store.shape[:, 0] // np.maximum(store.shape[:, 2], 1), 1)
    shape[:, 0] = totals
    shape[:, 2] = np.bincount(state[may], minlength=len(shape)) // all_columns
    pairs, pair, edge = np.concatenate([[0], np.cumsum(totals)]), pair[kept], edge[kept]
    rest = store.following[pair], store.sides[edge], store.joints[edge]
    return Store(pairs, pairs, shape, *rest, *NO_SLIPS)


def stochastic_game_of(
    states: JointStates,
    seats: tuple[int, ...],
    payoff: Quantity,
    discount: float,
    twins: NDArray[np.int64] | None = None,
    report: OnProgress = silent,
    allowed: tuple[Mask, Mask] | None = None,
) -> StochasticGame:
    """The zero-sum game of all agents of a task: one is the row player, all others as one the
    column player.

    Args:
        states: of the game.
        seats: of all agents, the row player first.
        payoff: of the row player; the column player gets its negative.
        discount: of each step.
        twins: [states] int64, the state that stands for each: one that is the same but for the
            names of agents. Only these are looked at.
        report: called with the progress.
        allowed: [states, actions] bool of the row player and [states, joint actions] bool of the
            column player: each may use only these. None for all.

    Raises:
        ValueError: a game that does not fit into memory.
    """
    task, count = states.task, states.count
    wanted = np.ones(count, dtype=bool) if twins is None else twins == np.arange(count)
    no_others = lay_out_others(states, {})
    problem = Problem(states, seats, no_others, (payoff,), moves_first=False)
    store = filled_store(problem, wanted)
    if allowed is not None:
        store = restricted(store, *allowed)
    if twins is not None:
        store.following[:] = np.where(store.following < 0, -1, twins[store.following])
    by_step = not any(payoff.reward_weights) and not payoff.ending
    step_reward = float(any(payoff.lasting)) if by_step else None
    options = task.num_actions, task.num_actions ** (task.num_agents - 1)
    return StochasticGame(store, options, discount, step_reward, report=report)


class StochasticGame:
    """A zero-sum game of a row and a column player who choose at once, and what both play so far.

    Args:
        store: the transitions; both players decide.
        options: the numbers of actions of both players.
        discount: of each step.
        step_reward: the reward of every step if it is constant, else None.
        lotteries: [lotteries, states], the probabilities of the next states; `store.following` is
            then a state, or the number of states plus that of a lottery.
        report: called with the progress.

    Attributes:
        mixed: [states] bool, whether there is no pure saddle point; of the last sweep.
        share: of the work done before the sweep that is going on, and after it, for the reports.
    """

    def __init__(
        self,
        store: Store,
        options: tuple[int, int],
        discount: float,
        step_reward: float | None = None,
        lotteries: csr_array | None = None,
        report: OnProgress = silent,
    ) -> None:
        self.store, self.count, self.discount = store, len(store.shape), discount
        self.report, self.share = report, (0.0, 0.0)
        self.playing = store.shape[:, 0] > 0
        self.mixed = np.zeros(self.count, dtype=bool)
        self._chances = np.zeros(len(store.following))
        self._options, self._step_reward, self._lotteries = options, step_reward, lotteries

    def sweep(self, values: Values) -> tuple[Values, float]:
        """The values one step further back, and the largest change; sets what both play."""
        later = values
        if self._lotteries is not None:
            later = np.concatenate([values, self._lotteries @ values])
        target = np.zeros(self.count)
        least_mixed = max(LEAST_MIXED, SPACINGS * 10 * float(np.spacing(np.abs(values).max())))
        change = 0.0
        for first in range(0, self.count, STATES_A_REPORT):
            last = min(first + STATES_A_REPORT, self.count)
            found = sweep_games(
                later, target, self.store, self.discount, least_mixed, self._chances,
                self.mixed, first, last,
            )  # fmt: skip
            change = max(change, float(found))
            done = last / self.count
            self.report((1.0 - done) * self.share[0] + done * self.share[1])
        return target, change

    def evaluated(self) -> Values:
        """The values of what both play as it is, by a sparse linear solve."""
        from scipy.sparse import csc_array, csr_array, eye_array  # slow to import
        from scipy.sparse.linalg import splu

        chances = self._chances
        if len(self.store.slips):
            moved = np.empty((len(chances), 1))
            fill_move_chances(self.store, chances, moved)
            chances = moved[:, 0]
        ends = self.store.following < 0
        columns = np.where(ends, 0, self.store.following)
        lotteries = 0 if self._lotteries is None else self._lotteries.shape[0]
        shape, starts = (self.count, self.count + lotteries), self.store.pairs.astype(np.int32)
        following = csr_array((np.where(ends, 0.0, chances), columns, starts), shape)
        if self._lotteries is not None:
            after = following[:, self.count :] @ self._lotteries
            following = csr_array(following[:, : self.count] + after)
        following.eliminate_zeros()
        going, values = self.playing.copy(), np.zeros(self.count)
        discounts = np.where(self.store.shape[:, 3] != 0, self.discount, 1.0)
        if self._step_reward is None:
            shift = self.store.edges[:-1] - self.store.pairs[:-1]
            sides = np.arange(len(chances)) + np.repeat(shift, np.diff(self.store.pairs))
            gains = chances * self.store.sides[sides]
            rewards = csr_array((gains, columns, self.store.pairs), shape).sum(axis=1)
        else:
            rewards = np.full(self.count, self._step_reward)
            # If the game never ends every step is rewarded: exact, where a solve loses digits.
            values[going] = self._step_reward / (1.0 - self.discount)
            going &= following.sum(axis=1) < 1.0 - 1e-9
            count, before = int(going.sum()), 0
            while count > before:
                going |= following @ going > 0.0
                count, before = int(going.sum()), count
        some = np.flatnonzero(going)
        if len(some):
            within = following[some]
            scaled = within.multiply(discounts[some][:, None]).tocsr()
            system = eye_array(len(some)) - scaled[:, some]
            right = rewards[some] + scaled @ np.where(going, 0.0, values)
            values[some] = splu(csc_array(system)).solve(right)
        return values

    def strategies(self) -> tuple[Values, Values]:
        """[states, actions] of the row player and [states, joint actions] of the column player; 0
        in states that are not looked at."""
        rows, columns = (np.zeros((self.count, many)) for many in self._options)
        fill_strategies(self.store, self._chances, rows, columns)
        return rows, columns


def solve_stochastic_game(game: StochasticGame, horizon: int | None) -> tuple[Values, int]:
    """The values of a game, and the sweeps it took; ValueError as `solve_infinite_horizon`."""
    return solve_infinite_horizon(game) if horizon is None else solve_steps(game, horizon)


def solve_steps(game: StochasticGame, horizon: int) -> tuple[Values, int]:
    """Backward induction over `horizon` steps, or until nothing changes: values, and sweeps."""
    values = np.zeros(game.count)
    for sweeps in range(1, horizon + 1):
        game.share = (sweeps - 1) / horizon, sweeps / horizon
        values, change = game.sweep(values)
        if change == 0.0:
            break
    return values, sweeps


def solve_infinite_horizon(game: StochasticGame) -> tuple[Values, int]:
    """The game without an end: its values, and the sweeps it took.

    Shapley's map shrinks differences by the discount. Evaluating the two policies that a sweep
    found is Newton's method (Pollatschek and Avi-Itzhak, 1969): a few sweeps where it works, but it
    may circle. So its result is kept only where the next change is smaller than without it.

    Raises:
        ValueError: no convergence within MAX_SWEEPS.
    """
    discount = game.discount
    values = plain = np.zeros(game.count)
    bound, jumped, largest_change = np.inf, False, 1.0
    for sweeps in range(1, MAX_SWEEPS):
        following, change = game.sweep(values)
        if jumped and change > discount * bound:
            values, jumped = plain, False
            continue
        largest = max(1.0, float(np.abs(following).max()))
        smallest = max(
            JOINT_TOLERANCE * largest * (1.0 - discount) / discount,
            SPACINGS * float(np.spacing(largest)),
        )
        if change <= smallest:
            return following, sweeps
        largest_change = max(largest_change, change)
        done = float(np.log(largest_change / change) / np.log(largest_change / smallest))
        game.share = game.share[1], max(game.share[1], done)
        plain, bound, jumped = following, change, True
        values = game.evaluated()
    raise ValueError(
        f"no convergence within {MAX_SWEEPS} sweeps at discount {discount}; take a smaller one, or "
        "a horizon"
    )
