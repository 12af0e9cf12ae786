"""`pursuit baseline` and `pursuit maze`: what can be said without learning, and without torch."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from pursuit.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.maze_generation import generate_maze
from pursuit.task import ROLES
from scripted_agents.tour import expected_tour_length, num_states
from train.commands.main import parse
from train.evaluation.contest import Contest, Score, optimality_gap
from train.settings.checks import check
from train.settings.run import TaskSettings


@dataclass(frozen=True)
class BaselineCommand:
    """Random, scripted and optimal agents on a task, exactly where that is possible."""

    task: TaskSettings = field(default_factory=TaskSettings)
    episodes: int = 10_000
    """Episodes played where there is no exact answer."""
    seed: int = 0
    """Of those episodes."""


def baseline(arguments: Sequence[str]) -> None:
    """`pursuit baseline`."""
    given = parse(BaselineCommand, arguments, "baseline")
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    check(0 <= given.seed < 2**63, f"seed={given.seed}; 0 to 2**63-1")
    task = given.task.build()
    contest = Contest(task, given.task.agent, given.task.opponents(), given.episodes, given.seed)
    print(contest_line(contest))
    print_scores(contest.baselines())
    maze = task.mazes[0]
    if (task.num_agents, task.num_runners) == (1, 1):
        mean = expected_tour_length(maze, task.num_goals)
        how = "exact" if mean.exact else f"±{mean.ci95:.2f}, sampled"
        print(f"mean optimal tour over all placements: {mean:.4f} ({how})")
        print(f"distinct states: {num_states(maze.num_cells, task.num_goals):,}")
    elif task.is_duel:
        print(f"distinct states: {maze.num_cells * (maze.num_cells - 1):,}")


def contest_line(contest: Contest) -> str:
    """One line that says what is evaluated."""
    task, maze = contest.task, contest.task.mazes[0]
    counts = {role: task.count(role) for role in ROLES} | {"goal": task.num_goals}
    parts = [f"{n} {name}{'s' if n > 1 else ''}" for name, n in counts.items() if n]
    others = sorted(
        {
            repr(policy)
            for role, policy in contest.opponents.items()
            if role in task.seat_roles and (role != contest.role or task.count(role) > 1)
        }
    )
    against = f", with {', '.join(others)}" if others else ""
    return (
        f"{task.name}: {contest.agent} on maze {maze.name} ({maze.num_cells} cells; "
        f"{', '.join(parts)}){against}, at most {task.max_steps} steps"
    )


def print_scores(scores: Sequence[Score]) -> None:
    """A table of scores with the gap to the optimal one."""
    optimum = next((score for score in scores if score.name == "optimal"), None)
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for column in ("steps", "95 % interval", "success", "gap to optimum"):
        table.add_column(column, justify="right")
    for score in scores:
        gap = optimality_gap(score, optimum)
        interval = "exact" if score.exact else f"± {score.ci95:.3f}"
        table.add_row(
            score.name,
            f"{score.mean_steps:.3f}",
            interval,
            f"{100 * score.success_rate:.1f} %",
            "" if gap is None or score is optimum else f"{100 * gap:+.2f} %",
            style="bold" if score.name == "learned" else "",
        )
    Console(width=None if sys.stdout.isatty() else 100).print(table)


@dataclass(frozen=True)
class MazeCommand:
    """Show, check or generate a maze.

    `pursuit maze 7x7` shows a shipped maze, `pursuit maze FILE` checks a file, and
    `pursuit maze --generate prim --height 9` makes a new one.
    """

    maze: Annotated[str | None, tyro.conf.Positional] = None
    """A shipped maze (2x2 ... 9x9, 15x15, also -tree and -open) or a maze file."""
    generate: str | None = None
    """Generate by prim, backtracker, wilson (uniform spanning tree) or open."""
    height: int = 9
    """Rows of cells of the generated maze."""
    width: int | None = None
    """Columns of cells; as many as rows if left out."""
    loops: float = 0.0
    """Share of the remaining inner walls that is removed, in [0, 1]."""
    no_dead_ends: bool = False
    """Open walls until no dead end is left."""
    seed: int = 0
    """Of the generator."""
    out: Path | None = None
    """Write the maze to this file."""
    picture: Path | None = None
    """Draw the maze into this .png file."""


def maze(arguments: Sequence[str]) -> None:
    """`pursuit maze`."""
    given = parse(MazeCommand, arguments, "maze")
    check(
        (given.maze is None) != (given.generate is None),
        "give a maze (a name or a file), or --generate; not both",
    )
    if given.generate is not None:
        made = generate_maze(
            given.generate,
            given.height,
            given.width,
            loops=given.loops,
            no_dead_ends=given.no_dead_ends,
            seed=given.seed,
        )
    else:
        made = load_maze(str(given.maze))
    for path in (given.out, given.picture):
        check(path is None or not path.exists(), f"{path}: exists already; give a new file")
    if max(made.height, made.width) <= 60:
        print(made.to_text(), end="")
    print(describe_maze(made))
    if given.out is not None:
        given.out.write_text(made.to_text(), encoding="utf-8")
    if given.picture is not None:
        from PIL import Image

        from pursuit.rendering import Scene, draw_scene

        Image.fromarray(draw_scene(Scene(made, (), made.goal_marks, 0, 0))).save(given.picture)


def describe_maze(maze: Maze) -> str:
    """What `pursuit maze` says of a maze, a line each."""
    parts = maze.num_components
    lines = [
        f"{'cells':<26}{maze.num_cells} of {maze.height} x {maze.width}",
        f"{'connected':<26}{'yes' if parts == 1 else f'no: {parts} parts'}",
        f"{'dead ends':<26}{len(maze.dead_ends)}",
        f"{'loops':<26}{maze.num_loops}",
    ]
    if maze.num_cells <= MAX_TABLE_CELLS:
        lines.append(f"{'longest shortest path':<26}{maze.longest_distance}")
    if parts == 1 and maze.num_cells <= MAX_TABLE_CELLS:
        for goals in range(1, min(3, maze.num_cells - 1) + 1):
            mean = expected_tour_length(maze, goals)
            how = "" if mean.exact else f" (sampled, ± {mean.ci95:.2f})"
            lines.append(f"{f'mean tour of {goals} goal(s)':<26}{mean:.4f}{how}")
    return "\n".join(lines)
