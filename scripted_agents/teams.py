"""The chase of one evader by a team, exactly: values of policies, and best responses to them.

The places are numbered in `places`; opponents play distributions over actions that depend on the
cells of all agents.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pursuit.memory import check_memory
from pursuit.policy import DistributionPolicy, Policy, places_of_agents
from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.task import Task
from scripted_agents.game_kernels import CHASERS, EVADER, respond
from scripted_agents.places import Places, places_of
from scripted_agents.team_policy import TeamPlan

MAX_BYTES = 3 * 10**9
"""Bound on the memory of an evaluation or a best response."""

MAX_PLAN_BYTES = 5 * 10**8
"""Bound on a plan for every step; above it the plan of the first step is played throughout."""

TOLERANCE = 1e-9
"""How exact stationary values are, relative to the largest."""

MAX_SWEEPS = 100_000

Policies = Mapping[str, Policy]


@dataclass(frozen=True, eq=False)
class TeamResponse:
    """What `best_team_response` found.

    Attributes:
        role: who responds: a role, whose agents move as one, or the name of one agent.
        values: [chaser cell, ..., evader cell] float64, expected steps until capture (the capturing
            step included), cut at the horizon; 0 where a chaser stands on the evader. With a
            discount the step t = 0, 1, ... counts discount**t.
        mean_over_starts: the mean of `values` over the starts that the game draws.
        policy: a `Policy` for the seats of whoever responds, that reaches the values.
        horizon, discount: of the problem.
    """

    role: str
    values: NDArray[np.float64] = field(repr=False)
    mean_over_starts: float
    policy: TeamPlan = field(repr=False)
    horizon: int | None
    discount: float


def best_team_response(
    task: Task, role: str, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> TeamResponse:
    """The best that a side of a chase can do, its agents moving as one, against fixed policies.

    Against fixed policies the game is a Markov decision process over the cells of all agents.
    Chasers minimise the expected steps until capture, the evader maximises them. Solved by backward
    induction over `horizon` steps, exactly; or with `horizon=None` by value iteration for the
    problem without an end, to a relative error of about 1e-9. Bellman (1957).

    Args:
        task: a chase of one evader by one or more chasers in one maze, with random starts.
        role: "chaser" or "evader"; or one agent ("chaser_1"), the others playing `policies`.
        policies: of everybody else, by agent name or role; a name goes first.
        horizon: the number of steps after which the game is cut, or None.
        discount: what a step counts in terms of the one before it; above 0, at most 1, and below 1
            without a horizon.

    Raises:
        ValueError: another task; a policy that is missing, or no known distribution; arguments
            outside these limits; a game that does not fit into memory.
    """
    _check(task, horizon, discount)
    known = {*task.agent_names, "chaser", "evader"}
    if role not in known:
        raise ValueError(f"role {role!r}; one of {', '.join(sorted(known))}")
    chasers, actions = task.num_chasers, task.num_actions
    seats = tuple(range(chasers)) if role == "chaser" else (task.seat(role),)
    places, games = _places(task), places_of_agents(task)
    fixed = tuple(seat for seat in range(task.num_agents) if seat not in seats)
    tables = _Tables(places, games, task, policies)
    weights = tables.joint(tuple(seat for seat in fixed if seat < chasers))
    chances = tables.evader() if chasers in fixed else np.zeros((1, 1, 1))
    who, groups = EVADER, np.zeros(len(places.parts), dtype=np.int64)
    if chasers not in seats:
        who, groups = CHASERS, _group(places.parts[:, list(seats)], actions)
    values, _, choices = _sweeps(task, places, who, groups, weights, chances, horizon, discount)
    if who == EVADER:
        plan = choices[..., None].astype(np.int8)
    else:
        first = np.array([np.argmax(groups == group) for group in range(groups.max() + 1)])
        plan = places.parts[first][:, list(seats)].astype(np.int8)[choices]
    policy = TeamPlan(task.mazes[0], places, task.seat_roles[seats[0]], plan, seats)
    mean = mean_over_team_starts(values, task)
    return TeamResponse(role, values, mean, policy, horizon, discount)


def evaluate_team(
    task: Task, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> NDArray[np.float64]:
    """The expected number of steps until capture when everybody plays `policies`.

    The same quantity as `best_team_response(...).values`, arguments and errors as there.
    """
    return _evaluate(task, policies, horizon, discount)[0]


def team_survival(
    task: Task, policies: Policies, horizon: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`evaluate_team` for a horizon, and the chance that nobody is caught within it."""
    longer, values = _evaluate(task, policies, horizon + 1, 1.0)
    # What one more step adds to the expected length is the chance of not being caught before it.
    return values, longer - values


def _evaluate(
    task: Task, policies: Policies, horizon: int | None, discount: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values, and those one sweep before."""
    _check(task, horizon, discount)
    places, games = _places(task), places_of_agents(task)
    tables = _Tables(places, games, task, policies)
    weights = tables.joint(tuple(range(task.num_chasers)))
    nothing = np.zeros(len(places.parts), dtype=np.int64)
    rest = (weights, tables.evader(), horizon, discount, False)
    values, before, _ = _sweeps(task, places, CHASERS, nothing, *rest)
    return values, before


def mean_over_team_starts(
    values: NDArray[np.float64], task: Task, least: int | None = None
) -> float:
    """The mean of `values` [chaser cell, ..., evader cell] over the starts that the game draws.

    All agents in cells of their own, every chaser at least `least` steps from the evader (the
    task's `min_start_distance` if left out), all such placements equally likely.

    Raises:
        ValueError: no placement is so.
    """
    places, maze = _places(task), task.mazes[0]
    starts = places.apart.copy()
    ordered = np.sort(places.teams, axis=1)
    starts[(np.diff(ordered, axis=1) == 0).any(axis=1)] = False
    for chaser in range(task.num_chasers):
        far = maze.distances >= (task.min_start_distance if least is None else least)
        starts &= far[places.teams[:, chaser]]
    if not starts.any():
        raise ValueError(f"min_start_distance {task.min_start_distance}: no start is so far apart")
    return float(values.reshape(starts.shape)[starts].mean())


def _group(parts: NDArray[np.int64], actions: int) -> NDArray[np.int64]:
    """[joint actions] int64: a number for the parts [joint actions, chasers] of some of them."""
    number = np.zeros(len(parts), dtype=np.int64)
    for part in parts.T:
        number = number * actions + part
    return number


# -- what can be solved ----------------------------------------------------------------------------


def why_not_team_chase(task: Task) -> str | None:
    """What is in the way of solving a task by the places of its agents; None for nothing."""
    if task.num_evaders != 1 or not task.num_chasers:
        return f"{task.num_chasers} chaser(s) and {task.num_evaders} evader(s)"
    if task.num_runners or task.num_goals:
        return f"{task.num_runners} runner(s) and {task.num_goals} goal(s)"
    return f"{len(task.mazes)} mazes" if len(task.mazes) > 1 else None


def work_of(task: Task) -> int:
    """The size of a team chase: its places times the pairs of joint and evader's actions."""
    pairs = task.num_actions ** (task.num_chasers + 1)
    return int(task.max_cells ** (task.num_chasers + 1) * pairs)


def has_distributions(task: Task, policies: Policies) -> bool:
    """Whether all policies say how they play, in the games of this task."""
    game = layout.empty_games(1, task.num_agents, 0)
    game.active[:] = 1
    for seat, policy in enumerate(_filled(task, policies)):
        if not isinstance(policy, DistributionPolicy):
            return False
        try:
            policy.distribution(task, game, seat)
        except ValueError:
            return False
    return True


def _check(task: Task, horizon: int | None, discount: float) -> None:
    obstacle = why_not_team_chase(task)
    if obstacle is not None or task.start != "random":
        raise ValueError(
            f"task {task.name!r} has {obstacle or 'starts at marks'}; chases of one evader by any "
            "number of chasers, without goals and in one maze with random starts, are solved here"
        )
    if horizon is not None and horizon < 1:
        raise ValueError(f"horizon {horizon}; give at least 1 step, or None for no horizon")
    if not 0.0 < discount <= 1.0 or (horizon is None and discount == 1.0):
        raise ValueError(
            f"discount {discount}; above 0 and at most 1, and below 1 where there is no horizon"
        )
    cells, chasers, actions = task.max_cells, task.num_chasers, task.num_actions
    # Weights, their making, the evader's chances, and what is played at each place.
    per_place = 8 * (2 * actions**chasers + 3 * actions + 4) + 16 * (chasers + 1)
    check_memory(
        f"{task.mazes[0].name}, {cells} cells and {chasers} chaser(s),",
        per_place * cells ** (chasers + 1),
        "take a smaller maze or fewer chasers, or play episodes",
        MAX_BYTES,
    )


def _places(task: Task) -> Places:
    return places_of(task.mazes[0], task.num_chasers, task.stay_action)


# -- what the others play --------------------------------------------------------------------------


def _filled(task: Task, policies: Policies) -> list[Policy | None]:
    names = zip(task.agent_names, task.seat_roles, strict=True)
    return [policies.get(name, policies.get(role)) for name, role in names]


class _Tables:
    """The distributions of whoever does not respond."""

    def __init__(self, places: Places, games: Games, task: Task, policies: Policies) -> None:
        self.places, self.games, self.task = places, games, task
        self.filled = _filled(task, policies)

    def _of(self, seat: int) -> DistributionPolicy:
        policy, name = self.filled[seat], self.task.agent_names[seat]
        if policy is None:
            raise ValueError(f"nobody fills the seat of {name}; add policies={{{name!r}: ...}}")
        if not isinstance(policy, DistributionPolicy):
            raise ValueError(
                f"{policy!r} in the seat of {name} has no distribution(task, games, seat); only "
                "policies that say how likely each action is can be answered exactly"
            )
        return policy

    def evader(self) -> NDArray[np.float64]:
        """[teams, cells, actions]."""
        seat = self.places.num_chasers
        table = self._of(seat).distribution(self.task, self.games, seat)
        return _checked(table, self.places).reshape(-1, self.places.size, table.shape[1])

    def joint(self, seats: tuple[int, ...]) -> NDArray[np.float64]:
        """[teams, cells, joint actions]: the chance of what these chasers do in a joint action.

        1 throughout for no chaser ([1, 1, joint actions]).
        """
        places, task = self.places, self.task
        if not seats:
            return np.ones((1, 1, len(places.parts)))
        actions, chasers = task.num_actions, places.num_chasers
        product = np.ones((1, *(actions,) * chasers))
        left = list(seats)
        while left:
            policy = self._of(left[0])
            mine = [seat for seat in left if id(self.filled[seat]) == id(policy)]
            joint = getattr(policy, "joint_distribution", None)
            if joint is None:
                mine = mine[:1]
                table = policy.distribution(task, self.games, mine[0])
                shape = [-1] + [actions if seat in mine else 1 for seat in range(chasers)]
                product = product * _checked(table, places).reshape(shape)
            else:
                parts = joint(task, self.games).reshape(-1, *(actions,) * chasers)
                others = tuple(seat + 1 for seat in range(chasers) if seat not in mine)
                product = product * parts.sum(axis=others, keepdims=True)
            left = [seat for seat in left if seat not in mine]
        product = np.broadcast_to(product, (len(product), *(actions,) * chasers))
        return np.ascontiguousarray(product).reshape(-1, places.size, len(places.parts))


def _checked(table: NDArray[np.float64], places: Places) -> NDArray[np.float64]:
    """Rows that sum to 1, whatever was rounded; those of places where the game is over count not.

    Raises:
        ValueError: no distribution.
    """
    total = table.sum(axis=1, keepdims=True)
    fine = (np.abs(total[:, 0] - 1.0) < 1e-4) & (table >= 0.0).all(axis=1)
    if table.shape[1] != places.neighbors.shape[1] or not fine[places.apart.ravel()].all():
        raise ValueError(
            f"a policy gives no distribution over the {places.neighbors.shape[1]} actions at some "
            "places; rows are non-negative and sum to 1"
        )
    return table / np.where(total > 0.0, total, 1.0)


# -- sweeps ----------------------------------------------------------------------------------------


def _sweeps(
    task: Task,
    places: Places,
    who: int,
    groups: NDArray[np.int64],
    weights: NDArray[np.float64],
    chances: NDArray[np.float64],
    horizon: int | None,
    discount: float,
    keep: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int16]]:
    """Values [chaser cell, ..., evader cell], those one sweep before, and choices [steps, places],
    of the first step first."""
    teams, size = len(places.teams), places.size
    values, choice = np.zeros((teams, size)), np.zeros((teams, size), dtype=np.int16)
    everybody, first = np.arange(teams), task.move_order == "chasers_first"
    plan = [choice.ravel()]

    def sweep(target: NDArray[np.float64]) -> float:
        return float(
            respond(
                values, target, places.teams, places.nexts, everybody, places.neighbors, who,
                groups, discount, first, weights, chances, choice, 0, teams,
            )
        )  # fmt: skip

    if horizon is None:
        for _ in range(MAX_SWEEPS):
            change, largest = sweep(values), max(1.0, float(values.max()))
            if change * discount <= (1.0 - discount) * TOLERANCE * largest:
                break
            if change <= 4 * np.spacing(largest):
                break
        else:
            raise ValueError(
                f"discount {discount}: no convergence within {MAX_SWEEPS} sweeps; take a smaller "
                "one, or a horizon"
            )
        values = values.reshape(places.shape)
        return values, values, choice.reshape(1, -1)
    room = keep and horizon * choice.nbytes // 2 <= MAX_PLAN_BYTES
    target, plan = np.empty_like(values), []
    for _ in range(horizon):
        change = sweep(target)
        values, target = target, values
        if room:
            plan.append(choice.ravel().astype(np.int8 if len(groups) < 128 else np.int16))
        if change == 0.0:
            break
    values, target = values.reshape(places.shape), target.reshape(places.shape)
    steps = np.stack(plan[::-1]) if plan else choice.reshape(1, -1)
    if room and len(plan) < horizon:  # nothing changed any more: as at the first step
        more = np.broadcast_to(steps[:1], (horizon - len(plan), steps.shape[1]))
        steps = np.concatenate([more, steps])
    return values, target, steps
