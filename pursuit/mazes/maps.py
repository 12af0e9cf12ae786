"""Readers of other projects' maps: MovingAI's maps and scenarios, and grids of maze benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from pursuit.mazes.formats import read_movingai, read_squares
from pursuit.mazes.maze import Maze
from pursuit.mazes.sources import read_text


class Scenario(NamedTuple):
    """One problem of a `.scen` file.

    Attributes:
        map: the file name of the map.
        height, width: of the map.
        start, goal: (row, column).
        optimal_length: of the best path by the file: octile, with diagonal steps of length √2, so
            never more than our steps, which go along rows and columns.
    """

    map: str
    height: int
    width: int
    start: tuple[int, int]
    goal: tuple[int, int]
    optimal_length: float


def read_map(path: str | Path) -> Maze:
    """A map in MovingAI's format (`.map`; Sturtevant, 2012) as a maze.

    Passable squares (`.`, `G` and swamp, `S`) are cells, joined to their neighbours; all others
    (`@`, `O`, `T`, and water, `W`, which those maps do not let be entered from land) are blocked.
    `pursuit.load_maze` reads files whose name ends in `.map` so, too.

    Raises:
        ValueError: no such file, or no such map.
    """
    return Maze(*read_movingai(read_text(Path(path)), str(path)), name=str(path))


def read_scenarios(path: str | Path) -> tuple[Scenario, ...]:
    """The problems of a MovingAI `.scen` file, in its order.

    Raises:
        ValueError: no such file, or a line that is no problem.
    """
    lines = read_text(Path(path)).splitlines()
    if not lines or not lines[0].lower().startswith("version"):
        raise ValueError(f"{path}: line 1: a scenario file begins with 'version 1'")
    found = []
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        parts = line.split("\t") if "\t" in line else line.split()
        try:
            _, name, *numbers, length = parts
            width, height, start_x, start_y, goal_x, goal_y = map(int, numbers)
            optimal = float(length)
        except ValueError:
            raise ValueError(
                f"{path}: line {number}: nine columns needed: bucket, map, width, height, start x, "
                "start y, goal x, goal y, optimal length"
            ) from None
        start, goal = (start_y, start_x), (goal_y, goal_x)
        found.append(Scenario(name, height, width, start, goal, optimal))
    return tuple(found)


def cell_at(maze: Maze, place: tuple[int, int]) -> int:
    """The number of the cell at (row, column) of a maze.

    Raises:
        ValueError: it is outside the maze, or blocked.
    """
    row, column = place
    inside = 0 <= row < maze.height and 0 <= column < maze.width
    cell = int(maze.cell_numbers[row, column]) if inside else -1
    if cell < 0:
        raise ValueError(f"{maze.name}: {place} is {'blocked' if inside else 'outside the maze'}")
    return cell


def read_grid(text: str, name: str = "grid") -> Maze:
    """A grid of characters in the manner of maze benchmarks (JaxUED, minimax, gym-minigrid).

    `#` is a wall, which fills a whole square and so is a blocked cell; `.` is floor, `G` a goal,
    and `>`, `<`, `^`, `v` the start of the agent.

    Raises:
        ValueError: naming the line and the remedy, if the text is no such grid.
    """
    return Maze(*read_squares(text, name), name=name)
