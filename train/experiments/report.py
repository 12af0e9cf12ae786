"""Figures and tables of a sweep: learning curves, and the final gap against size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train.experiments.statistics import bootstrap_interval, interquartile_mean
from train.experiments.sweep import HINTS
from train.experiments.tables import collect
from train.runs.folder import read_json, write_beside
from train.settings.checks import check

# Okabe and Ito's palette: distinct for colour-blind readers, and in print.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
GRID = 60
"""Points of a curve."""


def report(out: Path) -> Path:
    """Collect the runs of a sweep (or an ablation), draw its figures and write its tables.

    Returns:
        The folder: `report.md`, `table.csv`, and the figures as .png.

    Raises:
        ValueError: no sweep in `out`, or none of its runs has results.
    """
    hints = read_json(out / HINTS) if (out / HINTS).exists() else {}
    if "control" in hints:
        from train.experiments.ablation_report import ablation_report

        return ablation_report(out)
    runs, curves = collect(out)
    rows = [row for row in runs.to_dicts() if row["status"] == "complete"]
    check(bool(rows), f"{out}: no run is complete yet; `pursuit sweep` goes on with it")
    x = hints.get("x") if hints.get("x") in runs.columns else None
    group = [name for name in hints.get("group", []) if name in runs.columns] or ["algorithm"]
    for row in rows:
        row["_group"] = ", ".join(_word(name, row[name]) for name in group)
        row["_x"] = row[x] if x else ""
    groups = list(dict.fromkeys(row["_group"] for row in rows))
    colors = {name: PALETTE[number % len(PALETTE)] for number, name in enumerate(groups)}
    by_run: dict[str, list[dict[str, Any]]] = {}
    for row in curves.to_dicts():
        by_run.setdefault(row["run"], []).append(row)
    folder = out / "report"
    folder.mkdir(exist_ok=True)
    title = hints.get("title", out.name)
    figures = []
    for unit in ("seconds", "frames"):
        name = f"learning_curves_{unit}.png"
        draw_curves(folder / name, rows, by_run, unit, x, colors, title)
        figures.append(name)
    if x and len({row["_x"] for row in rows}) > 1:
        draw_final(folder / "final.png", rows, x, colors, title)
        figures.insert(0, "final.png")
    table = summary(rows, x)
    write_beside(folder / "table.csv", lambda beside: beside.write_text(_csv(table)))
    text = markdown(title, rows, table, figures, runs.to_dicts())
    write_beside(folder / "report.md", lambda beside: beside.write_text(text, encoding="utf-8"))
    return folder


def _word(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:g}" if isinstance(value, int | float) else str(value)


def _size(value: Any) -> tuple[Any, ...]:
    """Orders 3x3 before 10x10, and numbers as numbers."""
    text = str(value)
    digits = "".join(c if c.isdigit() or c == "." else " " for c in text).split()
    return (float(digits[0]) if digits else 0.0, text)


def has_gap(rows: list[dict[str, Any]]) -> bool:
    """Whether every run knows the optimum."""
    return all(row.get("optimality_gap") is not None for row in rows)


def summary(rows: list[dict[str, Any]], x: str | None) -> list[dict[str, Any]]:
    """One row for each x and group: means over seeds with their intervals, gaps in per cent."""
    gap = has_gap(rows)
    table = []
    keys = dict.fromkeys((row["_x"], row["_group"]) for row in rows)
    for value, name in sorted(keys, key=lambda key: _size(key[0])):
        chosen = [row for row in rows if (row["_x"], row["_group"]) == (value, name)]
        steps = [row["mean_steps"] for row in chosen]
        line: dict[str, Any] = {x: value} if x else {}
        line |= {"group": name, "seeds": len(chosen)}
        line["random"] = float(np.mean([row["random_steps"] for row in chosen]))
        line["scripted"] = float(np.mean([row["scripted_steps"] for row in chosen]))
        if gap:
            line["optimal"] = float(np.mean([row["optimal_steps"] for row in chosen]))
        line["learned"] = float(np.mean(steps))
        values = [100.0 * row["optimality_gap"] for row in chosen] if gap else steps
        unit = "gap" if gap else "steps"
        low, high = bootstrap_interval(values)
        line |= {f"{unit}": float(np.mean(values)), f"{unit}_low": low, f"{unit}_high": high}
        line[f"{unit}_iqm"] = interquartile_mean(values)
        line["success"] = 100.0 * float(np.mean([row["success_rate"] for row in chosen]))
        line["seconds"] = float(np.mean([row["seconds"] for row in chosen]))
        line["frames"] = float(np.mean([row["frames"] for row in chosen]))
        table.append(line)
    return table


def _csv(table: list[dict[str, Any]]) -> str:
    import csv
    import io

    text = io.StringIO()
    writer = csv.DictWriter(text, list(table[0]))
    writer.writeheader()
    writer.writerows(table)
    return text.getvalue()


def markdown(
    title: str,
    rows: list[dict[str, Any]],
    table: list[dict[str, Any]],
    figures: list[str],
    everything: list[dict[str, Any]],
) -> str:
    """The report as Markdown."""
    unit = "gap" if "gap" in table[0] else "steps"
    names = [n for n in table[0] if n not in (f"{unit}_low", f"{unit}_high", "frames")]
    heads = {
        unit: "gap to the optimum, % [95 %]" if unit == "gap" else "steps [95 %]",
        f"{unit}_iqm": "interquartile mean",
        "success": "success, %",
    }
    lines = [f"# {title}", ""]
    lines.append("| " + " | ".join(heads.get(n, n.replace("_", " ")) for n in names) + " |")
    lines.append("|" + "---|" * len(names))
    for line in table:
        cells = []
        for name in names:
            value = line[name]
            text = f"{value:.2f}" if isinstance(value, float) else str(value)
            text = text.replace("-0.00", "0.00")
            if name in ("success", "seconds"):
                text = f"{value:.0f}"
            if name == unit and not np.isnan(line[f"{unit}_low"]):
                ends = f" [{line[f'{unit}_low']:.2f}, {line[f'{unit}_high']:.2f}]"
                text += ends.replace("-0.00", "0.00")
            cells.append(text)
        lines.append("| " + " | ".join(cells) + " |")
    machines = sorted({f"{row['machine']}" for row in rows})
    seeds = sorted({row["seed"] for row in rows})
    lines += [
        "",
        f"{len(rows)} runs, seeds {', '.join(map(str, seeds))}, on {'; '.join(machines)}.",
    ]
    lines.append(
        "Intervals: 95 % bootstrap of the mean over seeds. Steps are those of the greedy policy; "
        "an episode that runs out of time counts with all its steps."
    )
    missing = [row for row in everything if row["status"] != "complete"]
    if missing:
        lines += ["", f"Not complete: {len(missing)} runs.", ""]
        lines += [f"- {r['run']}: {r['status']} {r['error'] or ''}".rstrip() for r in missing]
    lines += [""] + [f"![{name}]({name})\n" for name in figures]
    return "\n".join(lines)


# -- figures ---------------------------------------------------------------------------------------


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _tidy(axis: Any) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, lw=0.6)


def bands(
    curves: list[tuple[NDArray[Any], NDArray[Any]]],
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Curves over a common axis: points, mean, and the lower and upper end of the interval.

    The axis ends where the first curve ends; between evaluations a curve is a straight line.
    """
    start = max(float(points[0]) for points, _ in curves)
    end = min(float(points[-1]) for points, _ in curves)
    points = np.linspace(start, max(end, start), GRID)
    values = np.stack([np.interp(points, *curve) for curve in curves])
    ends = np.array([bootstrap_interval(column) for column in values.T])
    return points, values.mean(axis=0), ends[:, 0], ends[:, 1]


def draw_curves(
    path: Path,
    rows: list[dict[str, Any]],
    by_run: dict[str, list[dict[str, Any]]],
    unit: str,
    x: str | None,
    colors: dict[str, str],
    title: str,
) -> None:
    """Mean steps over seconds or frames: a panel for each x, a colour for each group."""
    pyplot = _pyplot()
    import matplotlib

    panels = sorted({row["_x"] for row in rows}, key=_size)
    columns = min(len(panels), 4)
    lines = -(-len(panels) // columns)
    figure, axes = pyplot.subplots(
        lines,
        columns,
        figsize=(3.4 * columns + 1.2, 2.9 * lines + 0.9),
        squeeze=False,
        layout="constrained",
    )
    scale = 1e-6 if unit == "frames" else 1.0
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        here = [row for row in rows if row["_x"] == panel]
        for name, color in colors.items():
            curves = [
                (
                    np.array([r[unit] for r in by_run[row["run"]]]) * scale,
                    np.array([r["mean_steps"] for r in by_run[row["run"]]]),
                )
                for row in here
                if row["_group"] == name and row["run"] in by_run
            ]
            if curves:
                points, mean, low, high = bands(curves)
                axis.plot(points, mean, color=color, lw=1.6, label=name)
                axis.fill_between(points, low, high, color=color, alpha=0.18, lw=0)
        for column, word, style in (
            ("optimal_steps", "optimal", ":"),
            ("scripted_steps", "scripted", "--"),
        ):
            known = [row[column] for row in here if row.get(column) is not None]
            if known:
                axis.axhline(np.mean(known), color="#333333", lw=1.2, ls=style, label=word)
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        axis.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        if x:
            axis.set_title(f"{x.replace('_', ' ')} {panel}", fontsize=10)
        _tidy(axis)
    for axis in axes[:, 0]:
        axis.set_ylabel("episode length (steps, log)")
    figure.supxlabel("training time (s)" if unit == "seconds" else "frames (millions)", fontsize=10)
    figure.suptitle(title, fontsize=11)
    handles: dict[str, Any] = {}
    for axis in axes.flat:
        for handle, word in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(word, handle)
    figure.legend(
        handles.values(), handles.keys(), loc="outside right upper", frameon=False, fontsize=9
    )
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)


def draw_final(
    path: Path, rows: list[dict[str, Any]], x: str, colors: dict[str, str], title: str
) -> None:
    """The final gap (or steps, where no optimum is known) against x, with intervals."""
    pyplot = _pyplot()
    import matplotlib

    gap = has_gap(rows)
    column, scale = ("optimality_gap", 100.0) if gap else ("mean_steps", 1.0)
    values = sorted({row["_x"] for row in rows}, key=_size)
    figure, axis = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
    side_by_side = len({(row["_x"], row["_group"]) for row in rows}) > len(values)
    for number, (name, color) in enumerate(colors.items()):
        shift = 0.09 * (number - (len(colors) - 1) / 2) * side_by_side
        places, means, lows, highs = [], [], [], []
        for place, value in enumerate(values):
            final = [
                scale * row[column] for row in rows if (row["_x"], row["_group"]) == (value, name)
            ]
            if final:
                low, high = bootstrap_interval(final)
                places.append(place + shift)
                means.append(float(np.mean(final)))
                lows.append(means[-1] - (means[-1] if np.isnan(low) else low))
                highs.append((means[-1] if np.isnan(high) else high) - means[-1])
                axis.plot([place + shift] * len(final), final, ".", color=color, alpha=0.35, ms=6)
        axis.errorbar(
            places,
            means,
            (lows, highs),
            color=color,
            fmt="o-",
            ms=4.5,
            lw=1.5,
            capsize=3,
            label=name,
        )
    axis.set_xticks(range(len(values)), [str(value) for value in values])
    axis.set_xlabel(x.replace("_", " "))
    axis.set_ylabel("gap to the optimum (%)" if gap else "episode length (steps)")
    if gap:
        axis.set_yscale("symlog", linthresh=1.0)
        axis.axhline(0, color="#333333", lw=1.2, ls=":")
        axis.yaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        finals = [100.0 * row["optimality_gap"] for row in rows]
        axis.set_ylim(1.6 * min(*finals, 0.0) - 0.2, 1.6 * max(*finals, 0.0) + 0.2)
    axis.set_title(title, fontsize=11, loc="left")
    if side_by_side:
        axis.legend(frameon=False, fontsize=9)
    _tidy(axis)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)
