"""Placements: starts that keep chasers and evaders as far apart, and as near, as is asked.

Uniform over all placements that hold, and never a matter of luck. The rule book draws placements
until one holds (`rules.starts`), which is quickest where many do. Where none of its tries did, the
start is chosen here, from the same distribution: all that hold are counted, and one is taken.
Teams of which there are too many placements to count are drawn on and on; so that this ends, one
must have been found as the distances were set. What cannot be placed is refused there.

Distances are path steps. Cells that no path joins are infinitely far apart: every minimum holds
for them, and no maximum does.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.rules import UNREACHABLE, count_partners, draw_uniform, layout, place_games
from pursuit.rules.layout import STARTS_STREAM, Games, NextEpisode, Teams

MAX_WORK = 5 * 10**9
"""Multiplications of a count, at most: about a second. Beyond, teams are not counted."""

TRIES = 20_000
"""Random placements among which one must be found where they are too many to count."""

Uniform = Callable[[], float]


class Apart(NamedTuple):
    """How chasers and evaders are to be placed in one maze.

    Attributes:
        maze: where.
        teams: how many of each there are.
        marked: whether whoever has a mark starts on it.
        num_goals: the goals that the episode begins with.
        least, most: path steps between every chaser and every evader; no maximum is -1.
    """

    maze: Maze
    teams: Teams
    marked: bool
    num_goals: int
    least: int
    most: int

    @property
    def is_free(self) -> bool:
        """Whether every placement holds."""
        away = self.least > 1 or self.most >= 0
        return not (away and self.teams.chasers and self.teams.evaders)


def check_placeable(asked: Apart) -> None:
    """Refuse what no placement meets.

    Raises:
        ValueError: there is none; or they are too many to count, and so rare that none was found.
    """
    if asked.is_free or placements_of(asked).exist:
        return
    maze, teams = asked.maze, asked.teams
    wishes = [f"min_start_distance={asked.least}"] if asked.least > 1 else []
    wishes += [f"max_start_distance={asked.most}"] if asked.most >= 0 else []
    raise ValueError(
        f"{' and '.join(wishes)}: {teams.chasers} chaser(s) and {teams.evaders} evader(s) cannot "
        f"be placed so in maze {maze.name}{_why(asked)}. {_remedy(asked)}"
    )


def _why(asked: Apart) -> str:
    if not placements_of(asked).counted:
        return f": none of {TRIES} random placements holds, and there are too many to count"
    if asked.marked and (asked.maze.start_mark is not None or asked.maze.goal_marks):
        return " with its marks"
    if asked.maze.num_cells > MAX_TABLE_CELLS:
        return ""
    return f", where the longest distance is {asked.maze.longest_distance}"


def _remedy(asked: Apart) -> str:
    if asked.most < 0:
        return "Lower it, or take a larger maze"
    if asked.least <= 1:
        return "Raise it, or take fewer agents"
    return "Lower the minimum, raise the maximum, or take another maze"


@lru_cache(maxsize=64)
def placements_of(asked: Apart) -> Placements:
    """The placements of chasers and evaders that hold, counted once."""
    return Placements(asked)


class Placements:
    """All placements of chasers and evaders that hold.

    The smaller team, of those without a mark, is the *leaders*: one leader after the other is
    chosen by the number of placements that it leaves, then the *followers* uniformly among the
    cells that are right for all leaders.

    Args:
        asked: what is to hold.

    Attributes:
        asked: the same.
        exist: whether there are any.
        counted: whether they are few enough to be counted, so that `draw` can be called.
    """

    def __init__(self, asked: Apart) -> None:
        self.asked = asked
        teams, maze = asked.teams, asked.maze
        if maze.num_cells <= MAX_TABLE_CELLS:
            _ = maze.distances  # searches no more
        self._chasers, self._evaders = _on_marks(asked)
        free = (teams.chasers - len(self._chasers), teams.evaders - len(self._evaders))
        self._chasers_lead = free[0] <= free[1]
        self._num_leaders, self._num_followers = sorted(free)
        open_cells = np.ones(maze.num_cells, dtype=bool)
        open_cells[[*self._chasers, *self._evaders, *_marked_goals(asked)]] = False
        self._open = open_cells
        for_chasers, for_evaders = open_cells.copy(), open_cells.copy()
        for cell in self._evaders:
            for_chasers &= self._right_for(cell)
        for cell in self._chasers:
            for_evaders &= self._right_for(cell)
        pools = (for_chasers, for_evaders) if self._chasers_lead else (for_evaders, for_chasers)
        self._lead_pool, self._follow_pool = pools
        self._marks_hold = all(self._right_for(c)[e] for c in self._chasers for e in self._evaders)
        self.counted = not self._marks_hold or self._is_countable()
        self.exist = self._marks_hold and (self._exist() if self.counted else self._found())

    def draw(self, uniform: Uniform) -> tuple[list[int], list[int]]:
        """The cells of the chasers and of the evaders; `uniform` gives numbers in [0, 1)."""
        right, leaders = self._follow_pool.copy(), list[int]()
        for left in range(self._num_leaders, 0, -1):
            counts = self._first if not leaders else self._counts(right, leaders, left)
            leader = _pick(counts, uniform())
            leaders.append(leader)
            right &= self._right_for(leader)
        cells = np.flatnonzero(right)
        for i in range(self._num_followers):
            j = i + int(uniform() * (len(cells) - i))
            cells[[i, j]] = cells[[j, i]]
        followers = cells[: self._num_followers].tolist()
        chasers, evaders = (leaders, followers) if self._chasers_lead else (followers, leaders)
        return self._chasers + chasers, self._evaders + evaders

    def _right_for(self, cell: int) -> NDArray[np.bool_]:
        """[cells] bool: which are as far from a cell, and as near, as is asked."""
        away = self.asked.maze.distances_from(cell)
        right = away >= self.asked.least
        if self.asked.most >= 0:
            right &= (away <= self.asked.most) & (away != UNREACHABLE)
        return right

    def _is_countable(self) -> bool:
        if self._num_leaders < 2:
            return True
        if self.asked.maze.num_cells > MAX_TABLE_CELLS:
            return False
        self._leave_out_useless()
        leaders, followers = int(self._lead_pool.sum()), int(self._follow_pool.sum())
        return leaders**self._num_leaders * followers <= MAX_WORK

    def _leave_out_useless(self) -> None:
        """Take out of the pools the cells that have too few partners to be in any placement."""
        right = np.stack([self._right_for(cell) for cell in range(self.asked.maze.num_cells)])
        while True:
            right &= self._lead_pool[:, None] & self._follow_pool
            lead = right.sum(axis=1) >= self._num_followers
            follow = right.sum(axis=0) >= self._num_leaders
            if (lead == self._lead_pool).all() and (follow == self._follow_pool).all():
                break
            self._lead_pool, self._follow_pool = lead, follow
        self._right = right.astype(np.float32)

    def _exist(self) -> bool:
        """Whether any holds: asked of few cells first, where all are many."""
        if self._num_leaders == 0:
            return int(self._follow_pool.sum()) >= self._num_followers
        if self._num_leaders == 1 and self.asked.maze.num_cells > MAX_TABLE_CELLS:
            for cell in self._far_cells:
                enough = (self._right_for(cell) & self._follow_pool).sum() >= self._num_followers
                if self._lead_pool[cell] and enough:
                    return True
        return bool(self._first.any())

    def _found(self) -> bool:
        """Whether one of TRIES random placements holds."""
        asked = self.asked
        teams = asked.teams._replace(runners=0)
        memory = layout.allocate(1, teams.chasers + teams.evaders, teams.goals)
        coming: NextEpisode = layout.named(layout.next_episode_of, memory)
        coming.min_start_distance[:], coming.max_start_distance[:] = asked.least, asked.most
        coming.num_goals[:] = asked.num_goals
        numbers = layout.numbers_of(teams, 0, 0, False, asked.marked)
        pay = np.zeros((3, len(layout.Pay._fields)))
        room = layout.scratch_for(asked.maze.num_cells, sum(teams[:2]), teams.goals)
        arrays = lay_out((asked.maze,))
        found = place_games(*memory, numbers, pay, *arrays, room, np.ones(1, dtype=bool), TRIES)
        return bool(found == layout.OK)

    # -- counts ----------------------------------------------------------------------------------

    @cached_property
    def _first(self) -> NDArray[np.float64]:
        """[cells] float64: with each as the first leader, how many placements hold."""
        if self._num_leaders > 1:
            return self._counts(self._follow_pool, [], self._num_leaders)
        maze = self.asked.maze
        counts = np.zeros(maze.num_cells, dtype=np.int64)
        room = np.full((2, maze.num_cells), -1, dtype=np.int32)
        leaders, (least, most) = self._that_reach_far(), self.asked[-2:]
        count_partners(*lay_out((maze,)), leaders, least, most, room[0], room[1], counts)
        for cell in np.flatnonzero(~self._follow_pool):
            counts -= self._right_for(int(cell))
        # Of whoever was not counted nothing is known but that they have no partners.
        counts[~self._lead_pool] = 0
        return _ways(np.maximum(counts, 0), self._num_followers)

    def _that_reach_far(self) -> NDArray[np.int64]:
        """The leaders' cells, without those of which a few searches tell that they are too near.

        No cell is farther from c than d(c, z) plus the largest distance from z.
        """
        cells = np.flatnonzero(self._lead_pool)
        if self.asked.maze.num_cells <= MAX_TABLE_CELLS:
            return cells
        near = np.zeros(self.asked.maze.num_cells, dtype=bool)
        for cell in self._far_cells:
            away = self.asked.maze.distances_from(cell).astype(np.int64)
            if away.max() < UNREACHABLE:
                near |= away + away.max() < self.asked.least
        return cells[~near[cells]]

    @cached_property
    def _far_cells(self) -> list[int]:
        """Two cells that are far apart, and one in the middle between them."""
        maze = self.asked.maze
        one = _farthest(maze.distances_from(0))
        from_one = maze.distances_from(one)
        other = _farthest(from_one)
        from_other = maze.distances_from(other)
        between = np.maximum(from_one, from_other)
        return [one, other, int(between.argmin())]

    def _counts(
        self, right: NDArray[np.bool_], leaders: list[int], left: int
    ) -> NDArray[np.float64]:
        """[cells] float64: with each as the next of the `left` leaders, how many placements hold.

        Args:
            right: [cells] bool, those that are right for all leaders so far.
            leaders: their cells.
            left: how many leaders are to be chosen, this one included.
        """
        open_cells = self._lead_pool.copy()
        open_cells[leaders] = False
        if left == 1:
            sizes = self._right @ right.astype(np.float32)
            return np.asarray(_ways(sizes, self._num_followers) * open_cells)
        counts = np.zeros(len(open_cells))
        for cell in np.flatnonzero(open_cells).tolist():
            others = right & (self._right[cell] > 0)
            if others.sum() >= self._num_followers:
                counts[cell] = self._counts(others, [*leaders, cell], left - 1).sum()
        return counts


def _on_marks(asked: Apart) -> tuple[list[int], list[int]]:
    """The cells of the chasers and evaders that have marks, as the rule book places them."""
    maze = asked.maze
    if not asked.marked:
        return [], []
    chasers = [] if maze.start_mark is None else [maze.start_mark]
    return chasers, list(maze.goal_marks[: asked.teams.evaders]) if not asked.teams.goals else []


def _marked_goals(asked: Apart) -> list[int]:
    """The cells of the goals that have marks."""
    return list(asked.maze.goal_marks[: asked.num_goals]) if asked.marked else []


def _ways(sizes: NDArray[Any], count: int) -> NDArray[np.float64]:
    """How many ordered choices of `count` there are of so many."""
    ways = np.ones(sizes.shape)
    for i in range(count):
        ways *= np.maximum(sizes - i, 0)
    return ways


def _pick(counts: NDArray[np.float64], uniform: float) -> int:
    """An index with a probability in proportion to its count."""
    sums = counts.cumsum()
    found = int(np.searchsorted(sums, uniform * sums[-1], side="right"))
    return min(found, int(np.flatnonzero(counts)[-1]))  # rounding: sums are floats


def _farthest(distances: NDArray[np.int32]) -> int:
    return int(np.where(distances == UNREACHABLE, -1, distances).argmax())


# -- games that have no cells yet ------------------------------------------------------------------


def place_the_unplaced(
    asked_of: Callable[[int, int, int, int], Apart],
    teams: Teams,
    games: Games,
    coming: NextEpisode,
    kernel_arrays: tuple[Any, ...],
) -> None:
    """Choose the start of every game whose first agent is UNPLACED, in the maze that it drew.

    Args:
        asked_of: what is asked in a maze, given its number, the goals wanted, and the distances.
        teams: how many of each there are.
        games, coming: of the batch.
        kernel_arrays: what every kernel over the batch is given.
    """
    unplaced = games.position[:, 0] == layout.UNPLACED
    chosen = unplaced.copy()
    streams, number = kernel_arrays[layout.Memory._fields.index("streams")], np.empty(1)
    for game in np.flatnonzero(unplaced).tolist():
        waiting = (coming.num_goals, coming.min_start_distance, coming.max_start_distance)
        numbers = (int(array[game]) for array in waiting)
        placements = placements_of(asked_of(int(games.maze[game]), *numbers))
        if not placements.counted:
            chosen[game] = False
            continue

        def uniform(stream: NDArray[np.uint64] = streams[game : game + 1]) -> float:
            draw_uniform(stream, STARTS_STREAM, number)
            return float(number[0])

        games.position[game] = layout.UNPLACED
        chasers, evaders = placements.draw(uniform)
        games.position[game, : teams.chasers + teams.evaders] = chasers + evaders
    place_games(*(*kernel_arrays, chosen, 0))
    drawn_on = unplaced & ~chosen
    while drawn_on.any():
        place_games(*(*kernel_arrays, drawn_on, TRIES))
        drawn_on &= games.position[:, 0] == layout.UNPLACED
