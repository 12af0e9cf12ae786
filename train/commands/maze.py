"""`pursuit maze`: show, check or generate a maze."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from pursuit.files import write_atomically
from pursuit.mazes.generation import generate_graph, generate_maze
from pursuit.mazes.graph_generation import GRAPHS
from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze
from pursuit.mazes.sources import reads_as_text
from pursuit.validation import check
from train.commands.parse import parse
from train.files import Plain, check_new_files, write_text
from train.reports.figures import BLUE, FORMATS, GREEN, ORANGE, draw_walls, pyplot, save
from train.reports.tables import in_lines
from train.settings.checks import check_default


@dataclass(frozen=True)
class MazeCommand:
    """Show, check or generate a maze.

    The command `pursuit maze 7x7` shows a maze of the library, `pursuit maze FILE` checks a file,
    `pursuit maze --generate prim --height 9` generates a maze, and
    `pursuit maze --generate roads --height 9` a graph. In the text of a maze S, G and E mark the
    start, the goals and the exits, and # a blocked cell.
    """

    maze: Annotated[str | None, tyro.conf.Positional] = None
    """A maze of the library (2x2 ... 9x9, 15x15, also with -tree and -open), or a maze file."""
    generate: str | None = None
    """Generator: prim, backtracker, wilson (uniform spanning tree) or open; or a graph: eight (a
    grid with eight neighbors), hexagonal, torus, geometric or roads."""
    height: int = 9
    """Number of rows of the generated maze."""
    width: int | None = None
    """Number of columns. None: as many as rows."""
    loops: float = 0.0
    """Fraction of the remaining inner walls that is removed, in [0, 1]."""
    dead_ends: bool = True
    """Keep dead ends, or remove walls until there are none."""
    seed: int = 0
    """Seed of the generator."""
    out: Path | None = None
    """Write the maze to this file."""
    picture: Path | None = None
    """Draw the maze to this .png file, or as lines to this .svg file."""
    overwrite: bool = False
    """Replace existing files of --out and --picture."""


def maze(arguments: Sequence[str]) -> None:
    """`pursuit maze`."""
    given = parse(MazeCommand, arguments, "maze")
    check(
        (given.maze is None) != (given.generate is None),
        "give either a maze (a name or a file) or --generate",
    )
    if given.generate in GRAPHS:
        check_default(given, MazeCommand, ("loops", "dead_ends"), "graphs do not have it")
        width = given.height if given.width is None else given.width
        made = generate_graph(given.generate, given.height, width, given.seed)
    elif given.generate is None:
        names = ("height", "width", "loops", "dead_ends", "seed")
        check_default(given, MazeCommand, names, "it is an option of --generate")
        made = load_maze(str(given.maze))
    else:
        more: Plain = {"no_dead_ends": not given.dead_ends, "seed": given.seed}
        made = generate_maze(given.generate, given.height, given.width, loops=given.loops, **more)
    picture = given.picture
    check(picture is None or picture.suffix[1:] in FORMATS, f"{picture}: give .png, .svg or .pdf")
    check(
        given.out is None or reads_as_text(given.out),
        f"{given.out}: --out writes the text format of Pursuit, which is not read from this path; "
        "give a .txt file. GraphML is written in Python by "
        "networkx.write_graphml(maze.to_graph(), path)",
    )
    check_new_files([given.out, picture], given.overwrite)
    if made.num_cells <= 60**2:
        print(made.to_text(), end="")
    print(describe_maze(made))
    if given.out is not None:
        write_text(given.out, made.to_text())
    if picture is not None:
        draw_maze(made, picture)


def draw_maze(maze: Maze, path: Path) -> None:
    """Draw a rendered maze (.png), or its lines (.svg), with the marks S, G and E."""
    from pursuit.rendering.rendering import Scene

    if path.suffix == ".png":
        scene = Scene(maze, (), maze.goal_marks, 0, 0, exits=maze.exit_marks)
        picture = scene.picture()
        write_atomically(path, lambda beside: picture.save(beside, format="png"))
        return
    height, width = (0.5 * side + 0.3 for side in maze.picture_size)
    figure, axis = pyplot().subplots(figsize=(width, height))
    draw_walls(axis, maze)
    start = () if maze.start_mark is None else (maze.start_mark,)
    exits = (maze.exit_marks, ORANGE, "s")
    for marks, color, shape in ((start, BLUE, "o"), (maze.goal_marks, GREEN, "*"), exits):
        cells = list(marks)
        axis.plot(*maze.picture[cells].T[::-1], shape, color=color, ms=11)
    axis.invert_yaxis()
    axis.set_aspect("equal")
    axis.axis("off")
    save(figure, path)


def describe_maze(maze: Maze) -> str:
    """The properties of a maze, one per line."""
    from scripted_agents.exact.tours.tour import expected_tour_length

    parts = maze.num_components
    facts = {
        "cells": f"{maze.num_cells} of {maze.height} x {maze.width}"
        if maze.is_grid
        else f"{maze.num_cells} of a graph with up to {maze.num_moves} neighbors",
        "connected": "yes" if parts == 1 else f"no: {parts} parts",
    }
    if not maze.is_directed:
        facts |= {"dead ends": str(len(maze.dead_ends)), "loops": str(maze.num_loops)}
    if maze.num_cells <= MAX_TABLE_CELLS:
        facts["longest shortest path"] = str(maze.longest_distance)
    if maze.exit_marks:
        facts["exits"] = "cells " + ", ".join(map(str, maze.exit_marks))
    if parts == 1 and maze.num_cells <= MAX_TABLE_CELLS:
        for goals in range(1, min(3, maze.num_cells - 1) + 1):
            mean = expected_tour_length(maze, goals)
            how = "" if mean.exact else f" (sampled, ± {mean.ci95:.2f})"
            facts[f"mean tour of {goals} goal(s)"] = f"{mean:.4f}{how}"
    return in_lines(facts, 26)
