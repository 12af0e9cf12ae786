"""The search for proven bounds of the cost of a game with one hidden cell."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.validation import as_array, number, whole
from scripted_agents.exact.hidden.game import HiddenCell, model_of, roots_of
from scripted_agents.exact.hidden.kernels import (
    SAME,
    evaluate_plans,
    explore,
    improve,
    mark_best,
    prune_points,
)
from scripted_agents.exact.hidden.layout import (
    MIXED,
    NONE,
    LowerBound,
    Model,
    Roots,
    UpperBound,
    Workspace,
    workspace_for,
)
from scripted_agents.exact.hidden.plan_kernels import drop_plans, mark_followed
from scripted_agents.exact.hidden.start_kernels import inform, wander

DEFAULT_MEMORY = 500_000_000
"""Maximum bytes of points and plans."""

LONGEST_TRIAL = 400

LOOKS = 2000
"""Number of lookaheads between two checks of the time: some hundredths of a second."""

SHARE = 0.5
"""Target of a trial, as a share of the distance of the bounds at its root."""

GROWTH, FULL = 1.5, 0.8
"""Points and plans are pruned if their number is GROWTH times that after the last pruning, or FULL
times the maximum of one cell."""

FIRST_SLACK = 1e-6
"""Initial share of the mean distance that a point must add if memory is full; it increases."""

STEADY = 1e-12
"""Largest change, relative to the largest value, at which the initial bounds have converged."""

FIRST_SWEEPS = 2000

OnProgress = Callable[[float, float, float], None]
"""Called with the elapsed seconds and both bounds."""


class HiddenSearch:
    """Proven bounds of the least cost of a `HiddenCell`: mean over starts, and of any belief.

    Heuristic search value iteration (Smith and Simmons, 2004) with a set of points and of plans for
    every own cell. The lower bound starts with the fast informed bound (Hauskrecht, 2000). A point
    raises it for all beliefs that contain a part of it. The upper bound is the cost of plans,
    starting with a random walk. Both include a margin for rounding errors.

    Args:
        game: the game.
        memory: maximum bytes of points and plans.

    Raises:
        ValueError: more memory than available, or too little for a search.
    """

    def __init__(self, game: HiddenCell, memory: int = DEFAULT_MEMORY) -> None:
        self.game, self.model = game, model_of(game)
        self.seconds, self.looks = 0.0, 0
        own, actions = game.next_own.shape
        hidden, slots = game.visible.shape[1], self.model.cells.shape[1]
        a_point, a_plan = 8 * own * (slots + actions + 1), 8 * own * (slots + 1)
        points = min(whole("memory", memory, 1, 2**62) // 4 * 3 // a_point, 50_000)
        plans = min(memory // 4 // a_plan, 50_000)
        if min(points, plans) < 20:
            raise ValueError(
                f"memory={memory:,} bytes; give at least {20 * 4 * a_plan:,} for {own} own cells "
                f"with {slots} cells out of view"
            )
        check_memory("the search", points * a_point + plans * a_plan, "give less memory")
        informed, walk = first_bounds(self.model)
        least = informed.min(axis=2)
        self.lower_bound = LowerBound(
            least,
            _by_slot(self.model, informed.transpose(0, 2, 1)),
            np.zeros((own, slots, points)),
            np.zeros((own, points)),
            np.zeros((own, actions, points)),
            np.zeros(own, dtype=np.int64),
        )
        vectors = np.zeros((own, slots, plans))
        vectors[:, :, 0] = _by_slot(self.model, walk[:, None])[:, 0]
        self.upper_bound = UpperBound(
            walk,
            np.full((own, hidden), NONE, dtype=np.int32),
            np.zeros((own, hidden), dtype=np.int32),
            vectors,
            np.full((own, plans), NONE, dtype=np.int32),
            np.zeros((own, plans), dtype=np.int32),
            np.ones(own, dtype=np.int64),
        )
        self._workspace = workspace_for(self.model, points, plans, LONGEST_TRIAL)
        self.roots = game.starts
        cells, others = np.nonzero(game.visible)
        self._in_view = roots_of(game, cells.astype(np.int64), np.eye(hidden)[others])
        self._cursor, self.slack, self._kept = 0, 0.0, 2 * own

    @property
    def _arrays(self) -> tuple[Model, LowerBound, UpperBound, Workspace]:
        """The arguments of kernels."""
        return self.model, self.lower_bound, self.upper_bound, self._workspace

    # -- results ---------------------------------------------------------------------------------

    @property
    def margin(self) -> float:
        """A bound of the rounding error of both bounds: that of the sums of one lookahead (and of
        the identification of similar beliefs) for the largest value, over 1 / (1 - discount) steps.
        """
        most = float(np.abs(self.game.costs).max()) / (1.0 - self.game.discount)
        products = self.game.visible.shape[1] * (self.game.targets.shape[3] + 2)
        off = 4.0 * np.finfo(float).eps * products + 2.0 * SAME
        return off * most / (1.0 - self.game.discount)

    @property
    def lower(self) -> float:
        """A proven lower bound of the mean cost over the starts."""
        return float(self.roots.weight @ self.roots.low) - self.margin

    @property
    def upper(self) -> float:
        """A proven upper bound of the mean cost over the starts, which the plans attain."""
        return float(self.roots.weight @ self.roots.up) + self.margin

    @property
    def width(self) -> float:
        """The distance of the bounds relative to the one nearer to 0; inf if 0 is between them."""
        low, up = self.lower, self.upper
        if np.isinf(low) or np.isinf(up) or low < 0.0 < up:  # also before the search
            return np.inf
        least = min(abs(low), abs(up))
        return (up - low) / least if least > 0.0 else np.inf if up > low else 0.0

    @property
    def points(self) -> int:
        """Number of points of the lower bound."""
        return int(self.lower_bound.count.sum())

    @property
    def num_plans(self) -> int:
        """Number of plans of the upper bound."""
        return int(self.upper_bound.count.sum())

    def bounds(self, own_cell: int, belief: ArrayLike) -> tuple[float, float]:
        """Proven bounds of the least cost from a belief.

        Args:
            own_cell: the cell of the player.
            belief: [hidden], probabilities of the hidden cell. Cells in view are allowed, and are
                observed only from the next step on.

        Raises:
            ValueError: an invalid cell, or no distribution.
        """
        cell = whole("own_cell", own_cell, 0, len(self.model.sizes) - 1)
        row = as_array("belief", belief, "biuf", "give chances").astype(np.float64)
        if row.shape != (self.game.visible.shape[1],):
            raise ValueError(f"belief has shape {row.shape}; give {(self.game.visible.shape[1],)}")
        if not (row >= 0.0).all() or abs(row.sum() - 1.0) > 1e-6:
            raise ValueError(f"belief with sum {row.sum():.6g}; give probabilities with sum 1")
        root = roots_of(self.game, np.array([cell]), (row / row.sum())[None])
        root.seen[0] = MIXED  # no update
        self._improve(root)
        return float(root.low[0]) - self.margin, float(root.up[0]) + self.margin

    def plans(self) -> UpperBound:
        """A copy of the current upper bound, without space for more plans."""
        upper, most = self.upper_bound, self.upper_bound.count.max()
        whole = UpperBound(*(array.copy() for array in upper))
        return whole._replace(
            vectors=upper.vectors[..., :most].copy(),
            action=upper.action[:, :most].copy(),
            follow=upper.follow[:, :most].copy(),
        )

    # -- the search ------------------------------------------------------------------------------

    def improve(
        self, seconds: float, width: float | None = None, report: OnProgress | None = None
    ) -> None:
        """Continue the search for so many seconds, or until `self.width` is at most `width`.

        Raises:
            ValueError: seconds or a width below 0.
        """
        number("seconds", seconds, 0.0)
        enough = 0.0 if width is None else number("width", width, 0.0)
        self._compile()
        start, before = perf_counter(), self.seconds
        self._bound_starts()
        while self.seconds - before < seconds and self.width > enough:
            if self.upper - self.lower <= 3.0 * self.margin:
                break
            self._explore(LOOKS)
            self._improve(self._in_view)
            for _ in range(3):
                evaluate_plans(self.model, self.upper_bound)
            self._improve(self._some_points(LOOKS // 2))
            if self._is_full() or self.points + self.num_plans > GROWTH * self._kept + 100:
                self.prune()
            self.update_starts()
            if self.lower > self.upper:
                raise RuntimeError(
                    f"bounds {self.lower} and {self.upper} have crossed, which is a bug of the "
                    "search; report the maze and the arguments"
                )
            self.looks += LOOKS
            self.seconds = before + perf_counter() - start
            if report is not None:
                report(self.seconds, self.lower, self.upper)
        self.seconds = before + perf_counter() - start

    def _bound_starts(self) -> None:
        """Improve the bounds of known cells and of the starts by lookaheads."""
        largest = float(np.abs(self.upper_bound.seen).max())
        for _ in range(FIRST_SWEEPS if self.looks == 0 else 1):
            if self._improve(self._in_view) <= STEADY * largest:
                break
        self.update_starts()

    def update_starts(self) -> None:
        """Update the bounds of the starts; upper bounds are recomputed from the current plans."""
        self.roots.up[:] = np.inf
        self._improve(self.roots)

    def _compile(self) -> None:
        """Compile every kernel by calls on empty input, before the time limit starts."""
        self._explore_from(0, np.inf)
        self._improve(roots_of(self.game, np.zeros(0, dtype=np.int64), np.zeros((0, 1))))
        evaluate_plans(self.model, self.upper_bound)
        if self.looks == 0:
            self.prune()

    def _explore(self, looks: int) -> None:
        """Trials from the starts, with frequencies proportional to their shares of the distance of
        the mean bounds, until so many lookaheads are done.
        """
        roots = self.roots
        while looks > 0:
            distance = roots.weight * np.maximum(roots.up - roots.low, 0.0)
            if distance.sum() <= 0.0:
                break
            roots.credit[:] += distance
            best = int(roots.credit.argmax())
            roots.credit[best] -= distance.sum()
            looks -= self._explore_from(best, SHARE * (roots.up[best] - roots.low[best]))

    def _explore_from(self, root: int, epsilon: float) -> int:
        """A trial from a start with this target distance of its bounds; returns its length."""
        roots, work = self.roots, self._workspace
        work.own[0], work.seen[0] = roots.own[root], roots.seen[root]
        work.belief[0] = roots.belief[root]
        length = int(explore(*self._arrays, epsilon))
        roots.low[root] = max(roots.low[root], work.low.min())
        roots.up[root] = min(roots.up[root], work.up.min())
        return length

    def prune(self) -> None:
        """Remove points implied by others, and plans that are best nowhere and follow no other."""
        slack = self.margin
        if self.slack > 0.0:
            slack += self.slack * max(self.upper - self.lower, 0.0)
        for own in range(len(self.model.sizes)):
            prune_points(self.model, self.lower_bound, self._workspace, own, slack)
        upper = self.upper_bound
        used = np.zeros(upper.action.shape, dtype=bool)
        mark_best(self.model, self.lower_bound, upper, self._workspace, self.roots, used)
        mark_followed(self.model, upper, used)
        drop_plans(self.model, upper, used, np.zeros(used.shape, dtype=np.int32))
        self._kept, self._cursor = self.points + self.num_plans, 0
        if self._is_full():
            self.slack = max(4.0 * self.slack, FIRST_SLACK)

    def _is_full(self) -> bool:
        points, plans = self.lower_bound.value.shape[1], self.upper_bound.action.shape[1]
        most = int(self.lower_bound.count.max()), int(self.upper_bound.count.max())
        return most[0] > FULL * points or most[1] > FULL * plans

    def _improve(self, these: Roots) -> float:
        return float(improve(*self._arrays, these))

    def _some_points(self, count: int) -> Roots:
        """The next `count` points of the lower bound as roots."""
        counts = self.lower_bound.count
        first, total = self._cursor, self.points
        numbers = np.arange(first, min(first + count, total))
        self._cursor = first + count if first + count < total else 0
        own = np.searchsorted(counts.cumsum(), numbers, side="right")
        inverse = self.lower_bound.inverse[own, :, numbers - (counts.cumsum() - counts)[own]]
        there, slot = np.nonzero((inverse < 1e299) & (inverse > 0.0))
        beliefs = np.zeros((len(numbers), self.game.visible.shape[1]))
        beliefs[there, self.model.cells[own[there], slot]] = 1.0 / inverse[there, slot]
        return roots_of(self.game, own.astype(np.int64), beliefs)


def first_bounds(model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The initial bounds: [own, hidden, action] a lower bound of the cost with that first action,
    and [own, hidden] the cost of a random walk.
    """
    hidden, most = model.costs.shape[2], 1.0 / (1.0 - model.discount)
    own, actions = model.next_own.shape
    # The cost after the end of the game is 0, so 0 is always among the extremes.
    informed = np.full((own, hidden, actions), min(float(model.costs.min()), 0.0) * most)
    walk = np.full((own, hidden), max(float(model.costs.max()), 0.0) * most)
    enough = STEADY * max(float(np.abs(model.costs).max()), 1e-300) * most
    for sweep, values in ((inform, informed), (wander, walk)):
        for _ in range(FIRST_SWEEPS):
            if sweep(model, values) <= enough:
                break
    first = model.useful.argmax(axis=1)  # in place of actions with the effect of an earlier one
    instead = np.where(model.useful, np.arange(actions), first[:, None])
    informed = np.take_along_axis(informed, instead[:, None], axis=2)
    return informed, walk


def _by_slot(model: Model, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """[own, kinds, slot] from [own, kinds, hidden]; 0 in unused slots."""
    taken = np.take_along_axis(values, model.cells[:, None].astype(np.int64), axis=2)
    there = np.arange(model.cells.shape[1]) < model.sizes[:, None]
    return np.ascontiguousarray(np.where(there[:, None], taken, 0.0))
