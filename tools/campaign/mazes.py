"""Random maze texts: each is valid and can be played, or is refused with one line."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np

import pursuit
from pursuit.mazes.maze import library_names

CASES = 2000
ALPHABET = " #SG+-|x.0\t\n\r\x00é𝄞￿"
TASKS = ("chase", "maze", "race", "heist")


def case(random: Random, folder: Path) -> tuple[str, list[str]]:
    """Read one text and play in it: its description, and its faults."""
    text = draw(random)
    faults: list[str] = []
    try:
        if random.random() < 0.2:
            path = folder / "maze.txt"
            content = text.encode("utf-8", "surrogatepass")
            path.write_bytes(content if random.random() < 0.5 else content + b"\xff\xfe")
            maze = pursuit.load_maze(path)
        else:
            maze = pursuit.Maze.from_text(text)
    except ValueError as error:
        if "\n" in str(error).strip() and len(str(error)) > 400:
            faults.append("a refusal of many lines")
        return repr(text[:200]), faults
    again = pursuit.Maze.from_text(maze.to_text())
    if again != maze or hash(again) != hash(maze) or again.num_cells != maze.num_cells:
        faults.append("to_text does not round-trip")
    if maze.num_cells <= 400:
        faults += _played(maze, random)
    return repr(text[:200]), faults


def _played(maze: pursuit.Maze, random: Random) -> list[str]:
    try:
        task = pursuit.make_task(
            random.choice(TASKS),
            maze=maze,
            min_start_distance=random.choice((1, 1, 2, 5)),
            start=random.choice(("random", "marks")),
            stay_action=random.random() < 0.5,
        )
    except ValueError:
        return []
    simulator = pursuit.Simulator(task, num_games=3, seed=random.randrange(2**32))
    actions = np.random.default_rng(random.randrange(2**32))
    for _ in range(20):
        simulator.step(actions.integers(0, task.num_actions, simulator.positions.shape))
        if not ((simulator.positions >= 0) & (simulator.positions < maze.num_cells)).all():
            return ["an agent outside the maze"]
    return []


def draw(random: Random) -> str:
    """A random text: a modified maze of the library, a random grid, or random characters."""
    kind = random.random()
    if kind < 0.6:
        text = pursuit.load_maze(random.choice(library_names())).to_text()
        for _ in range(random.choice((1, 1, 2, 5, 30))):
            text = _tampered(text, random)
        return text
    if kind < 0.9:
        rows, columns = 2 * random.randrange(0, 7) + 1, 2 * random.randrange(0, 7) + 1
        marks = random.choice((" +-|", " #", " #SG+-|", ALPHABET))
        grid = ["".join(random.choice(marks) for _ in range(columns)) for _ in range(rows)]
        return random.choice(("\n", "\n", "\r\n", "\r")).join(grid)
    return random.choice(
        (
            "",
            "\n",
            "+" * 10_001,
            "\n" * 5000,
            "+-+\n| |\n+-+",
            "+-+\n|S|\n+-+\n" * 2,
            "".join(random.choice(ALPHABET) for _ in range(random.randrange(300))),
        )
    )


def _tampered(text: str, random: Random) -> str:
    at = random.randrange(len(text) + 1)
    mark, length = random.choice(ALPHABET), random.randrange(1, 12)
    lines = text.split("\n")
    random_line = random.randrange(len(lines))
    return random.choice(
        (
            text[:at] + mark + text[at + 1 :],
            text[:at] + mark + text[at:],
            text[:at] + text[at + length :],
            text[:at],
            text.replace(mark, random.choice(ALPHABET)),
            "\n".join(lines[:random_line] + lines[random_line + 1 :]),
            "\n".join(lines[:random_line] + [lines[random_line]] * 2 + lines[random_line:]),
            "\n".join(line.rstrip() for line in lines),
        )
    )
