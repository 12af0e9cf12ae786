"""Learning curves of runs, sweeps and ablations laid over each other, with their table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.forms import read_hints
from train.experiments.measures import GAP, Measure, measure_of
from train.experiments.methods import METHODS, METHODS_LINE, methods
from train.experiments.page import page_of
from train.experiments.sweep_figures import BAND_FROM, draw_group
from train.experiments.sweep_report import put_groups, summary, table_of
from train.experiments.tables import collect, row_of
from train.figures import (
    KINK,
    PALETTE,
    PLAIN,
    Look,
    names_of,
    plain_numbers,
    pyplot,
    save,
    short_numbers,
    tidy,
    time_axis,
    time_head,
    time_scale,
)
from train.files import begins_with, only_one, write_text
from train.result_table import in_markdown
from train.runs.folder import CONFIG, RESULTS, read_metrics
from train.self_play.names import entry_names
from train.settings.checks import check

DASHES = ("-", "--", "-.", ":")
"""Of curves beyond the palette, which begins again."""
GAP_CURVE = replace(GAP, curve="optimality_gap", curve_axis=GAP.axis)
"""Runs that know their optimum are laid over each other by the gap: whatever their tasks are."""

TITLE = "Learning curves of"
"""Begins the titles of these reports."""

Rows = list[dict[str, Any]]


def overlay(folders: Sequence[Path | str], out: Path | str, look: Look = PLAIN) -> Path:
    """Lay the learning curves of all that is in `folders` over each other.

    A run is a curve; a sweep has one for each of its settings, an ablation one for each arm, of
    which each is the mean over seeds with its 95 % bootstrap interval.

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
    rows: Rows = []
    by_run: dict[str, Rows] = {}
    paths: list[Path] = []
    for name, folder in zip(names, folders, strict=True):
        found = _curves_of(Path(folder))
        for row, path in found:
            parts = (name if len(folders) > 1 or not row["_group"] else "", row["_group"])
            row["_group"] = ": ".join(filter(None, parts))
            row["run"], row["_x"] = str(path), ""
            by_run[row["run"]] = read_metrics(path)
            rows.append(row)
            paths.append(path)
    judged = {(str(row["objective"]), str(row["unit"])) for row in rows}
    check(
        len(judged) == 1,
        f"these runs are judged by {' and '.join(sorted(name for name, _ in judged))}, which no "
        "axis has both of; give runs of one kind",
    )
    measure = measure_of(rows)
    measure = GAP_CURVE if measure is GAP else measure
    check(not out.is_file(), f"{out}: a file; give a folder")
    table = table_of(rows, summary(rows, None), None)
    title = f"{TITLE} {', '.join(names)}"
    files = ", ".join(f"[{name}]({name})" for name in names_of("curves.png", look))
    lines = [f"# {in_markdown(title)}", "", table.markdown(), ""]
    lines += [told_bands(rows), ""]
    lines += [METHODS_LINE, "", "![curves.png](curves.png)", "", f"Figure: {files}", ""]
    with only_one(out, "report"):
        draw_overlay(out / "curves.png", rows, by_run, measure, look)
        table.write(out)
        write_text(out / METHODS, methods(paths))
        write_text(out / "report.md", "\n".join(lines))
        page_of(out / "report.md")
    return out


def is_overlay(folder: Path) -> bool:
    """Whether `overlay` wrote this folder."""
    return begins_with(folder / "report.md", f"# {TITLE}")


def told_bands(rows: Rows) -> str:
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


def _curves_of(folder: Path) -> list[tuple[dict[str, Any], Path]]:
    """The complete runs in a folder with the curve that each belongs to, and their folders."""
    if (folder / CONFIG).exists():
        check(
            (folder / RESULTS).exists(),
            f"{folder}: a run without results yet; go on with it by --resume {folder}",
        )
        row = row_of(folder)
        row["_group"] = ""
        return [(row, folder)]
    hints = read_hints(folder)
    runs, _ = collect(folder)
    rows = [row for row in runs.to_dicts() if row["status"] == "complete"]
    check(bool(rows), f"{folder}: no run is complete yet; `pursuit sweep` goes on with it")
    if hints.control is not None:
        hints.group = ["variant"]
        place = {arm: number for number, arm in enumerate(hints.arms)}
        rows.sort(key=lambda row: place.get(row["variant"], len(place)))
    x = put_groups(rows, hints, runs.columns)
    if x and len({row["_x"] for row in rows}) > 1:
        for row in rows:
            row["_group"] += f", {x.replace('_', ' ')} {row['_x']}"
    return [(row, folder / "runs" / row["run"]) for row in rows]


def draw_overlay(
    path: Path, rows: Rows, by_run: dict[str, Rows], measure: Measure, look: Look = PLAIN
) -> None:
    """All curves over one axis of frames, or seconds.

    Args:
        path: of the figure.
        rows: a row of each run, with "run" and "_group", its curve.
        by_run: the evaluations of each run.
        measure: what is drawn.
        look: how.
    """
    unit = look.x or "frames"
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    figure, axis = pyplot().subplots(figsize=(7.6, 4.2), layout="constrained")
    everything = []
    for number, group in enumerate(groups):
        curves = []
        for row in (row for row in rows if row["_group"] == group):
            known = [e for e in by_run[row["run"]] if measure.curve in e]
            times = np.array([e[unit] for e in known]) * time_scale(unit)
            factor = 100.0 if measure is GAP_CURVE else 1.0
            curves.append((times, factor * np.array([e[measure.curve] for e in known])))
        color = PALETTE[number % len(PALETTE)]
        dash = DASHES[number // len(PALETTE) % len(DASHES)]
        everything.append(draw_group(axis, curves, color, group, look.log, dash, measure).ravel())
    if measure is GAP_CURVE:
        ends = np.concatenate(everything)
        least, most = float(np.nanmin(ends)), float(np.nanmax(ends))
        if least >= 1.0:
            axis.set_yscale("log")
            plain_numbers(axis.yaxis)
        else:  # the optimum is in sight
            axis.set_yscale("symlog", linthresh=KINK)
            axis.set_ylim(1.5 * min(least, 0.0) - 0.3, 1.5 * max(most, 0.0) + 0.3)
            axis.axhline(0, color="#333333", lw=1.2, ls=":")
            short_numbers(axis.yaxis)
    elif measure.logarithmic:
        axis.set_yscale("log")
        plain_numbers(axis.yaxis)
    elif measure.curve != "mean_return":
        axis.set_ylim(bottom=0)
    time_axis(axis, look.log)
    axis.set_xlabel(time_head(unit))
    axis.set_ylabel(measure.curve_axis)
    tidy(axis)
    if len(groups) > 1:
        figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    save(figure, path, 150, look.formats)
