"""`pursuit regret`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from matplotlib.colors import Normalize, SymLogNorm

from pursuit.mazes.maze import Maze
from train.commands.parse import Formats, heard, parse
from train.evaluation.contest import GameContest
from train.evaluation.regret import REMEDY, Regret, group_rows, regret_of
from train.files import begins_with, check_folder, check_output_folder, write_csv, write_text
from train.reports.figures import PLAIN, Look, draw_cells, pyplot, save
from train.reports.tables import Column, ResultTable, in_markdown
from train.settings.checks import Settings, at_least, passes

WORST = 5
HEAD = "# Regret\n\n"


@dataclass(frozen=True)
class RegretCommand(Settings):
    """Say in which states the policy of a run loses what it loses against the exact optimum.

    The gap is taken apart without a rest: what every state costs a game, how often it is visited,
    how much depends on the choice there, a map of it, and the worst states.
    """

    run: Annotated[Path, tyro.conf.Positional, passes(check_folder)]
    """The folder of the run: a duel, or a runner alone, in one maze."""
    sampled: bool = False
    """Look at the policy that draws its actions, not at the one that takes the most probable."""
    episodes: Annotated[int, at_least(1)] = 2000
    """Games of a runner; duels are solved over all starts."""
    seed: int = 0
    """Of those games."""
    out: Path | None = None
    """The folder of table.csv, states.csv, regret.md and map.png; regret in that of the run if left
    out."""
    format: Formats = ()
    """pdf, svg, or both: the map is saved so, too."""
    overwrite: bool = False
    """Write into --out though it holds files of others, and replace those of the same names."""


def regret(arguments: Sequence[str]) -> None:
    """`pursuit regret`."""
    given = parse(RegretCommand, arguments, "regret")
    out, look = given.out or given.run / "regret", Look(given.format)
    check_output_folder(
        out, lambda folder: begins_with(folder / "regret.md", HEAD), given.overwrite
    )
    from train.runs.opponents import load_policy  # torch is slow to import
    from train.runs.parts import contest_of
    from train.runs.saved import load_settings

    with heard():
        settings = load_settings(given.run)
        policy = load_policy(given.run, greedy=not given.sampled)
    contest = contest_of(settings.task, given.episodes, given.seed)
    if not isinstance(contest, GameContest):
        raise ValueError(f"{given.run}: {REMEDY}")
    found = regret_of(contest, policy)
    out.mkdir(parents=True, exist_ok=True)
    table = table_of(found)
    maze = contest.task.mazes[0]
    kind = "sampled" if given.sampled else "greedy"
    lines = ["", *told(found, kind), "", table.markdown(), ""]
    lines += [f"The worst states of {len(found.cell)} that are visited:", "", *worst(maze, found)]
    page = [HEAD + in_markdown(contest.line()), *lines, "", "![map.png](map.png)", ""]
    write_text(out / "regret.md", "\n".join(page))  # first: it tells whose folder this is
    write_csv(out / "table.csv", table.rows)
    write_csv(out / "states.csv", state_rows(found))
    draw_map(out / "map.png", maze, found, f"{contest.role}, {kind}", look)
    print("\n".join([contest.line(), *lines]))
    print(f"\ntable.csv, states.csv, regret.md and map.png: {out}")


def told(found: Regret, kind: str) -> list[str]:
    """What is lost in all."""
    lost = found.achieved - found.optimum
    how = "exact, over all starts" if found.exact else "over the games that were played"
    lines = [
        f"{kind} policy: {found.achieved:.3f} steps, optimum {found.optimum:.3f} ({how}): "
        f"{lost:+.3f} steps, {100 * lost / found.optimum:+.2f} %."
    ]
    if found.unsolved:
        share = 100 * found.unsolved
        lines.append(f"Games that run out of time lose {share:.1f} % of it.")
    return lines


def table_of(found: Regret) -> ResultTable:
    """What groups of states cost."""
    columns = [
        Column("by", lambda row: str(row["by"]), left=True),
        Column("", lambda row: str(row["group"]), left=True),
        Column("states", lambda row: f"{row['states']:,}"),
        Column("visits a game", lambda row: f"{row['visits']:.2f}"),
        Column("steps lost a game", lambda row: f"{row['lost']:.4f}"),
        Column("of all that is lost", lambda row: f"{100 * row['share']:.1f} %"),
        Column("steps lost a visit", lambda row: f"{row['per_visit']:.4f}"),
    ]
    return ResultTable(group_rows(found), columns)


def state_rows(found: Regret) -> list[dict[str, Any]]:
    """A row for each state that is visited, the most expensive first."""
    names = ("cell", "other", "goals_left", "distance", "action_gap", "visits", "lost")
    order = np.argsort(-found.lost, kind="stable")
    columns = [getattr(found, name)[order].tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def worst(maze: Maze, found: Regret) -> list[str]:
    """The most expensive states in words."""
    lines = []
    for row in state_rows(found)[:WORST]:
        if row["lost"] <= 0.0:
            break
        other = f"{row['goals_left']} left, the nearest" if row["goals_left"] else "the other"
        where = place(maze, row["cell"])
        if row["other"] >= 0:
            where += f", {other} at {place(maze, row['other'])}, {row['distance']} steps away"
        lines.append(
            f"- at {where}: {row['lost']:.4f} steps a game, {row['visits']:.3f} visits, "
            f"action gap {row['action_gap']:.3f}"
        )
    return lines or ["- none: nothing is lost anywhere"]


def place(maze: Maze, cell: int) -> str:
    """A cell as (row, column)."""
    return f"({maze.rows[cell]}, {maze.columns[cell]})"


def draw_map(path: Path, maze: Maze, found: Regret, title: str, look: Look = PLAIN) -> None:
    """Two mazes: how often the agent is in a cell, and what a game loses there."""
    side = min(6.0, 1.5 + 0.45 * max(maze.height, maze.width))
    figure, axes = pyplot().subplots(
        1, 2, figsize=(2 * side + 1.4, side + 0.8), layout="constrained"
    )
    parts = (("visits a game", found.visits, "Blues"), ("steps lost a game", found.lost, "Reds"))
    for axis, (name, values, colors) in zip(axes, parts, strict=True):
        cells = np.maximum(np.bincount(found.cell, values, maze.num_cells), 0.0)
        top = max(float(cells.max()), 1e-9)
        norm: Normalize = Normalize(0.0, top)
        ticks = [0.0, top / 2, top]
        if values is found.lost:
            norm, ticks = SymLogNorm(top / 100, vmin=0.0, vmax=top), [0.0, top / 100, top / 10, top]
        image = draw_cells(axis, maze, cells, name, cmap=colors, norm=norm)
        bar = figure.colorbar(image, ax=axis, shrink=0.8, ticks=ticks)
        bar.ax.set_yticklabels([f"{tick:.2g}" for tick in ticks])
        bar.ax.minorticks_off()
    figure.suptitle(f"{maze.name}: {title}", fontsize=11)
    save(figure, path, formats=look.formats)
