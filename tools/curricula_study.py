"""The analysis of the ablations of curricula: tables and the figure of their page.

    python tools/curricula_study.py

It reads runs.csv and tuning.csv in docs/results/data/curricula/, prints the tables of
docs/results/curricula.md and draws its figure, of the ablations of which all runs have ended. A
test compares the page with these numbers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from train.experiments.halving import score

from train.experiments.expansion import NO_SETTINGS
from train.experiments.recorded import read_recorded, settings_in
from train.experiments.rows import StudyRows
from train.experiments.statistics import holm
from train.experiments.study import Layout, StudyFile, choose_version, read_file
from train.experiments.summary import paired_columns, variant_columns
from train.experiments.variants import (
    MAZE,
    MAZE_GAP,
    against_control,
    by_variant,
    distance_of,
    p_text,
    paired_row,
)
from train.reports.tables import ResultTable, plain_table, short

DATA = Path(__file__).parents[1] / "docs" / "results" / "data" / "curricula"
STUDIES = (
    "opponent-epsilon",
    "goal-spread-start",
    "adaptive",
    "maze-size",
    "goal-spread-fixed",
    "mazes",
    "order",
)
OWN_FILE = DATA / "order.toml"
"""The file of "order"; the other ablations are shipped."""
ORDERS = {
    "order of the stages": (
        ("opponent-epsilon", "linear", "shuffled"),
        ("goal-spread-start", "linear", "shuffled"),
        ("adaptive", "linear", "shuffled"),
        ("maze-size", "open walls, linear", "open walls, shuffled"),
    ),
    "order of the stages, repeated": (
        ("order", "linear", "shuffled"),
        ("order", "linear", "reversed"),
    ),
}
"""Stages in order against stages in another order, as (study, variant, variant), by table."""
MEASURES = ("objective", "shortfall", "mean_optimality", "hardest_share", "frames")
"""What a failed run takes from another one."""
HEAD = "gap in order / in other order [95 %]"
Row = dict[str, Any]


def rows_of(name: str = "runs") -> list[Row]:
    """The rows of a file."""
    return [*read_recorded(DATA / f"{name}.csv").values()]


def file_of(name: str) -> StudyFile:
    """An ablation as it was run: the full version."""
    path = str(OWN_FILE) if name == OWN_FILE.stem else name
    file = read_file(path, "ablation", StudyFile)[1]
    return choose_version(file, "full" if file.full else None)


def study_of(name: str) -> StudyRows:
    """The runs of an ablation; several have the control in common. A failed run counts as the
    largest gap of all runs in its maze."""
    file = file_of(name)
    settings, grid = file.settings or {}, file.grid or {}
    names = [str(variant["name"]) for variant in file.variants or ()]
    mazes = grid.get(MAZE, [settings.get(MAZE)])
    x = MAZE if MAZE in grid else None
    layout = Layout(str(file.title), x=x, control=file.control, primary=file.primary)
    layout.variants = names
    rows = [
        row | {"_x": row[MAZE] if x else ""}
        for row in rows_of()
        if row["variant"] in names
        and row[MAZE] in mazes
        and row["budget_frames"] == settings["frames"]
    ]
    for row in rows:
        if row["status"] != "complete":
            same = [other for other in rows if other[MAZE] == row[MAZE] and other["shortfall"]]
            worst = max(same, key=lambda other: other["shortfall"])
            row |= {name: worst[name] for name in MEASURES}
    return StudyRows(layout, rows, rows, x)


def complete() -> list[str]:
    """The ablations of which all runs have ended."""
    found = []
    for name in STUDIES:
        file = file_of(name)
        wanted = len(file.variants or ()) * len((file.grid or {}).get(MAZE, [""]))
        if len(study_of(name).everything) == wanted * len(file.seeds or ()):
            found.append(name)
    return found


def table_of(name: str) -> str:
    """The variants of an ablation against its control."""
    study = study_of(name)
    distance = distance_of(study)
    columns = variant_columns(study.layout)[:5]  # up to the gaps at the end
    if distance is not None:
        columns = paired_columns(study.layout, distance)
    return ResultTable(against_control(study), columns).markdown()


def order_table(comparisons: Sequence[tuple[str, str, str]]) -> str:
    """Stages in order against stages in another order, corrected together (Holm)."""
    found = []
    for name, one, other in comparisons:
        variants = by_variant(study_of(name))
        label = f"{name}: {one} / {other}"
        found.append(paired_row(label, variants[one], variants[other], MAZE_GAP))
    for row, p in zip(found, holm([row["p"] for row in found]), strict=True):
        row["p_holm"] = p
    lines = []
    for row in found:
        low, middle, high = (f"{row[f'ratio{end}']:.2f}" for end in ("_low", "", "_high"))
        line = {"study": row["variant"], HEAD: f"{middle} [{low}, {high}]"}
        lines.append(line | {"lower in": row["lower_in"], "p": p_text(row["p_holm"])})
    return plain_table(lines).markdown()


def chosen(names: Sequence[str]) -> list[Row]:
    """The settings that the search chose, by study and variant."""
    rows, found = rows_of("tuning"), list[Row]()
    for name in names:
        file = file_of(name)
        if file.tuning is None:
            continue
        trials = file.tuning.trials("full")
        frames = (trials.frames or 0) * 2 ** (trials.rungs - 1)
        for variant in file.variants or ():
            if variant["name"] in file.tuning.like:
                continue
            own: dict[int, list[Row]] = {}
            for row in rows:
                same = row["variant"] == variant["name"] and row[MAZE] in file.tuning.mazes
                if same and row["budget_frames"] == frames:
                    own.setdefault(row["trial"], []).append(row)
            best = own[min(own, key=lambda number: (score(own[number]), number))][0]
            settings = (
                f"{key} {short(best[key])}"
                for key in settings_in([*best])
                if key not in (MAZE, "variant", *NO_SETTINGS, *variant) and best[key] is not None
            )
            line = {"study": name, "variant": variant["name"]}
            found.append(line | {"settings": ", ".join(settings) or "the defaults"})
    return found


def tables() -> dict[str, str]:
    """The tables of the page as Markdown, by title; those of the order need all ablations."""
    names = complete()
    found = {name: table_of(name) for name in names}
    if names == [*STUDIES]:
        found |= {title: order_table(comparisons) for title, comparisons in ORDERS.items()}
    return {**found, "settings": plain_table(chosen(names)).markdown()}


def draw_ratios(path: Path, names: Sequence[str]) -> None:
    """The ratio of the gap of every variant to that of its control, with its interval."""
    from matplotlib import pyplot
    from matplotlib.ticker import LogLocator, NullLocator

    figure, axis = pyplot.subplots(figsize=(7.2, 6.4), layout="constrained")
    axis.axvline(1.0, color="0.6", lw=1.0)
    labels: list[str] = []
    for number, name in enumerate(names):
        for row in against_control(study_of(name)):
            if row["verdict"] == "control":
                continue
            ends = [[row["ratio"] - row["ratio_low"]], [row["ratio_high"] - row["ratio"]]]
            axis.errorbar(row["ratio"], len(labels), xerr=ends, fmt="o", color=f"C{number}", ms=4)
            labels.append(f"{name}: {row['variant']}")
    axis.set_yticks(range(len(labels)), labels, fontsize=8)
    axis.invert_yaxis()
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_locator(NullLocator())
    axis.set_xlabel("gap to the optimum / gap without a curriculum")
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Print the tables, and draw the figure."""
    if not (names := complete()):
        sys.exit(f"no ablation is complete in {DATA}: results are read once all runs have ended")
    for title, table in tables().items():
        print(f"\n{title}\n\n{table}")
    draw_ratios(DATA / "ratios.png", [n for n in names if distance_of(study_of(n)) is not None])


if __name__ == "__main__":
    main()
