"""Learning curves of runs, sweeps and ablations laid over each other, with their table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from train.experiments.measures import GAP, Measure, measure_of
from train.experiments.methods import METHODS_LINE
from train.experiments.report import write_report
from train.experiments.sweep_report import put_groups, series_of, summary, table_of
from train.experiments.tables import read_study, row_of
from train.files import begins_with, only_one
from train.reports.curves import BAND_FROM, Panel, draw_panels
from train.reports.figures import PALETTE, PLAIN, Look, names_of
from train.reports.tables import Row
from train.runs.folder import CONFIG, RESULTS, read_metrics
from train.self_play.names import entry_names
from train.settings.checks import check

DASHES = ("-", "--", "-.", ":")
"""Of curves beyond the palette, which begins again."""
GAP_CURVE = replace(GAP, curve="optimality_gap", curve_label="gap to the optimum (%)",
                    curve_scale="gap")  # fmt: skip
"""Runs that know their optimum are laid over each other by the gap: whatever their tasks are."""

TITLE = "Learning curves of"
"""Begins the titles of these reports."""


def overlay(folders: Sequence[Path | str], out: Path | str, look: Look = PLAIN) -> Path:
    """Lay the learning curves of all that is in `folders` over each other.

    A run is a curve; a sweep has one for each of its settings, an ablation one for each arm, of
    which each is the mean over seeds.

    Args:
        folders: of runs, sweeps and ablations, of one kind of runs; at least one.
        out: where `curves.png`, `report.md`, `methods.md`, `table.csv` and `table.tex` are written.
        look: of the figure; over frames if it does not say.

    Returns:
        `out`.

    Raises:
        ValueError: a folder without anything that is complete, or runs that are judged by different
            measures.
    """
    out = Path(out)
    names = entry_names([str(folder) for folder in folders], lambda entry: False)
    rows: list[Row] = []
    for name, folder in zip(names, folders, strict=True):
        for row in _runs_in(Path(folder)):
            parts = (name if len(folders) > 1 or not row["_group"] else "", row["_group"])
            rows.append(row | {"_group": ": ".join(filter(None, parts)), "_x": ""})
    judged = {(str(row["objective"]), str(row["unit"])) for row in rows}
    check(
        len(judged) == 1,
        f"these runs are judged by {' and '.join(sorted(name for name, _ in judged))}, which no "
        "axis has both of; give runs of one kind",
    )
    measure = measure_of(rows)
    check(not out.is_file(), f"{out}: a file; give a folder")
    table = table_of(rows, summary(rows, None), None)
    title = f"{TITLE} {', '.join(names)}"
    files = ", ".join(f"[{name}]({name})" for name in names_of("curves.png", look))
    lines = [told_bands(rows), "", METHODS_LINE, "", "![curves.png](curves.png)"]
    lines += ["", f"Figure: {files}", ""]
    with only_one(out, "report"):
        draw_overlay(out / "curves.png", rows, GAP_CURVE if measure is GAP else measure, look)
        write_report(out, title, table, lines, [row["run"] for row in rows])
    return out


def is_overlay(folder: Path) -> bool:
    """Whether `overlay` wrote this folder."""
    return begins_with(folder / "report.md", f"# {TITLE}")


def told_bands(rows: list[Row]) -> str:
    """What the bands of the curves are."""
    runs = Counter(row["_group"] for row in rows)
    most, least = max(runs.values()), min(runs.values())
    if most == 1:
        return "A curve is a single run: how others would end, nothing here tells."
    told = "A thick curve is the mean over runs as far as the shortest of them goes; "
    band = "a band is Student's 95 % interval of that mean"
    if least >= BAND_FROM:
        return told + band + "."
    told += "thin ones are the runs"
    return told + (f", where they are below {BAND_FROM}; {band}." if most >= BAND_FROM else ".")


def _runs_in(folder: Path) -> list[Row]:
    """The complete runs in a folder: "run" is where each is, "_group" the curve it belongs to."""
    if (folder / CONFIG).exists():
        check(
            (folder / RESULTS).exists(),
            f"{folder}: a run without results yet; go on with it by --resume {folder}",
        )
        return [row_of(folder) | {"run": str(folder), "_group": ""}]
    study = read_study(folder)
    rows, hints = study.rows, study.hints
    if hints.control is not None:
        hints.group = ["variant"]
        place = {arm: number for number, arm in enumerate(hints.arms)}
        rows.sort(key=lambda row: place.get(row["variant"], len(place)))
    x = put_groups(rows, hints, study.columns)
    several = x is not None and len({row["_x"] for row in rows}) > 1
    for row in rows:
        row["run"] = str(folder / "runs" / row["run"])
        if several:
            row["_group"] += f", {str(x).replace('_', ' ')} {row['_x']}"
    return rows


def draw_overlay(path: Path, rows: list[Row], measure: Measure, look: Look = PLAIN) -> None:
    """All curves over one axis of frames, or seconds.

    Args:
        path: of the figure.
        rows: a row of each run, with "run", its folder, and "_group", its curve.
        measure: what is drawn.
        look: how.
    """
    unit = look.x or "frames"
    by_run = {row["run"]: read_metrics(Path(row["run"])) for row in rows}
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    series = [
        series_of(
            [row for row in rows if row["_group"] == group], by_run, unit, measure, label=group,
            color=PALETTE[place % len(PALETTE)], style=DASHES[place // len(PALETTE) % len(DASHES)],
        )
        for place, group in enumerate(groups)
    ]  # fmt: skip
    panel = Panel(series, measure.curve_label, scale=measure.curve_scale)
    draw_panels(path, [[panel]], unit, look, beside=len(groups) > 1)
