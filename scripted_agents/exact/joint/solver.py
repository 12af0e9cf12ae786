"""Exact solutions of small games: best responses of agents or teams, and values of policies.

The states of the whole game are numbered in `states`; transitions and rewards are those of the step
of `pursuit.rules`. It solves chases with teams, several evaders, races and heists.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task, checked_task
from pursuit.validation import check_discount, one_of, whole
from scripted_agents.exact.joint.opponents import (
    Policies,
    bytes_of_others,
    lay_out_others,
    policies_of,
)
from scripted_agents.exact.joint.policy import JointPlan
from scripted_agents.exact.joint.results import JointResponse, JointValues
from scripted_agents.exact.joint.states import JointStates, joint_states_of
from scripted_agents.exact.joint.sweeps import Problem, Quantity, Sweeper
from scripted_agents.exact.limits import (
    MAX_PLAN_BYTES,
    MAX_STATES,
    check_joint_states,
    why_not_team_chase,
)
from scripted_agents.exact.tolerances import MAX_SWEEPS

Objective = Literal["steps", "return", "lead"]
OBJECTIVES = ("steps", "return", "lead")


def solve_joint(
    task: Task,
    agents: str | Sequence[str],
    policies: Policies,
    horizon: int | None = 200,
    discount: float = 1.0,
    objective: Objective = "steps",
    most_states: int = MAX_STATES,
    counted: str | Sequence[str] | None = None,
) -> JointResponse:
    """The exact best response of an agent, or of several acting as one, to fixed policies.

    Against fixed policies a game is a Markov decision process over its states. Solved by backward
    induction over `horizon` steps; or with `horizon=None` by value iteration for the infinite
    horizon, to a relative error of about 1e-9. Bellman (1957); Puterman (1994).

    Args:
        task: any game in one maze.
        agents: a role (all its agents), a name, or several names.
        policies: of all other agents, by agent name or role (a name goes first): policies with a
            `distribution`, or tables [self cell, other cell, action].
        horizon: number of steps of the game (of rounds of turns), or None for infinitely many.
        discount: of each step (round), above 0 and at most 1.
        objective: "return" maximises the sum of the returns of `agents`, "lead" that sum minus the
            returns of all others; rewards are float64 here, and rounded to float32 in games.
            "steps" minimises the steps until the game is over; for evaders
            it maximises the steps until none of them is free.
        most_states: maximum number of states.
        counted: the agents whose steps and returns are the objective of `agents`, such as the team
            of a member; by default `agents`.

    Raises:
        ValueError: invalid arguments; a policy that is missing or has no known distribution; too
            many states, or too little memory; "steps" in a game in which evaders collect goals, or
            for a team of evaders and others; "return" and "lead" with a custom reward function; an
            infinite horizon without discount in which the end can be delayed forever.
    """
    task, seats = checked_task(task), _seats_of(task, agents)
    one_of("objective", objective, OBJECTIVES)
    _check(horizon, discount)
    if task.num_actions ** len(seats) > np.iinfo(np.int16).max:
        raise ValueError(
            f"{len(seats)} agents as one have {task.num_actions ** len(seats):,} joint actions; at "
            f"most {np.iinfo(np.int16).max:,} are possible: give fewer agents"
        )
    sign = _sign(task, seats, objective)
    fixed = tuple(seat for seat in range(task.num_agents) if seat not in seats)
    filled = policies_of(task, fixed, policies)
    ties = task.num_actions if len(seats) == 1 else 0
    check_joint_states(task, most_states, 16 + 2 + ties + bytes_of_others(task, filled))
    states = joint_states_of(task)
    others = lay_out_others(states, filled)
    own = seats if counted is None else _seats_of(task, counted)
    counts = [int(seat in own) for seat in range(task.num_agents)]
    nothing = [0] * task.num_agents
    lead = [1 if count else -1 if objective == "lead" else 0 for count in counts]
    what = Quantity(nothing, counts) if objective == "steps" else Quantity(lead, nothing)
    problem = Problem(states, seats, others, (what,), sign, discount)
    if horizon is None and discount == 1.0:
        _check_end(problem, for_all=sign < 0.0)
    values, choices, exact, optimal = _solve(problem, horizon, keep=True)
    mean = float(states.mean_over_starts(values)[0])
    names = tuple(task.agent_names[seat] for seat in seats)
    plan = JointPlan(states, seats, choices)
    return JointResponse(
        agents=names,
        objective=objective,
        states=states,
        values=values[:, 0],
        mean_over_starts=mean,
        policies=dict.fromkeys(names, plan),
        reaches_values=exact,
        optimal=optimal,
        horizon=horizon,
        discount=discount,
    )


def evaluate_joint(
    task: Task,
    policies: Policies,
    horizon: int | None = 200,
    discount: float = 1.0,
    agents: str | Sequence[str] | None = None,
    most_states: int = MAX_STATES,
) -> JointValues:
    """The mean steps and returns of all agents when all play `policies`.

    Arguments and errors as of `solve_joint`; `agents` are those with steps and returns in the
    result, by default all. Each of them takes 32 bytes per state.
    """
    task = checked_task(task)
    seats = tuple(range(task.num_agents)) if agents is None else _seats_of(task, agents)
    unit, nothing = np.eye(task.num_agents, dtype=np.int64).tolist(), [0] * task.num_agents
    wanted = lengths_of(task)
    for seat in seats:
        wanted[f"steps of {task.agent_names[seat]}"] = Quantity(nothing, unit[seat])
        if task.reward_function is None:
            wanted[f"return of {task.agent_names[seat]}"] = Quantity(unit[seat], nothing)
    states, values = quantities_of(task, policies, wanted, horizon, discount, most_states)
    means = dict(zip(wanted, states.mean_over_starts(values).tolist(), strict=True))
    names = [task.agent_names[seat] for seat in seats]
    paid = names if task.reward_function is None else []
    return JointValues(
        states,
        means["length"],
        means["ended"],
        {name: means[f"steps of {name}"] for name in names},
        {name: means[f"return of {name}"] for name in paid},
        {key: values[:, at] for at, key in enumerate(wanted)},
    )


def lengths_of(task: Task) -> dict[str, Quantity]:
    """The steps until the game is over, and whether it terminates."""
    nothing = [0] * task.num_agents
    return {
        "length": Quantity(nothing, [1] * task.num_agents),
        "ended": Quantity(nothing, nothing, 1.0),
    }


def quantities_of(
    task: Task,
    policies: Policies,
    wanted: Mapping[str, Quantity],
    horizon: int | None,
    discount: float,
    most_states: int = MAX_STATES,
) -> tuple[JointStates, NDArray[np.float64]]:
    """The states of a game, and [states, quantities] expectations when all play `policies`."""
    _check(horizon, discount)
    filled = policies_of(task, range(task.num_agents), policies)
    each = 16 * len(wanted) + 2 + bytes_of_others(task, filled)
    check_joint_states(task, most_states, each)
    states = joint_states_of(task)
    others = lay_out_others(states, filled)
    problem = Problem(states, (), others, tuple(wanted.values()), 1.0, discount)
    if horizon is None and discount == 1.0:
        _check_end(problem, for_all=True)
    values, *_ = _solve(problem, horizon, keep=False)
    return states, values


# -- the chase of one evader by a team -------------------------------------------------------------


def best_team_response(
    task: Task, role: str, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> JointResponse:
    """The exact best response of a side of a chase, acting as one player, to fixed policies.

    Chasers minimise the expected steps until capture, the evader maximises them: `solve_joint` with
    the objective "steps", and values [chaser cell, ..., evader cell].

    Args:
        task: a chase of one evader by one or more chasers in one maze, with random starts.
        role: "chaser" or "evader"; or one agent ("chaser_1"), the others playing `policies`.
        policies: of all other agents, by agent name or role; a name goes first.
        horizon: the number of steps after which the game is cut, or None.
        discount: what a step counts in terms of the one before it; above 0, at most 1, and below 1
            without a horizon.

    Raises:
        ValueError: another task; a policy that is missing, or no known distribution; arguments
            outside these limits; a game that does not fit into memory.
    """
    _check_team(task, horizon, discount)
    one_of("role", role, ("chaser", "evader", *task.agent_names))
    best = solve_joint(task, role, policies, horizon, discount)
    return replace(best, values=_by_cells(best.values, task))


def evaluate_team(
    task: Task, policies: Policies, horizon: int | None = 200, discount: float = 1.0
) -> NDArray[np.float64]:
    """The expected number of steps until capture when all agents play `policies`.

    The same quantity as `best_team_response(...).values`, arguments and errors as there.
    """
    _check_team(task, horizon, discount)
    wanted = {"length": lengths_of(task)["length"]}
    _, values = quantities_of(task, policies, wanted, horizon, discount)
    return _by_cells(values[:, 0], task)


def team_survival(
    task: Task, policies: Policies, horizon: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`evaluate_team` for a horizon, and the probability of no capture within it."""
    _check_team(task, horizon, 1.0)
    _, values = quantities_of(task, policies, lengths_of(task), horizon, 1.0)
    length, ended = (_by_cells(values[:, quantity], task) for quantity in range(2))
    return length, np.where(length > 0.0, 1.0 - ended, 0.0)


def mean_over_team_starts(
    values: NDArray[np.float64], task: Task, least: int | None = None
) -> float:
    """The mean of `values` [chaser cell, ..., evader cell] over the starts that the game draws.

    All agents are in different cells, every chaser at least `least` steps from the evader (the
    task's `min_start_distance` if left out), all such placements equally likely.

    Raises:
        ValueError: there is no such placement.
    """
    return float(joint_states_of(task).mean_over_starts(np.ravel(values), least))


def _by_cells(values: NDArray[np.float64], task: Task) -> NDArray[np.float64]:
    """[chaser cell, ..., evader cell] from [states], which are numbered in this order."""
    return values.reshape((task.max_cells,) * task.num_agents)


def _check_team(task: Task, horizon: int | None, discount: float) -> None:
    obstacle = why_not_team_chase(task)
    if obstacle is not None or task.start != "random":
        raise ValueError(
            f"task {task.name!r} has {obstacle or 'starts at marks'}; chases of one evader by any "
            "number of chasers, without goals and in one maze with random starts, are solved here"
        )
    if horizon is None and discount == 1.0:
        raise ValueError("discount 1.0; below 1 where there is no horizon")


# -- solving ---------------------------------------------------------------------------------------


def _solve(
    problem: Problem, horizon: int | None, keep: bool
) -> tuple[NDArray[np.float64], NDArray[np.integer], bool, NDArray[np.bool_] | None]:
    """Values [states, quantities], choices [steps, states], whether those are of all steps, and of
    an agent alone `JointResponse.optimal`."""
    states, decide = problem.states, problem.states.task.num_actions ** len(problem.deciding)
    values = np.zeros((states.count, len(problem.quantities)))
    choice = np.zeros(states.count, dtype=np.int16)
    small: Any = np.uint8 if decide <= 256 else np.int16
    if horizon is not None:
        horizon *= states.numbering.halves
    with Sweeper(problem, values, choice) as sweeper:
        if horizon is None:
            if not sweeper.converge():
                raise ValueError(
                    f"value iteration has not converged after {MAX_SWEEPS} sweeps: the end of the "
                    "game is too rare; give a horizon, or a smaller discount"
                )
            return values, choice.astype(small)[None], True, sweeper.optimal()
        plan: list[NDArray[np.integer]] = []
        workspace = MAX_PLAN_BYTES // np.dtype(small).itemsize // states.count
        before = 0
        for before in sweeper.steps(horizon):
            if keep and before <= workspace:
                plan.append(choice.astype(small))
        optimal = sweeper.optimal()
        if before > workspace or not keep:
            return sweeper.values, choice.astype(small)[None], False, optimal
        if horizon > workspace:  # the stored plan has only the last steps
            return sweeper.values, plan[-1][None], False, optimal
        # After convergence, earlier steps are equal to the last one computed.
        steps = np.stack([*[plan[-1]] * (horizon - before), *plan[::-1]])
        return sweeper.values, steps, True, optimal


def _check_end(problem: Problem, for_all: bool) -> None:
    """ValueError unless the expected end is finite in every state: in a finite game, if the end is
    reachable by some actions of the deciding agents, or by all (`for_all`)."""
    states, task = problem.states, problem.states.task
    ending = Quantity([0] * task.num_agents, [0] * task.num_agents, 1.0)
    sign = 1.0 if for_all else -1.0
    question = Problem(states, problem.deciding, problem.others, (ending,), sign, only_whether=True)
    over = np.zeros(states.count, dtype=bool)
    offsets = states.numbering.offsets
    for group, mask in enumerate(states.numbering.masks.tolist()):  # no agent that counts is free
        if not problem.counts(mask):
            over[offsets[group] : offsets[group + 1]] = True
    values = over.astype(np.float64)[:, None]
    with Sweeper(question, values, np.zeros(states.count, dtype=np.int16)) as sweeper:
        sweeper.converge()
    for first, games, real in states.chunks():
        stuck = real & (values[first : first + len(real), 0] == 0.0)
        if stuck.any():
            where = int(np.argmax(stuck))
            raise ValueError(
                f"task {task.name!r} on {task.mazes[0].name}: the end of the game can be delayed "
                "forever, so the expectation is infinite (first from the cells "
                f"{games.position[where].tolist()} and goals {games.goal[where].tolist()}); give a "
                "horizon, or a discount below 1"
            )


# -- arguments -------------------------------------------------------------------------------------


def _check(horizon: int | None, discount: float) -> None:
    if horizon is not None:
        whole("horizon", horizon, 1)
    check_discount(discount)


def _seats_of(task: Task, agents: str | Sequence[str]) -> tuple[int, ...]:
    """The indices of the agents of a role, of one agent, or of several, in order."""
    if isinstance(agents, str):
        if agents in task.seat_roles:
            return tuple(s for s, role in enumerate(task.seat_roles) if role == agents)
        agents = [agents]
    if not isinstance(agents, Iterable):
        raise ValueError(f"agents={agents!r}; give a role, an agent, or several agents")
    seats = sorted({task.seat(agent) for agent in agents})
    if not seats:
        raise ValueError("agents=(); give a role, an agent, or several agents")
    return tuple(seats)


def _sign(task: Task, seats: tuple[int, ...], objective: Objective) -> float:
    """1 to minimise the quantity, -1 to maximise it."""
    if objective != "steps":
        if task.reward_function is not None:
            raise ValueError(
                f"task {task.name!r} has a custom reward function; only coefficients are "
                "known exactly: take objective='steps', or rewards by coefficients"
            )
        return -1.0
    roles = {task.seat_roles[seat] for seat in seats}
    if task.num_goals and task.num_evaders:
        raise ValueError(
            f"objective='steps' in task {task.name!r}: evaders collect goals, and a game ends by "
            "a capture as by the last goal, so few steps are no aim; take objective='return'"
        )
    if "evader" in roles and len(roles) > 1:
        raise ValueError(
            f"objective='steps' for {', '.join(sorted(roles))} as one: evaders want many steps and "
            "the others few; take objective='return'"
        )
    return -1.0 if "evader" in roles else 1.0
