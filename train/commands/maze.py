"""`pursuit maze`: show, check or generate a maze."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from PIL import Image

from pursuit.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.maze_generation import generate_maze
from pursuit.rendering import Scene, draw_scene
from scripted_agents.tour import expected_tour_length
from train.commands.parse import parse
from train.files import write_text
from train.settings.checks import check


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
        write_text(given.out, made.to_text())
    if given.picture is not None:
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
