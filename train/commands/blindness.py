"""What is proven of the optimum under limited sight: `pursuit solve --view-radius`, and the table
of a maze's optimum by radius, the price of blindness.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from pursuit.maze import Maze
from scripted_agents import AStarChaser, AStarEvader, solve_hidden_chase
from scripted_agents.hidden_game import Role
from train.commands.progress import Alive
from train.settings.checks import check

FULL = "full"


def radii_of(text: str) -> list[int | None]:
    """The radii of a text such as "2", or "0,1,2,full".

    Raises:
        ValueError: something else.
    """
    parts = [part.strip() for part in text.split(",")]
    for part in parts:
        check(
            part == FULL or part.isdecimal(),
            f"view_radius={text!r}; path steps, or full, such as 2 or 0,1,2,full",
        )
    return [None if part == FULL else int(part) for part in parts]


def print_blindness(
    maze: Maze,
    radii: Sequence[int | None],
    role: Role,
    opponent_epsilon: float,
    seconds: float,
    discount: float = 0.95,
    stay_action: bool = False,
    move_order: str = "simultaneous",
) -> None:
    """Search for each radius for so many seconds, and print a line of what is proven."""
    agent = AStarEvader(opponent_epsilon) if role == "chaser" else AStarChaser(opponent_epsilon)
    table = agent.action_probabilities(maze, stay_action)
    full = solve_hidden_chase(
        maze, table, None, discount=discount, seconds=seconds, role=role,
        move_order=move_order,  # type: ignore[arg-type]
    )  # fmt: skip
    rows, alive = Table(box=None, pad_edge=False), Alive()

    def report(now: float, lower: float, upper: float) -> None:
        alive(doing, min(now / seconds, 1.0))

    for column in ("view radius", "at least", "at most", "width", "price of blindness", "s"):
        rows.add_column(column, justify="right")
    for radius in radii:
        name = FULL if radius is None else str(radius)
        doing = f"radius {name}"
        solution = solve_hidden_chase(
            maze, table, radius, discount=discount, seconds=seconds, role=role,
            move_order=move_order,  # type: ignore[arg-type]
            report=report,
        )  # fmt: skip
        alive(doing, 1.0)
        low, up = 100.0 * (np.array([solution.lower, solution.upper]) / full.upper - 1.0)
        rows.add_row(
            name, f"{solution.lower:.4f}", f"{solution.upper:.4f}", f"{100 * solution.width:.3f} %",
            f"{low:+.2f} to {up:+.2f} %", f"{solution.seconds:.1f}",
        )  # fmt: skip
    print(
        f"{maze.name}: optimum of the {role} against {agent!r}, mean over starts, in discounted "
        f"steps (discount {discount:g}, {move_order})"
    )
    Console(width=100).print(rows)
