"""Checks that the teams, goals, starts and mazes of a task do not contradict each other.

Their argument `task` is a `pursuit.tasks.task.Task`, which imports this file.
"""

from __future__ import annotations

from typing import Any

from pursuit.tasks.placements import check_placeable
from pursuit.validation import check


def check_consistent(task: Any) -> None:
    """Check the teams, goals, start distances and mazes of a task.

    Raises:
        ValueError: a game that cannot end or start, or mazes that do not fit to each other.
    """
    check(
        task.num_agents > 0, "a task without agents; give num_chasers, num_evaders or num_runners"
    )
    for role, other in (("chaser", "evader"), ("evader", "chaser")):
        check(
            task.count(role) == 0 or task.count(other) > 0 or task.num_goals > 0,
            f"num_{role}s={task.count(role)}, num_{other}s=0 and no goals: the game cannot "
            f"terminate; give num_{other}s or num_goals",
        )
    check(
        task.num_runners == 0 or task.num_goals > 0,
        f"num_runners={task.num_runners} and num_goals=0; runners collect goals: give "
        "num_goals of at least 1",
    )
    check(
        task.num_goals == 0 or task.num_runners > 0 or task.num_evaders > 0,
        f"num_goals={task.num_goals}, but only runners and evaders collect goals; give "
        "num_runners or num_evaders",
    )
    check(
        task.min_start_distance <= 1 or (task.num_chasers > 0 and task.num_evaders > 0),
        f"min_start_distance={task.min_start_distance}: a path distance between chasers and "
        f"evaders, but num_chasers={task.num_chasers} and num_evaders={task.num_evaders}; "
        "leave it out",
    )
    for maze in task.mazes:
        needed = task.num_agents + task.num_goals
        check(
            needed <= maze.num_cells,
            f"{task.num_agents} agents and {task.num_goals} goals need {needed} different cells; "
            f"maze {maze.name} has {maze.num_cells}. Use fewer, or a larger maze",
        )
        if task.num_goals and not maze.is_connected:
            raise ValueError(
                f"maze {maze.name} has {maze.num_components} unconnected parts, so a goal could be "
                "unreachable; open a wall, or block the smaller parts with '#'"
            )
    odd = next((maze for maze in task.mazes if maze.num_moves != task.num_moves), None)
    if odd is not None:
        raise ValueError(
            f"{odd.name} has {odd.num_moves} moves and {task.mazes[0].name} {task.num_moves}; "
            "all mazes of a task need the same number: give num_moves to Maze.from_graph"
        )
    graph = next((maze for maze in task.mazes if not maze.is_grid), None)
    by_distance = any(each.distance != 0.0 for each in task.role_rewards.values())
    if graph is not None and by_distance:
        raise ValueError(
            f"rewards={task.rewards!r}: a reward by the Manhattan distance needs rows and "
            f"columns, and {graph.name} is a graph; use 'goal' or a reward function"
        )


def check_starts(task: Any) -> None:
    """ValueError unless an episode can start in every maze."""
    for number in range(len(task.mazes)):
        check_placeable(task.apart(number, -1, task.min_start_distance, -1))
