"""With which exact optimum an agent is compared, or why with none: the solvers of each family.

This is the place that decides it for games in mazes, the arm and small games: for best responses,
for matches of fixed policies and for NashConv; a kind of games of one's own has a `ReturnSolver`.
`solution_of` gives the first solver that says nothing against a question. The numbers are in
`limits`. `pursuit evaluate` prints the reason where a game without limited views has no optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy, tells_its_play
from pursuit.tasks.task import Task
from scripted_agents.agents.scripted import RandomAgent
from scripted_agents.exact.joint.opponents import has_distributions, why_no_distribution
from scripted_agents.exact.limits import (
    MAX_BOUNDED_CELLS,
    MAX_EXACT_CELLS,
    MAX_EXACT_WORK,
    MAX_FINAL_WORK,
    MAX_TEAM_WORK,
    MAX_WORK,
    check_joint_states,
    count_joint_states,
    is_single_runner,
    why_no_tour,
    why_not_one_evader,
    work_of,
)
from scripted_agents.exact.long_work import why_no_time


@dataclass(frozen=True)
class Question:
    """Of what an exact value is asked.

    Attributes:
        task: the game.
        agent: who responds, by name or role; None if all policies are fixed, and their result or
            NashConv is asked.
        policies: of the other agents, by agent name or role; those of the agent's own role are of
            its teammates.
        most_work: the size (`work_of`) up to which whole games are solved.
        by_maze: whether duels in several mazes are solved maze by maze, as in suites.
        team: whether all agents of the role `agent` respond, as one player; then `most_work` is
            that of `team_work`.
    """

    task: Any
    agent: str | None
    policies: Mapping[str, Any]
    most_work: int = MAX_WORK
    by_maze: bool = False
    team: bool = False

    @cached_property
    def seats(self) -> tuple[int, ...]:
        """The indices of the agents that respond."""
        if self.agent is None:
            return ()
        if not self.team:
            return (self.task.seat(self.agent),)
        return tuple(s for s, role in enumerate(self.task.seat_roles) if role == self.agent)

    @property
    def fixed(self) -> list[Policy | None]:
        """The policies of the agents that do not respond; None for a missing one."""
        named = enumerate(zip(self.task.agent_names, self.task.seat_roles, strict=True))
        given = self.policies
        return [given.get(n, given.get(role)) for s, (n, role) in named if s not in self.seats]

    @property
    def hidden(self) -> str | None:
        """The reason why a best response with the full state is no optimum; None if it is."""
        return why_hidden(self.task, self.seats)


@dataclass(frozen=True)
class Solver:
    """One way to an exact value.

    Attributes:
        kind: its name.
        why_not: (question) -> the reason why it does not solve that; None if it does. Its docstring
            says what it solves, and with what an agent is compared: pairs of sentences, rows of
            docs/reference/exact_limits.md.
        exact: whether it gives the value itself, not bounds.
    """

    kind: str
    why_not: Callable[[Question], str | None]
    exact: bool = True


@dataclass(frozen=True)
class Solution:
    """The answer of `solution_of`.

    Attributes:
        kind: of the first solver that solves it; "none" if there is none.
        reason: why no exact value is known: that of the last exact solver; empty if one is known.
    """

    kind: str
    reason: str = ""


def solution_of(asked: Question, solvers: tuple[Solver, ...]) -> Solution:
    """The first of these solvers that has no reason against a question."""
    reason = ""
    for solver in solvers:
        why = solver.why_not(asked)
        if why is None:
            return Solution(solver.kind, "" if solver.exact else reason)
        reason = why if solver.exact else reason
    return Solution("none", reason)


class ReturnSolver(Protocol):
    """A solver of games by their expected returns; policies are by the names of agents."""

    def why_not(self, task: Any, policies: Mapping[str, Any]) -> str | None:
        """Why a game with these fixed policies is not solved; None if it is."""

    def returns(self, task: Any, policies: Mapping[str, Any]) -> NDArray[np.float64]:
        """[agents] the exact expected returns within the time limit, of policies of all agents."""

    def respond(self, task: Any, agent: str, policies: Mapping[str, Any]) -> tuple[float, Any]:
        """The best expected return of an agent (or of all of a role, the sum) within the time limit
        against the policies of the others, and the policy that has it."""


def why_hidden(task: Task, seats: Iterable[int]) -> str | None:
    """The reason why the full state is not what these agents see; None if it is."""
    return "limited view" if any(map(task.hides_from, seats)) else None


def reference_of(
    task: Task,
    agent: str,
    opponents: Mapping[str, Policy],
    most_work: int = MAX_WORK,
    by_maze: bool = False,
    team: bool = False,
) -> Solution:
    """Which exact optimum of an agent of a game in mazes is known, and if none is, the reason.

    Args:
        task: the game.
        agent, most_work, by_maze, team: as of `Question`.
        opponents: the policies of the other agents, as of `Question`.
    """
    asked = Question(task, agent, opponents, most_work, by_maze, team)
    return solution_of(asked, MAZES)


# -- what each solver takes ------------------------------------------------------------------------


def _why_no_tour(asked: Question) -> str | None:
    """One runner without other agents, up to MAX_EXACT_GOALS goals, in any mazes. Exact: the
    shortest tours."""
    if not is_single_runner(asked.task):
        return "not one runner alone"
    return asked.hidden or why_no_tour(asked.task.num_goals)


def _why_no_duel(asked: Question) -> str | None:
    """One chaser and one evader without goals at random starts in mazes of up to MAX_EXACT_CELLS
    cells (SOLVED_MAZES mazes of a suite, evenly spaced), the opponent a table over both cells.
    Exact: the best response, mean steps over all starts."""
    task, others = asked.task, asked.fixed
    by_maze = asked.by_maze and len(task.mazes) > 1
    tables = is_solvable(task, *others) if by_maze else is_table_duel(task, *others)
    return asked.hidden or (None if tables else "no small duel of tables")


def _why_no_bounds(asked: Question) -> str | None:
    """A duel as above with a limited view of the agent, in one maze of up to MAX_BOUNDED_CELLS
    cells. Certified: a proven interval of the optimum, in discounted steps."""
    if asked.hidden is None:
        return "full view"
    small = asked.task.max_cells <= MAX_BOUNDED_CELLS
    return None if small and is_table_duel(asked.task, *asked.fixed) else asked.hidden


def _why_no_team(asked: Question) -> str | None:
    """One or several chasers and one evader without goals, other than duels, at random starts:
    work up to MAX_EXACT_WORK; with exits or turns up to MAX_FINAL_WORK in final results. Exact: the
    best response of the agent, mean steps over all starts; with exits captures - escapes. A whole
    team that learns, without goals, against any number of evaders or chasers: work up to
    MAX_EXACT_WORK during training, MAX_TEAM_WORK in final results. Exact: its best response as one
    player."""
    task, policies, most = asked.task, asked.policies, asked.most_work
    if asked.team:
        return f"{task.num_goals} goal(s)" if task.num_goals else _why_no_joint(asked)
    if asked.agent is not None:
        policies = {**policies, task.agent_names[asked.seats[0]]: RandomAgent()}
        most = exact_work(task, most)
    chase = asked.hidden is None and is_exact_team(task, policies, most)
    return asked.hidden or (None if chase else "no small chase of one evader")


def _why_no_joint(asked: Question) -> str | None:
    """Any other game with full view of the agent: work up to MAX_WORK at the start of a run; up to
    MAX_EVALUATED_WORK in final results, `pursuit evaluate` and `pursuit baseline`. Exact: the best
    response of the agent from the starts of the evaluation, in steps; races in goals, heists in
    return, with exits captures - escapes."""
    task, seats = asked.task, asked.seats
    hidden = why_hidden(task, seats or range(task.num_agents))  # for NashConv all respond
    if hidden is not None or is_single_runner(task):
        return hidden or why_no_tour(task.num_goals)
    most = team_work(task, asked.most_work) if asked.team else asked.most_work
    reason = why_not_joint(task, asked.policies, most, *seats)
    by_return = not seats or (task.num_goals > 0 and task.seat_roles[seats[0]] != "runner")
    rewarded = task.reward_function is None or not by_return
    return reason or (None if rewarded else "user-defined rewards")


def _why_no_escape(asked: Question) -> str | None:
    """A game with exits and without goals in one maze, policies with known distributions. Exact:
    NashConv, in captures - escapes."""
    task = asked.task
    if not task.most_exits or task.num_goals:
        return f"{task.most_exits} exit(s) and {task.num_goals} goal(s)"
    return why_not_joint(task, asked.policies, asked.most_work, *asked.seats)


def _why_no_small_game(asked: Question) -> str | None:
    """A small game, policies of all other players that depend on the state. Exact: the best
    response, the mean return over all starts."""
    return None


def _why_no_arm(asked: Question) -> str | None:
    """The arm with continuous actions. Exact: the least steps; a bound where they are not known
    from every start."""
    discrete = asked.task.discrete_actions
    return "discrete actions; only a lower bound of the steps is known" if discrete else None


TOUR, DUEL = Solver("tour", _why_no_tour), Solver("duel", _why_no_duel)
TEAM, JOINT = Solver("team", _why_no_team), Solver("joint", _why_no_joint)
BOUNDS, ESCAPE = Solver("bounds", _why_no_bounds, exact=False), Solver("escape", _why_no_escape)
SMALL_GAME, ARM = Solver("small_game", _why_no_small_game), Solver("arm", _why_no_arm)

MAZES, SMALL_GAMES, ARMS = (TOUR, DUEL, TEAM, JOINT, BOUNDS), (SMALL_GAME,), (ARM,)
"""The solvers of best responses in each family."""
MATCHES, NASH_CONVS, INTERVALS = (DUEL, TEAM), (DUEL, TEAM, ESCAPE), (DUEL, BOUNDS)
"""Those of fixed policies in mazes: of matches, of NashConv in steps or outcomes (in returns it is
by `JOINT`), and of intervals of best responses with their views."""


# -- conditions of several solvers -----------------------------------------------------------------


def is_table_duel(task: Task, *policies: Policy | None) -> bool:
    """Whether the task is a duel in one maze at random starts, and solved (`is_solved_duel`)."""
    return len(task.mazes) == 1 and task.start == "random" and is_solved_duel(task, *policies)


def is_solved_duel(task: Task, *policies: Policy | None) -> bool:
    """Whether the task is a duel small enough to be solved, and all policies are tables."""
    return _is_small_duel(task) and all(is_table_in(task, policy) for policy in policies)


def _is_small_duel(task: Task) -> bool:
    return task.is_duel and task.max_cells <= MAX_EXACT_CELLS


def is_table_in(task: Task, policy: Any) -> bool:
    """Whether a policy says that it is a table [self cell, other cell, action] in games of `task`.

    A learned policy is one by its observation (`is_table`), and with the view limits of its
    training, for which the table is valid.
    """
    own, agent = getattr(policy, "task", None), getattr(policy, "agent", None)
    if not _is_function_of_cells(task, policy, "action_probabilities"):
        return False
    if not isinstance(own, Task) or agent is None:
        return True
    seat = own.seat(agent)
    here = task.seat(own.seat_roles[seat])
    return own.sight.limits[seat] == task.sight.limits[here]


def _is_function_of_cells(task: Task, policy: Any, method: str) -> bool:
    says = getattr(policy, "is_table", None)
    return tells_its_play(policy, method) and (says is None or bool(says(task)))


def exact_work(task: Task, most_work: int) -> int:
    """The size up to which policies of a chase of one evader are evaluated exactly: during
    training, or with exits and turns also in final results (`most_work` above MAX_WORK)."""
    final = most_work > MAX_WORK and (task.most_exits > 0 or task.options.turns)
    return min(most_work, MAX_FINAL_WORK if final else MAX_EXACT_WORK)


def team_work(task: Task, most_work: int) -> int:
    """The size up to which the play of a whole team and its best response are solved: during
    training, or in final results (`most_work` above MAX_WORK)."""
    if most_work <= MAX_WORK:
        return min(most_work, MAX_EXACT_WORK)
    return most_work if task.num_goals else MAX_TEAM_WORK


def is_exact_team(task: Task, policies: Mapping[str, Policy], most: int = MAX_EXACT_WORK) -> bool:
    """Whether a chase of one evader by a team is small enough to be solved with these policies.

    Args:
        task: the game; duels without options of the rules are not included.
        policies: by agent name or role.
        most: the largest size that is solved (`work_of`).
    """
    return (
        not task.is_duel
        and task.start == "random"
        and why_not_one_evader(task) is None
        and work_of(task) <= most
        and why_no_time(work_of(task)) is None
        and has_distributions(task, policies)
    )


def why_not_joint(
    task: Task, policies: Mapping[str, Policy], most: int, *responders: int
) -> str | None:
    """The reason why a whole game is not solved; None if it is.

    Args:
        task: the game.
        policies: of the agents, by agent name or role.
        most: the largest size that is solved (`work_of`).
        responders: the indices of agents that need no policy.
    """
    if len(task.mazes) > 1:
        return f"{len(task.mazes)} mazes; whole games are solved in one"
    if work_of(task) > most:
        states, work = (  # the numbers of 38 agents have a hundred digits
            f"{number:,}" if number < 10**15 else f"about 10^{len(str(number)) - 1}"
            for number in (count_joint_states(task), work_of(task))
        )
        return f"{states} states, times joint actions {work}; at most {most:,} are solved here"
    if (reason := why_no_time(work_of(task))) is not None:
        return reason
    try:
        check_joint_states(task, each=100)
    except ValueError as refused:
        return str(refused)
    seats = [seat for seat in range(task.num_agents) if seat not in responders]
    return why_no_distribution(task, seats, policies)


# -- each of several mazes -------------------------------------------------------------------------


def is_known(task: Task, policy: Any) -> bool:
    """Whether `train.evaluation.suite_tables.tables_of` supports a policy: scripted agents, and
    networks without memory that observe only cells and goals."""
    methods = "action_probabilities", "distribution"
    return any(_is_function_of_cells(task, policy, method) for method in methods)


def is_solvable(task: Task, *opponents: Policy | None) -> bool:
    """Whether values can be computed exactly in every maze: for a runner with one goal, or in a
    small duel with a tabular opponent."""
    if task.start != "random":
        return False
    one_goal = is_single_runner(task) and task.num_goals == 1
    return one_goal or (_is_small_duel(task) and all(is_known(task, each) for each in opponents))
