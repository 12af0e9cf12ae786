"""`pursuit snapshots`: Elo against exploitability over the snapshots of self-play."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from train.commands.parse import Formats, heard, parse
from train.commands.tables import print_table
from train.figures import Look
from train.files import begins_with, check_output_folder, write_csv, write_json, write_text
from train.result_table import Column, ResultTable, in_markdown, words
from train.runs.provenance import command_line
from train.self_play.averages import averages, nash_convs, told_averages
from train.settings.checks import check
from train.settings.self_play import ROLES

if TYPE_CHECKING:
    from train.self_play.past import Past, Standings

FOLDER, PAGE = "snapshots", "snapshots.md"
HEADS = ("# Snapshots of self-play on", "# Elo against exploitability")
"""Begin the pages of one run and of several."""


@dataclass(frozen=True)
class SnapshotsCommand:
    """Order the snapshots of self-play by Elo and by exact exploitability: where do they part?

    Elo asks who does better against the others, exploitability what a perfect opponent gains. In a
    duel both are exact. Writes into RUN/snapshots, and of several runs a table of all into --out.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Folders of self-play of duels in which both sides learned."""
    out: Path | None = None
    """The folder of the table of several runs; snapshots if left out. Of a single run: where all of
    it goes."""
    format: Formats = ()
    """pdf, svg, or both: the figures are saved so, too, beside their .png."""
    overwrite: bool = False
    """Write into a folder though it holds files of others, and replace those of the same names."""


def snapshots(arguments: Sequence[str]) -> None:
    """`pursuit snapshots`."""
    given = parse(SnapshotsCommand, arguments, "snapshots")
    check(len(given.runs) > 0, "nothing to look at; give folders of self-play")
    look, several = Look(given.format), len(given.runs) > 1
    outs = [folder / FOLDER for folder in given.runs]
    if not several and given.out is not None:
        outs = [given.out]
    out = (given.out or Path(FOLDER)) if several else outs[0]
    for each in {out, *outs}:
        check_output_folder(each, is_own, given.overwrite)
    from train.self_play.past import read_past, standings  # torch is slow to import

    with heard():
        pasts = [read_past(folder) for folder in given.runs]
    rows: list[dict[str, Any]] = []
    for folder, place, past in zip(given.runs, outs, pasts, strict=True):
        found = standings(past)
        told = write_run(place, past, found, look)
        rows += summary_rows(folder, past, found)
        if not several:
            print("\n".join(told))
            print(f"\nfigure and tables: {out}")
    table = summary_table(rows)
    if several:
        out.mkdir(parents=True, exist_ok=True)
        table.write(out)
        write_text(out / PAGE, f"{HEADS[1]}\n\n{table.markdown()}\n")
        print_table(table)
        print(f"\ntable: {out}; of every run: RUN/{FOLDER}")


def write_run(out: Path, past: Past, found: dict[str, Standings], look: Look) -> list[str]:
    """Write the figure and the tables of a run; the lines that say what came out."""
    from train.self_play.past import (  # torch is slow to import
        agreement,
        parted_by_distance,
        rows_of,
        widest,
    )
    from train.self_play.pictures import draw_snapshots

    out.mkdir(parents=True, exist_ok=True)
    task, sides = past.task, list(found.values())
    maze, sampling = task.mazes[0].name, past.settings.sampling
    told = f"{maze} ({sampling}, seed {past.settings.seed})"
    draw_snapshots(out / "snapshots.png", sides, f"{HEADS[0][2:]} {told}", look)
    table = snapshot_table([row for one in sides for row in rows_of(one)])
    table.write(out)
    names, steps = past.names["evader"], found["chaser"].steps.tolist()
    payoff = [
        {"chaser": chaser} | dict(zip(names, row, strict=True))
        for chaser, row in zip(past.names["chaser"], steps, strict=True)
    ]
    write_csv(out / "payoff.csv", payoff)
    distances = [row for one in sides for row in parted_by_distance(one)]
    taus = {one.role: agreement(one) for one in sides}
    content = {"maze": maze, "sampling": sampling, "seed": past.settings.seed, "tau": taus}
    content |= {"parted_by_distance": distances, "command": command_line()}
    write_json(out / "snapshots.json", content)
    lines = []
    for one in sides:
        tau = taus[one.role]
        lines += [
            f"{one.role}: Kendall's tau between Elo and minus exploitability {tau['whole']:.2f} "
            f"(p {tau['whole_p']:.1g}) over {len(one.names)} snapshots, {tau['second_half']:.2f} "
            f"(p {tau['second_half_p']:.1g}) over the later half",
            *(f"- {told_pair(one, *pair)}" for pair in widest(one)),
        ]
    lines += ["", distance_table(distances).markdown()]
    lines += ["", *average_lines(out, past)]
    body = [
        f"{HEADS[0]} {in_markdown(told)}",
        "",
        *lines,
        "",
        "![snapshots.png](snapshots.png)",
        "",
        table.markdown(),
    ]
    write_text(out / PAGE, "\n".join(body) + "\n")
    return lines


def is_own(folder: Path) -> bool:
    """Whether this command wrote a folder."""
    return any(begins_with(folder / PAGE, head) for head in HEADS)


def average_lines(out: Path, past: Past) -> list[str]:
    """Write averages.csv; NashConv of averages in words, and the table of both sides."""
    pairs = {role: zip(past.names[role], past.tables[role], strict=True) for role in ROLES}
    snapshots = {role: dict(own) for role, own in pairs.items()}
    found = averages(past.task, past.discount, snapshots, past.mixtures)
    rows = [asdict(one) for one in found]
    write_csv(out / "averages.csv", rows)
    columns = [
        words("side", "role"),
        words("policy", "what"),
        Column("snapshots", lambda row: str(row["snapshots"])),
        Column("exploitability, from", lambda row: f"{row['lower']:.4f}"),
        Column("to", lambda row: f"{row['upper']:.4f}"),
    ]
    table = ResultTable(rows, columns).markdown()
    return [f"{told_averages(nash_convs(found))}.", "", table]


def told_pair(one: Standings, first: int, second: int) -> str:
    """Two snapshots that part, in words."""
    return (
        f"{one.names[first]} before {one.names[second]} by Elo ({one.elo[first]:.1f}, "
        f"{one.elo[second]:.1f}), behind it by exploitability ({one.exploitability[first]:.4f}, "
        f"{one.exploitability[second]:.4f})"
    )


def snapshot_table(rows: list[dict[str, Any]]) -> ResultTable:
    """A row for each snapshot."""
    from train.self_play.past import GAMES  # torch is slow to import

    columns = [
        words("side", "role"),
        words("snapshot"),
        Column("frames", lambda row: f"{row['frames']:,.0f}"),
        Column(f"Elo ({GAMES} games a pair)", lambda row: f"{row['elo']:.1f}"),
        Column("exploitability", lambda row: f"{row['exploitability']:.4f}"),
        Column("rank by Elo", lambda row: str(row["rank_by_elo"])),
        Column("by exploitability", lambda row: str(row["rank_by_exploitability"])),
    ]
    return ResultTable(rows, columns)


def distance_table(rows: list[dict[str, Any]]) -> ResultTable:
    """How often two snapshots are ordered differently, by how far apart they were taken."""

    def apart(row: dict[str, Any]) -> str:
        least, most = row["least"], row["most"]
        return str(least) if least == most else f"{least} to {most}"

    columns = [
        words("side", "role"),
        Column("snapshots apart", apart),
        Column("pairs", lambda row: str(row["pairs"])),
        Column("ordered differently", lambda row: f"{100 * row['parted']:.1f} %"),
    ]
    return ResultTable(rows, columns)


def summary_rows(folder: Path, past: Past, found: dict[str, Standings]) -> list[dict[str, Any]]:
    """A row for each side of a run, and one of their means."""
    from train.self_play.past import agreement  # torch is slow to import

    settings = past.settings
    head = {"run": str(folder), "sampling": settings.sampling, "seed": settings.seed}
    rows = []
    for one in found.values():
        half = len(one.elo) // 2
        rows.append(
            {
                **head,
                "role": one.role,
                **agreement(one),
                "elo_spread_second_half": float(np.ptp(one.elo[half:])),
                "exploitability_last": float(one.exploitability[-1]),
            }
        )
    numbers = [name for name, value in rows[0].items() if isinstance(value, float)]
    means = {name: float(np.mean([row[name] for row in rows])) for name in numbers}
    return [*rows, {**head, "role": "mean"} | {k: v for k, v in means.items() if k[-2:] != "_p"}]


def summary_table(rows: list[dict[str, Any]]) -> ResultTable:
    """Kendall's taus of several runs."""

    def number(name: str, form: str = ".2f") -> Any:
        return lambda row: format(row[name], form)

    columns = [
        words("sampling"),
        Column("seed", lambda row: str(row["seed"])),
        words("side", "role"),
        Column("tau, whole run", number("whole")),
        Column("later half", number("second_half")),
        Column("Elo and time", number("elo_time")),
        Column("later half", number("elo_time_second_half")),
        Column("Elo points, later half", number("elo_spread_second_half", ".1f")),
        Column("exploitability at the end", number("exploitability_last", ".4f")),
    ]
    return ResultTable(rows, columns)
