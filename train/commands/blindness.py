"""What is proven of the optimum under limited sight: `pursuit solve --view-radius`, and the table
of a maze's optimum by radius, the price of blindness.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pursuit.mazes.maze import Maze
from scripted_agents import AStarChaser, AStarEvader, solve_hidden_chase
from scripted_agents.hidden.game import Role
from train.commands.progress import Alive
from train.reports.tables import plain_table, print_table
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
    alive, name = Alive(), FULL
    how: Any = {"discount": discount, "seconds": seconds, "role": role, "move_order": move_order}

    def report(now: float, lower: float, upper: float) -> None:
        alive(f"radius {name}", min(now / seconds, 1.0))

    full, rows = solve_hidden_chase(maze, table, None, **how), []
    for radius in radii:
        name = FULL if radius is None else str(radius)
        found = solve_hidden_chase(maze, table, radius, report=report, **how)
        alive(f"radius {name}", 1.0)
        low, up = (100.0 * (bound / full.upper - 1.0) for bound in (found.lower, found.upper))
        rows.append(
            {
                "view radius": name,
                "at least": f"{found.lower:.4f}",
                "at most": f"{found.upper:.4f}",
                "width": f"{100 * found.width:.3f} %",
                "price of blindness": f"{low:+.2f} to {up:+.2f} %",
                "s": f"{found.seconds:.1f}",
            }
        )
    print(
        f"{maze.name}: optimum of the {role} against {agent!r}, mean over starts, in discounted "
        f"steps (discount {discount:g}, {move_order})"
    )
    print_table(plain_table(rows), 100)
