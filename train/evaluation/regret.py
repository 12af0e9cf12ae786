"""Which states a policy loses in: the gap to the exact optimum, taken apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.simulator.policy import Policy
from scripted_agents import duel_regret, tour_lengths
from scripted_agents.tours.tour import MAX_EXACT_GOALS
from train.evaluation.contest import GameContest
from train.evaluation.games import is_table_in, table_in
from train.settings.checks import check

REMEDY = "regret is of a duel of tables or of a runner alone, in one maze, with full sight"

Column = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Regret:
    """What a policy loses in which states; the losses sum up to the whole gap.

    Attributes:
        optimum, achieved: mean steps of a game.
        exact: whether they are over all starts; else over the games that were played.
        unsolved: the share of what is lost that games lose that run out of time, a runner's.
        cell, other: [states] where the agent is, and where the other one, or of a runner the
            nearest goal (-1 where none is).
        goals_left: [states], 0 in duels.
        distance: [states] path steps between both.
        action_gap: [states] steps by which the second best value of an action is worse than the
            best, a runner's moves into walls left out; inf where all are equal.
        visits, lost: [states] how often a game is there, and what it loses there: steps of the gap.
    """

    optimum: float
    achieved: float
    exact: bool
    unsolved: float
    cell: NDArray[np.int64]
    other: NDArray[np.int64]
    goals_left: NDArray[np.int64]
    distance: NDArray[np.int64]
    action_gap: Column
    visits: Column
    lost: Column


def regret_of(contest: GameContest, policy: Policy) -> Regret:
    """What the policy loses, and where.

    Of a duel by two sweeps over all pairs of cells and steps (`scripted_agents.duel_regret`); of a
    runner alone from the contest's games: a step loses by how much the shortest tour that is left
    becomes longer, that step included, and the steps of a game lose its length less its shortest
    tour. A tour that the time limit would cut counts as the time that is left.

    Raises:
        ValueError: a task that has neither form, in a duel a policy with a memory, or goals above
            `MAX_EXACT_GOALS`.
    """
    task = contest.task
    check(len(task.mazes) == 1, f"{len(task.mazes)} mazes; {REMEDY}")
    check(task.sight.limits[task.seat(contest.agent)].sees_all, f"limited sight; {REMEDY}")
    if task.is_duel:
        told = "a policy that is no table (it remembers, or is none)"
        check(contest.is_exact and is_table_in(task, policy), f"{told}; {REMEDY}")
        return _of_duel(contest, policy)
    alone = task.num_agents == 1 and task.num_goals > 0
    check(alone, f"task {task.name!r} of {', '.join(task.agent_names)}; {REMEDY}")
    check(
        task.num_goals <= MAX_EXACT_GOALS,
        f"num_goals={task.num_goals}; shortest tours are exact up to {MAX_EXACT_GOALS}",
    )
    return _of_runner(contest, policy)


def _of_duel(contest: GameContest, policy: Policy) -> Regret:
    task, maze = contest.task, contest.task.mazes[0]
    role: Any = contest.role
    order: Any = task.move_order
    found = duel_regret(
        role, maze, table_in(task, policy), contest.opponent_table(),
        task.max_steps, order, task.min_start_distance,
    )  # fmt: skip
    own, other = np.nonzero(found.visits > 0.0)
    at = own, other
    return Regret(
        found.optimum, found.achieved, True, 0.0, own, other, np.zeros(len(own), np.int64),
        maze.distances[at].astype(np.int64), found.action_gap[at], found.visits[at],
        found.regret[at],
    )  # fmt: skip


def _of_runner(contest: GameContest, policy: Policy) -> Regret:
    task, maze = contest.task, contest.task.mazes[0]
    simulator = contest.starts()
    policies = [policy]
    games, actions = np.arange(contest.episodes), np.zeros((contest.episodes, 1), dtype=np.int32)
    # Sorted: which of the goals is which makes no difference to the state.
    goals = np.sort(simulator.goals, axis=1)
    left = shortest(maze, simulator.positions[:, 0], goals, task.max_steps)
    optimum, rows = float(left.mean()), []
    for step in range(1, task.max_steps + 1):
        cells = simulator.positions[games, 0].astype(np.int64)
        simulator.act(policies, actions)
        simulator.step(actions)
        after = np.sort(simulator.goals[games], axis=1)
        over = (after < 0).all(axis=1)
        then = shortest(maze, simulator.positions[games, 0], after, task.max_steps - step)
        rows.append(np.column_stack([games, cells, 1 + then - left, goals]))
        games, goals, left = games[~over], after[~over], then[~over]
        if not len(games):
            break
    states = np.concatenate(rows)
    late = np.isin(states[:, 0], games)
    lost, total = states[:, 2].astype(np.float64), contest.episodes
    keys, place = np.unique(states[:, [1, *range(3, states.shape[1])]], axis=0, return_inverse=True)
    place = place.ravel()
    nearest, distance = nearest_goals(maze, keys[:, 0], keys[:, 1:])
    return Regret(
        optimum,
        len(states) / total,
        False,
        float(lost[late].sum() / lost.sum()) if lost.sum() else 0.0,
        keys[:, 0],
        nearest,
        (keys[:, 1:] >= 0).sum(axis=1),
        distance,
        runner_gaps(maze, keys[:, 0], keys[:, 1:]),
        np.bincount(place, minlength=len(keys)) / total,
        np.bincount(place, lost, len(keys)) / total,
    )


def shortest(maze: Maze, cells: Any, goals: Any, limit: int) -> NDArray[np.int64]:
    """[states] the shortest tours from there, at most the steps that are left."""
    return np.minimum(tour_lengths(maze, cells, goals), limit)


def nearest_goals(maze: Maze, cells: Any, goals: Any) -> tuple[Any, NDArray[np.int64]]:
    """[states] the nearest goal that is left, and how far it is; -1 and 0 where none is."""
    far = np.where(goals >= 0, maze.distances[cells[:, None], goals].astype(np.int64), 1 << 40)
    which = far.argmin(axis=1)[:, None]
    distance = np.take_along_axis(far, which, axis=1)[:, 0]
    return np.take_along_axis(goals, which, axis=1)[:, 0], np.where(distance < 1 << 40, distance, 0)


def runner_gaps(maze: Maze, cells: Any, goals: Any) -> Column:
    """[states] how much longer a tour becomes by the second best value of a move; inf without.

    Moves into walls, which cost one step everywhere, do not count.
    """
    worth = np.empty((len(cells), 4))
    for action in range(4):
        to = maze.neighbors[cells, action]
        worth[:, action] = tour_lengths(maze, to, np.where(goals == to[:, None], -1, goals))
        worth[to == cells, action] = np.inf
    worse = worth - worth.min(axis=1)[:, None]
    return np.asarray(np.where(worse > 0.0, worse, np.inf).min(axis=1))


# -- tables ----------------------------------------------------------------------------------------

Group = tuple[str, NDArray[np.bool_]]


def between(values: NDArray[Any], ends: list[float], whole: bool = False) -> list[Group]:
    """From each end to the next: the name of the group, and [states] whether they lie in it.

    Infinite values lie in none.
    """
    found: list[Group] = []
    for low, high in zip(ends, [*ends[1:], np.inf], strict=True):
        name = f"{low:g} to below {high:g}"
        if high == np.inf:
            name = f"{low:g} and more"
        elif whole:
            name = f"{low:g}" if high == low + 1 else f"{low:g} to {high - 1:g}"
        found.append((name, (values >= low) & (values < high)))
    return found


def groups_of(regret: Regret) -> dict[str, list[Group]]:
    """By what states are told apart, and which of them lie in which group."""
    found: dict[str, list[Group]] = {}
    goals, gaps, head = regret.goals_left, [0.0, 0.01, 0.1, 0.5, 1.0, 2.0], "distance between both"
    runner = bool((goals > 0).any())
    if runner:
        gaps, head = [1.0, 2.0, 3.0, 5.0], "distance to the nearest goal"
        left = range(int(goals.max()), 0, -1)
        found["goals left"] = [(str(number), goals == number) for number in left]
    found[head] = between(regret.distance, [1.0, 2.0, 3.0, 5.0, 9.0], whole=True)
    equal: Group = ("all are equal", np.isinf(regret.action_gap))
    found["action gap, steps"] = [*between(regret.action_gap, gaps, whole=runner), equal]
    return found


def group_rows(regret: Regret) -> list[dict[str, Any]]:
    """A row for each group that is visited: visits a game, steps lost a game, and the shares."""
    whole = abs(regret.achieved - regret.optimum)
    rows = []
    for by, groups in groups_of(regret).items():
        for name, here in groups:
            visits, lost = float(regret.visits[here].sum()), float(regret.lost[here].sum())
            if visits > 0.0:
                row = {
                    "by": by,
                    "group": name,
                    "states": int(here.sum()),
                    "visits": visits,
                    "lost": lost,
                    "share": lost / whole if whole else 0.0,
                    "per_visit": lost / visits,
                }
                rows.append(row)
    return rows
