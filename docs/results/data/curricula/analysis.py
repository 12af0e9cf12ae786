"""Tables and figure of docs/results/curricula.md and the README here, of the ablations of which all
runs have ended."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from train.experiments.committed import (
    ablation_of,
    chosen_trials,
    committed_rows,
    has_all_runs,
    tried_settings,
)
from train.experiments.recorded import read_recorded
from train.experiments.rows import StudyRows
from train.experiments.statistics import LEVEL, holm
from train.experiments.study import StudyFile
from train.experiments.variants import (
    MAZE,
    MAZE_GAP,
    against_control,
    by_variant,
    distance_of,
    p_text,
    paired_columns,
    paired_row,
    variant_columns,
)
from train.reports.figures import pyplot, save
from train.reports.tables import ResultTable, plain_table, short

ORDER = "order"
"""The ablation whose file is beside the rows; the others are shipped."""
STUDIES = (
    "opponent-epsilon",
    "goal-spread-start",
    "adaptive",
    "maze-size",
    "goal-spread-fixed",
    "mazes",
    ORDER,
)
ORDERS = {
    "order of the stages": (
        ("opponent-epsilon", "linear", "shuffled"),
        ("goal-spread-start", "linear", "shuffled"),
        ("adaptive", "linear", "shuffled"),
        ("maze-size", "open walls, linear", "open walls, shuffled"),
    ),
    "order of the stages, repeated": (
        (ORDER, "linear", "shuffled"),
        (ORDER, "linear", "reversed"),
    ),
}
"""Stages in order against stages in another order, as (study, variant, variant), by table."""
CHANGES = {
    "opponent-epsilon": "epsilon of the opponent",
    "goal-spread-start": "goals near the start first",
    "adaptive": "goals near the start first",
    "maze-size": "size or walls of the maze",
    "goal-spread-fixed": "goals near fixed marks first",
    ORDER: "goals near the start first, other mazes",
}
"""What the curricula of an ablation that are in the short table change."""
MEASURES = ("objective", "shortfall", "mean_optimality", "hardest_share", "frames")
"""What a failed run takes from another one."""
HEAD = "gap in order / in other order [95 %]"
Row = dict[str, Any]


def file_of(name: str) -> StudyFile:
    """The file of an ablation."""
    return ablation_of(Path(__file__).with_name(f"{name}.toml") if name == ORDER else name)


def with_failed(rows: Sequence[Row]) -> list[Row]:
    """The rows; of a failed run with the results of the largest gap of all runs in its maze."""
    found = []
    for row in rows:
        if row["status"] != "complete":
            same = [other for other in rows if other[MAZE] == row[MAZE] and other["shortfall"]]
            worst = max(same, key=lambda other: other["shortfall"])
            row = row | {name: worst[name] for name in MEASURES}
        found.append(row)
    return found


def studies_in(data: Path) -> dict[str, StudyRows]:
    """The runs of the ablations of which all have ended, by name."""
    rows, found = read_recorded(data / "runs.csv").values(), dict[str, StudyRows]()
    for name in STUDIES:
        file = file_of(name)
        study = committed_rows(file, rows)
        if has_all_runs(file, study):
            study.rows = with_failed(study.everything)
            found[name] = study
    return found


def table_of(study: StudyRows) -> str:
    """The variants of an ablation against its control."""
    distance = distance_of(study)
    columns = variant_columns(study.layout)[:5]  # up to the gaps at the end
    if distance is not None:
        columns = paired_columns(study.layout, distance)
    return ResultTable(against_control(study), columns).markdown()


def short_table(studies: dict[str, StudyRows]) -> str:
    """The linear and the primary variants of all ablations that are paired by maze, and those whose
    difference from the control is shown."""
    lines = []
    for name, what in CHANGES.items():
        study = studies[name]
        for row in against_control(study):
            variant, p = row["variant"], row["p_holm"]
            if variant.endswith("linear") or variant == study.layout.primary or p < LEVEL:
                low, middle, high = (f"{row[f'ratio{end}']:.2f}" for end in ("_low", "", "_high"))
                line = {"ablation": name, "what changes": what, "variant": variant}
                line["million frames"] = f"{study.rows[0]['budget_frames'] / 1e6:g}"
                line |= {"ratio to none [95 %]": f"{middle} [{low}, {high}]"}
                lines.append(line | {"below none": row["lower_in"], "verdict": row["verdict"]})
    return plain_table(lines).markdown()


def order_table(studies: dict[str, StudyRows], comparisons: Sequence[tuple[str, str, str]]) -> str:
    """Stages in order against stages in another order, corrected together (Holm)."""
    found = []
    for name, one, other in comparisons:
        variants = by_variant(studies[name])
        label = f"{name}: {one} / {other}"
        found.append(paired_row(label, variants[one], variants[other], MAZE_GAP))
    lines = []
    for row, p in zip(found, holm([row["p"] for row in found]), strict=True):
        low, middle, high = (f"{row[f'ratio{end}']:.2f}" for end in ("_low", "", "_high"))
        line = {"study": row["variant"], HEAD: f"{middle} [{low}, {high}]"}
        lines.append(line | {"lower in": row["lower_in"], "p": p_text(p)})
    return plain_table(lines).markdown()


def settings_table(data: Path, names: Iterable[str]) -> str:
    """The settings that the search chose, by ablation and variant."""
    rows, found = read_recorded(data / "tuning.csv").values(), list[Row]()
    for name in names:
        file = file_of(name)
        own = {str(variant["name"]): variant for variant in file.variants or ()}
        for variant, trial in chosen_trials(file, rows).items():
            drawn = {n: v for n, v in tried_settings(trial[0]).items() if n not in own[variant]}
            text = ", ".join(f"{n} {short(value)}" for n, value in drawn.items())
            found.append({"study": name, "variant": variant, "settings": text or "the defaults"})
    return plain_table(found).markdown()


def tables(data: Path) -> dict[str, str]:
    """The tables by title; the short one and those of the order need all ablations."""
    studies = studies_in(data)
    found = {name: table_of(study) for name, study in studies.items()}
    if [*studies] == [*STUDIES]:
        found["in short"] = short_table(studies)
        found |= {title: order_table(studies, each) for title, each in ORDERS.items()}
    return {**found, "settings": settings_table(data, studies)}


def figures(data: Path, out: Path) -> None:
    """The ratio of the gap of every variant to that of its control, with its interval."""
    from matplotlib.ticker import LogLocator, NullLocator

    figure, axis = pyplot().subplots(figsize=(7.2, 6.4), layout="constrained")
    axis.axvline(1.0, color="0.6", lw=1.0)
    labels: list[str] = []
    paired = {n: each for n, each in studies_in(data).items() if distance_of(each) is not None}
    for number, (name, study) in enumerate(paired.items()):
        for row in against_control(study):
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
    axis.set_xlabel(
        "gap to the optimum / gap without a curriculum (below 1: nearer with it)\n"
        "geometric means over mazes, 95 % intervals"
    )
    save(figure, out / "ratios.png", dpi=150)
