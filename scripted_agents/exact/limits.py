"""Every limit of exactness: the sizes up to which games are solved, and the reasons above them.

The solvers of `references` say what is solved exactly; these are the numbers that they use, and
those of the solutions. docs/reference/exact_limits.md holds tables of them.
"""

from __future__ import annotations

import math
from math import comb

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze
from pursuit.memory import check_memory
from pursuit.rules import layout
from pursuit.tasks.task import MOVE_ORDERS, ROLES, Task, checked_task
from pursuit.validation import one_of, whole

# -- with what a result is compared ----------------------------------------------------------------

MAX_EXACT_GOALS = 18
"""Goals of a single runner up to which its shortest tours are computed."""

MAX_EXACT_CELLS = 1024
"""Cells of a maze up to which duels are solved, not sampled (seconds, gigabytes)."""

MAX_EXACT_WORK = 2_000_000
"""Size (`work_of`) of a team chase of one evader up to which policies are evaluated exactly during
training: 5x5 with two chasers has half this size, a second."""

MAX_FINAL_WORK = 40_000_000
"""The same at the end of a run of self-play and in leagues: 9x9 with two chasers, half a minute."""

MAX_TEAM_WORK = 1_100_000_000
"""Size of a chase up to which the play of a whole team is evaluated exactly at the end of a run, in
`pursuit evaluate` and in leagues, and its best response and those of its members are solved: 4x4
with four chasers, two minutes; 5x5 with three, half a minute; 7x7 with two, seconds."""

MAX_WORK = 5_000_000
"""Size of a game of any teams up to which a best response is computed at the start of a run: 4x4,
two agents and three goals, two seconds."""

MAX_EVALUATED_WORK = 200_000_000
"""The same at the end of a run, in `pursuit evaluate` and `pursuit baseline`: 5x5, two agents and
three goals, or two against two: 15 seconds, about 10 million states."""

MAX_BOUNDED_CELLS = 100
"""Cells of a maze up to which the optimum of a duel under a limited view is bounded: the interval
would be too wide above."""

SEARCH_SECONDS, SEARCH_WIDTH = 20.0, 1e-3
"""The search for this interval ends after these seconds, or at this upper / lower - 1."""

SOLVED_MAZES = 100
"""Mazes of a suite, evenly spaced, in which a sampled duel is solved."""

MAX_CURRICULUM_JOINTS = 5
"""Joints of an arm up to which a curriculum knows the minimum steps: below half a millisecond."""

MAX_OBJECTIVE_CELLS = 256
"""Cells of a maze up to which the objective gap of a duel is computed (seconds)."""

MAX_OBJECTIVE_WORK = 50_000_000
"""Size of a game of any teams up to which its objective gap is computed: 15 seconds on 5x5."""

MAX_TOUR_WORK = 3_000_000_000
"""Triples (set of goals, next goal, cell) up to which the objective gap of a runner is computed:
some seconds."""

MAX_TOUR_BYTES = 10**9
"""Memory of the tables of that."""

MAX_GAME_CELLS = 256
"""Cells of a maze up to which a run of self-play solves the equilibrium of a duel (minutes)."""

MAX_SNAPSHOT_CELLS = 49
"""Cells of a maze up to which it computes exact mixtures and the diversity of its snapshots."""

# -- what the solvers take -------------------------------------------------------------------------

MAX_ENUMERATED_PLACEMENTS = 2_000_000_000
"""Placements up to which `expected_tour_length` enumerates them; above it draws samples."""

MAX_DUEL_ENTRIES = 2 * MAX_TABLE_CELLS**2
"""Cells × rows × columns of the maze of a duel, as blocked cells take memory too."""

MAX_STATES = 10**8
"""Joint states of a game of any teams."""

MAX_STATE_BYTES = 8 * 10**9
"""Memory of its values."""

MAX_STORE_BYTES = 8 * 10**9
"""Memory of its transitions."""

MAX_PLAN_BYTES = 5 * 10**8
"""Memory of a plan for every step; above it the plan of the first step is used in all steps."""

MAX_CHASE_BYTES = 3 * 10**9
"""Memory of `solve_chase`."""

MAX_TEAM_BYTES = 15 * 10**8
"""Memory of `solve_chase` for the equilibrium agents of a team."""

MAX_GAME_STATES = 2_000_000
"""Joint states in `solve_joint_game`: minutes, and more than a gigabyte."""

MAX_DISCOUNT = 0.9995
"""Discount in `solve_joint_game`: above it value iteration needs more than about 50,000 sweeps."""

MAX_SMALL_STATES = 10**7
"""States of an enumerated game by default, and entries of a list that a game returns."""

MAX_TASK_STATES = 200_000
"""States of `game_of_task`: each takes some hundred bytes, and some microseconds."""

MAX_TURN_BYTES = 4 * 10**9
"""Memory of `solve_in_turns`."""

MAX_PROFILES = 2500
"""Rows × columns in `alpha_rank`, which solves a dense linear system of this size."""

MAX_ARM_NODES = 1_000_000
"""Nodes of the search for the least steps of one arm: about 0.2 seconds; most arms need far fewer.
Above it the lower bound is no longer raised."""

# -- sizes of games --------------------------------------------------------------------------------

REMEDY = "take a smaller maze, fewer agents or fewer goals, or play episodes"


def count_joint_states(task: Task) -> int:
    """How many states a task has, counted without making any.

    The sum over the sets of free evaders (one at least, where there are evaders) of n to the number
    of free agents, times the sets of 1 to `num_goals` of the n cells (1 where there are no goals),
    times the sets of exits that can be drawn, times 2 in turns.

    Raises:
        ValueError: the task is played in several mazes.
    """
    if len(checked_task(task).mazes) > 1:
        raise ValueError(
            f"task {task.name!r} is played in {len(task.mazes)} mazes; states are counted and "
            "solved in one: give one maze"
        )
    cells, evaders = task.max_cells, task.num_evaders
    others = task.num_chasers + task.num_runners
    places = sum(
        comb(evaders, free) * cells ** (others + free)
        for free in range(min(evaders, 1), evaders + 1)
    )
    sets = sum(comb(cells, left) for left in range(1, task.num_goals + 1))
    halves = task.steps_per_round
    return places * (sets if task.num_goals else 1) * comb(cells, task.num_exits) * halves


def check_joint_states(task: Task, most: int = MAX_STATES, each: int = 0) -> int:
    """The number of states of a task, if it is not too large to be solved.

    Args:
        task: the game.
        most: states that are solved.
        each: bytes that a state takes.

    Raises:
        ValueError: more states than `most`, more memory than MAX_STATE_BYTES or than is free, or a
            task that has no states (`count_joint_states`).
    """
    states, most = count_joint_states(task), whole("most_states", most, 1, 2**63)
    size_text = (
        f"task {task.name!r} on {task.mazes[0].name}: {states:,} states ({task.max_cells} cells, "
        f"{task.num_agents} agents, {task.num_goals} goals)"
    )
    if states > most:
        raise ValueError(f"{size_text}; at most {most:,} are solved: {REMEDY}")
    if task.max_cells > MAX_TABLE_CELLS:
        raise ValueError(f"{size_text}; mazes are solved up to {MAX_TABLE_CELLS} cells: {REMEDY}")
    sets = sum(comb(task.max_cells, left) for left in range(1, task.num_goals + 1))
    needed = states * each + 4 * sets * task.num_goals
    check_memory(size_text, needed, REMEDY, MAX_STATE_BYTES)
    return states


def work_of(task: Task) -> int:
    """The size of a game in one maze: its states times the joint actions of all agents."""
    return int(count_joint_states(task) * task.num_actions**task.num_agents)


def bytes_to_solve(maze: Maze, num_chasers: int, stay_action: bool) -> int:
    """The memory that `solve_chase` needs, about: what follows each pair of options with its
    chance, a sparse linear system (some 400 bytes a state), policies and values."""
    actions = maze.num_moves + stay_action
    ways = [len(set(row)) for row in maze.neighbors[:, :actions].tolist()]
    pairs = 40 * sum(ways) ** (num_chasers + 1) // math.factorial(num_chasers)
    policies = 8 * (2 * actions**num_chasers + 2 * actions + 8)
    system = 400 // math.factorial(num_chasers)
    return int(pairs + (policies + system) * maze.num_cells ** (num_chasers + 1))


# -- reasons ---------------------------------------------------------------------------------------


def check_duel_order(move_order: str) -> None:
    """Check the order of moves of a game that is solved over the cells of the agents.

    Raises:
        ValueError: an unknown order, or "turns", where the side to move is part of the state.
    """
    orders = [order for order in MOVE_ORDERS if order != "turns"]
    if move_order not in orders:
        advice = "; in turns, use solve_joint, solve_joint_game or solve_in_turns"
        raise ValueError(
            f"move_order={move_order!r}; give {' or '.join(map(repr, orders))}"
            f"{advice if move_order == 'turns' else ''}"
        )


def is_single_runner(task: Task) -> bool:
    """Whether the only agent is a runner, which does not slip."""
    return (task.num_agents, task.num_runners) == (1, 1) and not any(task.slips)


def why_no_tour(num_goals: int) -> str | None:
    """The reason why tours through so many goals are not computed exactly; None if they are."""
    if num_goals > MAX_EXACT_GOALS:
        return f"{num_goals} goals; shortest tours are exact for up to {MAX_EXACT_GOALS}"
    return None


def why_not_team_chase(task: Task) -> str | None:
    """The reason why a task is no team chase that is solved by cells alone; None if it is one."""
    if checked_task(task).most_exits or task.options.turns:
        return f"{task.most_exits} exit(s) and move_order={task.move_order!r}"
    return why_not_one_evader(task)


def why_not_one_evader(task: Task) -> str | None:
    """The reason why a task is no chase of one evader in one maze; None if it is one."""
    if checked_task(task).num_evaders != 1 or not task.num_chasers:
        return f"{task.num_chasers} chaser(s) and {task.num_evaders} evader(s)"
    if task.num_runners or task.num_goals:
        return f"{task.num_runners} runner(s) and {task.num_goals} goal(s)"
    return f"{len(task.mazes)} mazes" if len(task.mazes) > 1 else None


def why_not_optimal(task: Task, role: str) -> str | None:
    """The reason why the optimal agent of a role is not known in a task; None if it is.

    Known for chasers, as a team that moves as one, and the evader of a chase of one evader without
    goals, while the joint solution fits into MAX_TEAM_BYTES (half a minute on 9x9 with two
    chasers); and for a runner alone, up to MAX_EXACT_GOALS goals.
    """
    if one_of("role", role, ROLES) == "runner":
        if checked_task(task).num_agents > 1:
            return f"a runner among {task.num_agents} agents has no known optimum"
        if any(task.slips):
            return f"shortest tours are for runners that do not slip, and slip={task.slip}"
        return why_no_tour(task.num_goals)
    obstacle = why_not_team_chase(task)
    if obstacle is not None:
        return f"chases of one evader without goals in one maze are solved, not {obstacle}"
    if task.is_duel:
        return None
    if task.options != layout.PLAIN:
        return "equilibria of chases are computed without options of the rules"
    needed = bytes_to_solve(task.mazes[0], task.num_chasers, task.stay_action)
    if needed > MAX_TEAM_BYTES:
        return (
            f"{task.num_chasers} chasers on {task.max_cells} cells need {needed:,} bytes to be "
            f"solved together; at most {MAX_TEAM_BYTES:,} are used"
        )
    return None


def check_optimal(task: Task, role: str) -> None:
    """ValueError, with the reason, if the optimal agent of a role is not known in a task."""
    reason = why_not_optimal(task, role)
    if reason is not None:
        raise ValueError(
            f"{'optimal' if role == 'runner' else 'equilibrium'} {role} of task {task.name!r}: not "
            f"known: {reason}. Take astar, or a smaller game"
        )


def why_no_belief(task: Task) -> str | None:
    """The reason why a task has no beliefs about an opponent; None if it has."""
    return None if task.is_duel else "one chaser, one evader and no goals are needed"


def check_belief(task: Task, what: str) -> None:
    """ValueError unless a task is a duel, as beliefs need."""
    reason = why_no_belief(task)
    if reason is not None:
        raise ValueError(
            f"{what} in task {task.name!r} of {task.num_chasers} chaser(s), {task.num_evaders} "
            f"evader(s) and {task.num_goals} goal(s): {reason}. Use SearchingChaser"
        )
