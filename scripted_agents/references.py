"""With which exact optimum an agent is compared, or why with none: `reference_of`.

This is the one place that decides when a result (of `pursuit evaluate`, `pursuit baseline` or a
run) has an exact reference: the contests of `train.evaluation` ask it for the kind of optimum that
they compute. `pursuit evaluate` prints the reason where a game without limited views has no
optimum. The numbers are in `limits`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pursuit.reacher.task import ReacherTask
from pursuit.simulator.policy import DistributionPolicy, Policy, TabularPolicy
from pursuit.tasks.task import Task
from scripted_agents.agents.runner import NearestGoalRunner, TourRunner
from scripted_agents.agents.scripted import RandomAgent
from scripted_agents.joint.opponents import has_distributions, why_no_distribution
from scripted_agents.limits import (
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
from scripted_agents.long_work import why_no_time


@dataclass(frozen=True)
class ExactReference:
    """With what an agent is compared: the answer of `reference_of`.

    Kinds:
        tour: One runner without other agents, up to MAX_EXACT_GOALS goals, in any mazes. Exact: the
            shortest tours, in steps.
        duel: One chaser and one evader without goals at random starts in mazes of up to
            MAX_EXACT_CELLS cells, the opponent a table over both cells. Exact: the best response,
            the mean steps over all starts.
        team: Several chasers and one evader without goals at random starts in one maze, or a duel
            with options of the rules, policies with known distributions, work of up to
            MAX_EXACT_WORK; with exits or turns in final results MAX_FINAL_WORK. Exact: the best
            response of the agent, the mean over all starts, in steps; with exits in captures -
            escapes. The same for a whole team that learns, against any number of evaders or
            chasers; in final results up to MAX_TEAM_WORK. Exact: its best response as one player.
        joint: Any other game in one maze, policies with known distributions, work of up to
            MAX_WORK; in final results, `pursuit evaluate` and `pursuit baseline`
            MAX_EVALUATED_WORK. Exact: the best response of the agent from the starts of the
            evaluation, in steps; in a race in goals, in a heist in return, with exits in captures -
            escapes.
        bounds: A duel as above with a limited view of the agent, in one maze of up to
            MAX_BOUNDED_CELLS cells. Certified: a proven interval of the optimum, in discounted
            steps.
        small_game: A small game, policies of all other players that depend on the state. Exact: the
            best response, the mean return over all starts.
        arm: The arm with continuous actions. Exact: the least steps; a bound where they are not
            known from every start.
        none: Everything else. A bound, where one is known: the optimum with full view, or with
            continuous actions; otherwise the best scripted agent.

    Attributes:
        kind: of these.
        reason: why no exact optimum is known, with the kinds "bounds" and "none"; else empty.
    """

    kind: Literal["tour", "duel", "team", "joint", "bounds", "arm", "small_game", "none"]
    reason: str = ""


def reference_of(
    task: Task | ReacherTask,
    agent: str,
    opponents: Mapping[str, Policy],
    most_work: int = MAX_WORK,
    by_maze: bool = False,
    team: bool = False,
) -> ExactReference:
    """Which exact optimum of an agent is known, and if none is, the reason.

    Args:
        task: the game, or the arm.
        agent: its name or role; not used of the arm.
        opponents: the policies of the other agents, by agent name or role; those of the agent's own
            role are of its teammates.
        most_work: the size (`work_of`) up to which games of the kind "joint" are solved.
        by_maze: whether duels in several mazes are solved maze by maze, as in suites.
        team: whether all agents of the role `agent` respond, as one player; then `most_work` is
            that of `team_work`.
    """
    if isinstance(task, ReacherTask):
        if task.discrete_actions:
            return _unknown("discrete actions; only a lower bound of the steps is known")
        return ExactReference("arm")
    seats = [task.seat(agent)]
    if team:
        seats = [seat for seat, role in enumerate(task.seat_roles) if role == agent]
    if any(map(task.hides_from, seats)):
        bounded = is_table_duel(task, *opponents.values()) and task.max_cells <= MAX_BOUNDED_CELLS
        return ExactReference("bounds" if bounded else "none", "limited view")
    if is_single_runner(task):
        reason = why_no_tour(task.num_goals)
        return ExactReference("tour") if reason is None else _unknown(reason)
    if is_table_duel(task, *opponents.values()):
        return ExactReference("duel")
    if len(task.mazes) > 1:
        if by_maze and is_solvable(task, *opponents.values()):
            return ExactReference("duel")
        return _unknown(f"{len(task.mazes)} mazes; whole games are solved in one")
    policies = {**opponents, task.agent_names[seats[0]]: RandomAgent()}
    if not team and is_exact_team(task, policies, exact_work(task, most_work)):
        return ExactReference("team")
    most_work = team_work(task, most_work) if team else most_work
    reason = why_not_joint(task, opponents, most_work, *seats)
    by_return = task.num_goals > 0 and task.seat_roles[seats[0]] != "runner"
    if reason is None and by_return and task.reward_function is not None:
        reason = "user-defined rewards"
    kind: Literal["team", "joint"] = "team" if team and not task.num_goals else "joint"
    return ExactReference(kind) if reason is None else _unknown(reason)


def _unknown(reason: str) -> ExactReference:
    return ExactReference("none", reason)


# -- fixed policies, whose values are exact --------------------------------------------------------


def is_table_duel(task: Task, *policies: Policy) -> bool:
    """Whether the task is a duel small enough to be solved, and all policies are tables."""
    tables = all(is_table_in(task, policy) for policy in policies)
    return len(task.mazes) == 1 and _is_small_duel(task) and tables


def _is_small_duel(task: Task) -> bool:
    return task.is_duel and task.max_cells <= MAX_EXACT_CELLS and task.start == "random"


def is_table_in(task: Task, policy: Any) -> bool:
    """Whether a policy is a table [self cell, other cell, action] in the games of `task`.

    For a learned policy this requires the view limits of its training, for which the table is
    valid.
    """
    own, agent = getattr(policy, "task", None), getattr(policy, "agent", None)
    if not isinstance(policy, TabularPolicy) or not isinstance(own, Task) or agent is None:
        return isinstance(policy, TabularPolicy)
    seat = own.seat(agent)
    here = task.seat(own.seat_roles[seat])
    return own.sight.limits[seat] == task.sight.limits[here]


def exact_work(task: Task, most_work: int) -> int:
    """The size up to which policies of a chase of one evader are evaluated exactly: during
    training, or with exits and turns also in final results (`most_work` above MAX_WORK)."""
    final = most_work > MAX_WORK and (task.most_exits > 0 or task.options.turns)
    return MAX_FINAL_WORK if final else MAX_EXACT_WORK


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


def is_known(policy: Any) -> bool:
    """Whether `train.evaluation.suite_tables.tables_of` supports a policy: scripted agents, and
    networks without memory that observe only cells and goals."""
    known = NearestGoalRunner, TourRunner, TabularPolicy, DistributionPolicy
    return isinstance(policy, known)


def is_solvable(task: Task, *opponents: Policy | None) -> bool:
    """Whether values can be computed exactly in every maze: for a runner with one goal, or in a
    small duel with a tabular opponent."""
    one_goal = is_single_runner(task) and task.num_goals == 1 and task.start == "random"
    return one_goal or (_is_small_duel(task) and all(map(is_known, opponents)))
