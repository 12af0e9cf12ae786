"""The results of runs as flat rows: one for each run, and one for each evaluation.

The row of a run has everything that tables and tests need: its settings, its final measures with
their references, what its learning curve says (times to gaps, means over training), versions and
machine. Reports are made of rows alone; only figures read the evaluations.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import fmean

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check
from train.experiments.recorded import FIRST, MEASURED, read_recorded, varied_settings
from train.experiments.runs import ERROR, FORMAT, LABEL, LAYOUT, read_label, read_layout, status_of
from train.experiments.shards import row_files
from train.experiments.statistics import first_below, mean_over
from train.experiments.study import Layout, Table
from train.files import write_bytes, write_csv
from train.kinds import read_settings
from train.reports.tables import ResultTable, Row
from train.runs.folder import (
    CONFIG,
    METRICS,
    RESULTS,
    RUN,
    SELF_PLAY,
    load_results,
    read_config,
    read_metrics,
)
from train.runs.provenance import check_sources, recorded_parts
from train.self_play.names import entry_names
from train.settings.mazes import maze_or_suite
from train.settings.self_play import LEARN, OPPOSING_ROLES
from train.settings.task import learning_agent

SCORE_COLUMNS = {
    "random": "random_steps",
    "learned": "greedy_steps",
    "learned, sampled": "sampled_steps",
}
"""Columns of the mean steps of these scores."""
RUNS, CURVES, RUNS_CSV = "results.csv", "curves.csv", "runs.csv"
OF_GAMES = ("payoff_range", "mixed_share")
"""Entries of the results of small games."""
GAPS = (20.0, 10.0, 5.0, 2.0, 1.0)
"""Per cent; a row has the time of the first evaluation within each of these gaps."""
GAP_COLUMNS = {"": "optimality_gap", "greedy_": "greedy", "sampled_": "sampled"}
"""Prefixes of these times by the column of the gap; the last two are those of libraries."""

Content = tuple[ResultTable, list[str], list[str]]
"""What an analysis gives: the table of the report, sentences and further tables as Markdown, and
the names of figures."""


@dataclass
class StudyRows:
    """The rows of a study, or of several folders.

    Attributes:
        layout: of the report.
        rows: of the complete runs. "_group" is the label of the curve, "_x" the value on the axis.
        everything: rows of all runs.
        x: the column on the axis; None for none.
        varying: the columns of the settings that distinguish the runs.
        measures: the columns that are results.
        curves: the evaluations of each run.
    """

    layout: Layout
    rows: list[Row] = field(default_factory=list)
    everything: list[Row] = field(default_factory=list)
    x: str | None = None
    varying: list[str] = field(default_factory=list)
    measures: list[str] = field(default_factory=list)
    curves: dict[str, list[Row]] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write `runs.csv`: every run with the settings that vary, its budget, and all measures."""
        place = "game" if any(row.get("game") for row in self.everything) else "maze"
        names = ["run", "status", *self.varying, "seed", place, "budget_seconds", "budget_frames"]
        names = list(dict.fromkeys([*names, *self.measures]))
        rows = [{name: row.get(name) for name in names} for row in self.everything]
        write_csv(folder / RUNS_CSV, rows, names)


def write_table(path: Path, rows: list[Row]) -> None:
    """Write `rows` as a .csv file and, where PyArrow is installed, beside it as a .parquet file, in
    which a column of numbers and texts is one of texts.

    Each is written atomically; OSError naming the file if that fails.
    """
    write_csv(path, rows)
    beside = path.with_suffix(".parquet")
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        beside.unlink(missing_ok=True)  # of earlier rows, written elsewhere
        return
    columns = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        try:
            columns[name] = pyarrow.array(values)
        except pyarrow.ArrowException:  # of several types
            columns[name] = pyarrow.array([None if v is None else str(v) for v in values])
    data = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), data)
    write_bytes(beside, data.getvalue())


def read_all(out: Path) -> StudyRows:
    """All runs of a study, complete or not, with their evaluations.

    Raises:
        ValueError: no study in this folder, or a run of an incompatible version.
    """
    layout = read_layout(out)
    check(
        layout.format <= FORMAT,
        f"{out / LAYOUT}: has format {layout.format}, this version of pursuit reads 1 to {FORMAT}; "
        "use the version that wrote it",
    )
    folders = sorted(path.parent for path in out.glob(f"runs/*/{CONFIG}"))
    if layout.runs is not None:  # leave out runs of an earlier version of the file
        folders = [folder for folder in folders if folder.name in layout.runs]
    here, known = {folder.name for folder in folders}, list[Row]()
    if layout.rows is not None and layout.runs is not None:
        path = out.resolve() / layout.rows
        path = path if row_files(path) else Path(layout.rows)  # so before version 0.2.0
        check(
            bool(row_files(path)) or here >= set(layout.runs),
            f"{out}: the file with its finished runs, {out / layout.rows}, is missing; put it back",
        )
        of_file = read_recorded(path, layout.planned)
        elsewhere = {name for name, row in of_file.items() if row["status"] == "complete"}
        folders = [f for f in folders if f.name not in elsewhere or status_of(f) == "complete"]
        here = {folder.name for folder in folders}
        known = [of_file[n] for n in layout.runs if n in of_file and n not in here]
    check(
        bool(folders or known),
        f"{out}: no runs of a sweep; run `pursuit sweep FILE --out {out}` first",
    )
    found = StudyRows(layout)
    labels = [read_label(folder) for folder in folders]
    for folder in folders:
        row, measures, found.curves[folder.name] = read_run(folder)
        found.everything.append(row)
        found.measures += [name for name in measures if name not in found.measures]
    names = dict.fromkeys(MEASURED.get(name, name) for label in labels for name in label)
    for row in known:
        found.everything.append(row)
        found.curves[str(row["run"])] = []
        names |= dict.fromkeys(varied_settings([*row]))
        rest = [*row][[*row].index("seed") + 1 :]
        found.measures += [name for name in rest if name not in found.measures]
    found.everything.sort(key=lambda row: str(row["run"]))
    found.varying = [name for name in names if name != "variant"]
    if "variant" in names:
        found.varying.insert(0, "variant")
    columns = dict.fromkeys(name for row in found.everything for name in row)
    found.everything = [{name: row.get(name) for name in columns} for row in found.everything]
    found.rows = [row for row in found.everything if row["status"] == "complete"]
    return found


def read_study(out: Path) -> StudyRows:
    """The runs in a folder, with the tables `RUNS` and `CURVES` written; ValueError if none is
    complete."""
    found = read_all(out)
    write_table(out / RUNS, found.everything)
    evaluations = [{"run": run, **row} for run, rows in found.curves.items() for row in rows]
    write_table(out / CURVES, evaluations)
    check(
        bool(found.rows), f"{out}: no run is complete; repeat the command of the study to continue"
    )
    columns, layout = found.rows[0], found.layout
    found.x = layout.x if layout.x in columns else None
    group = [name for name in layout.group if name in columns]
    for row in found.rows:
        check(
            not layout.variants or row["variant"] is not None,
            f"{out / 'runs' / row['run'] / LABEL}: names no variant; restore it from a copy",
        )
        usual = ["algorithm"] if row["kind"] == RUN else ["kind"]
        row["_group"] = ", ".join(in_words(name, row[name]) for name in group or usual)
        row["_x"] = row[found.x] if found.x else ""
    return found


def in_words(name: str, value: object) -> str:
    """The value of a setting as text, with its name if it is a boolean or a number."""
    if isinstance(value, bool):
        return name if value else f"no {name}"
    return f"{name} {value:g}" if isinstance(value, int | float) else str(value)


def read_several(folders: Sequence[Path], chosen: Sequence[str] = ()) -> StudyRows:
    """Runs, sweeps and ablations as one study, with a group per run and per setting of a sweep;
    `chosen` are names of the folders.

    Raises:
        ValueError: a folder without results, runs with different objectives, or names as those of
            `entry_names`.
    """
    names = entry_names([str(folder) for folder in folders], lambda entry: False, chosen)
    whole = StudyRows(Layout(", ".join(names)), varying=["_group"])
    for name, folder in zip(names, folders, strict=True):
        single = (folder / CONFIG).exists()
        if single:
            row, measures, curve = read_run(folder)
            study = StudyRows(Layout(name), measures=measures, curves={folder.name: curve})
            study.rows = [row | {"_group": name, "_x": ""}]
        else:
            study = read_study(folder)
        if variants := study.layout.variants:
            study.rows.sort(key=lambda row: variants.index(row["variant"]))
        for row in study.rows:
            run = str(folder if single else folder / row["run"])
            group = row["variant"] if variants else row["_group"]
            group += f", {in_words(str(study.x), row['_x'])}" if study.x else ""
            if len(folders) > 1 and not single:
                group = f"{name}: {group}"
            whole.curves[run] = study.curves.get(row["run"], [])
            whole.rows.append(row | {"run": run, "_group": group, "_x": ""})
        whole.measures += [name for name in study.measures if name not in whole.measures]
    objectives = sorted({str(row["objective"]) for row in whole.rows})
    check(
        len(objectives) == 1,
        f"these runs have different objectives ({' and '.join(objectives)}); give runs "
        "with the same objective",
    )
    whole.everything = whole.rows
    return whole


def by_variant(study: StudyRows) -> dict[str, list[Row]]:
    """The complete runs of every variant that has some, in the order of the file, by seed."""
    layout = study.layout
    check(layout.x == study.x, f"{LAYOUT}: from another ablation; run `pursuit ablate` again")
    found: dict[str, list[Row]] = {name: [] for name in layout.variants}
    for row in sorted(study.rows, key=lambda row: int(row["seed"])):
        found.setdefault(row["variant"], []).append(row)
    return {name: rows for name, rows in found.items() if rows}


# -- one run ---------------------------------------------------------------------------------------


def read_run(folder: Path) -> tuple[Row, list[str], list[Row]]:
    """One run as a flat row: "run", "kind", "status", all settings and its results; the names of
    the results, and the evaluations.

    Results are "frames", "seconds", the evaluation ("mean_steps", "optimality_gap", ...),
    "random_steps", "scripted_steps", "greedy_steps" and "sampled_steps", of a team "members_gap"
    (the mean gap of its members, each with the others fixed), of self-play "nash_conv_last" and so
    on (`snapshot_nash_convs`), "mixture_low" and "mixture_high", `OF_GAMES`, `curve_measures`,
    versions, "commit", "machine" and "error".
    """
    settings = settings_row(folder)
    evaluations: list[Row] = [*read_metrics(folder)] if (folder / METRICS).exists() else []
    results: Row = {}
    if (folder / RESULTS).exists():
        content = load_results(folder)
        if "game" in content:  # also of a kind of one's own
            settings.setdefault("game", content["game"])
        results |= {n: content[n] for n in ("frames", "seconds", "frames_per_second")}
        results |= content["evaluation"]
        results |= {f"{name}_at_start": value for name, value in content["at_start"].items()}
        results |= {name: content[name] for name in OF_GAMES if name in content}
        convs = content.get("nash_conv_of", {})
        results |= {f"nash_conv_{name}": value for name, value in convs.items()}
        for end, value in zip(("low", "high"), content.get("mixture_nash_conv", ()), strict=False):
            results[f"mixture_{end}"] = value
        column = content["objective"]["column"]
        for score in content["scores"]:
            if score["name"] in SCORE_COLUMNS:
                results[SCORE_COLUMNS[score["name"]]] = score["mean_steps"]
            elif not score["name"].startswith(("learned", "optimal")):
                results |= {"scripted": score["name"], "scripted_steps": score["mean_steps"]}
            name = {"random": "random", results.get("scripted"): "scripted"}.get(score["name"])
            if name is not None and column not in ("mean_steps", "nash_conv") and column in score:
                results[f"{name}_{column.removeprefix('mean_')}"] = score[column]
        members = [own["gap"] for own in content.get("team", {}).get("members", {}).values()]
        results |= {"members_gap": fmean(members)} if members else {}
        results |= {"objective": column, "unit": content["objective"]["unit"]}
        results["format"] = content["format"]
        results |= curve_measures(settings | results, evaluations)
        results |= {f"{name}_version": value for name, value in content["versions"].items()}
        results["commit"] = results.pop("commit_version", None)
        results["machine"] = content["machine"]["processor"]
    elif evaluations:
        results |= evaluations[-1]
    results["error"] = error_of(folder)
    return settings | results, [*results], evaluations


def recorded_row(folder: Path) -> Row:
    """The row of a run for a file of rows: the settings that vary and the results, but no columns
    of single players."""
    row, measures, evaluations = read_run(folder)
    sides = tuple(f"{role}_" for role in read_config(folder)[1].get("players") or OPPOSING_ROLES)
    of_sides = [n for n in measures if n.startswith(sides) or f"_{n}".endswith("_at_start")]
    label = [MEASURED.get(name, name) for name in read_label(folder)]
    place = [name for name in ("maze", "game") if row.get(name) is not None]
    rest = [*place, "budget_seconds", "budget_frames", *measures]
    names = [*FIRST, *label, "seed", *(n for n in rest if n not in (*label, *of_sides))]
    found = {name: row.get(name) for name in dict.fromkeys(names)}
    if column := {"nash_conv", "optimality_gap"} & {*found}:
        curve = column_of(evaluations, column.pop())
        found["curve"] = " ".join(f"{value:.5g}" for value in curve)
    return found


def flat_plain(nested: Table) -> Table:
    """Plain settings by name as a flat dictionary; budgets are renamed by `MEASURED`.

    What differs between the sides of self-play is chaser.NAME and evader.NAME, in a small game
    PLAYER.NAME.
    """
    plain = dict(nested)
    flat = {"variant": None, "kind": None} | plain.pop("task")
    for name in ("hyper", "curriculum_settings"):
        plain |= {k: v for k, v in (plain.pop(name, None) or {}).items() if k not in plain}
    plain |= plain.pop("players", {})
    sides = {
        role: {"algorithm": plain[role]["algorithm"], **plain[role]["hyper"]}
        for role in (nested.get("players") or OPPOSING_ROLES)
        if isinstance(plain.get(role), Mapping)
    }
    for role, own in sides.items():
        plain[role] = LEARN
        for name, value in own.items():
            same = all(name in side and side[name] == value for side in sides.values())
            plain[name if same else f"{role}.{name}"] = value
    flat |= plain
    return {MEASURED.get(name, name): value for name, value in flat.items()}


def settings_row(folder: Path) -> Row:
    """The settings of one run, with values and file names as the study file gives them."""
    kind, plain = read_config(folder)
    check_sources(folder / CONFIG, plain)
    # User-defined parts are not imported to read their settings.
    if not recorded_parts(folder / CONFIG):
        kind, settings = read_settings(folder)
        plain = asdict(settings)
    task, label = plain["task"], read_label(folder)
    row: Row = {"run": folder.name, "kind": kind, "status": status_of(folder)}
    row |= {name: value for name, value in flat_plain(plain).items() if name not in row}
    row["variant"] = label.get("variant")
    if "maze" in task:
        found = maze_or_suite(task["maze"])  # or the name of a suite
        row["maze"] = found if isinstance(found, str) else found.name
        one = kind != SELF_PLAY
        row["role"] = learning_agent(task["task"], task["role"]) if one else "both"
    if "members" in row:
        row["members"] = " ".join(row["members"])
    # Labels also have settings such as `preset`, by which reports can group.
    files = ("maze", "curriculum_mazes", "opponent", *(plain.get("players") or OPPOSING_ROLES))
    varying = {MEASURED.get(name, name): value for name, value in label.items()}
    return row | {n: value for n, value in varying.items() if n not in row or n in files}


def curve_measures(row: Row, evaluations: Sequence[Row]) -> Row:
    """What the learning curve of a complete run says.

    Returns:
        "shortfall": per cent by which the final policy is worse than the exact optimum: more steps,
        or fewer for an evader. "seconds_to_5", "frames_to_5", ...: at the first evaluation with a
        shortfall of at most 5 %; None if there is none. "mean_optimality": optimum / steps, or for
        an evader steps / optimum, averaged over the frames of training. "hardest_share": of the
        frames in the hardest stage of a curriculum. "last_fall": by how many steps episode lengths
        fall in the last third of the evaluations (means of its halves). "last_share": the share of
        the fall from the first to the last evaluation that is in this third. Without what it needs,
        a measure is None.
    """
    evader = longer_is_better(row)
    sign = -100.0 if evader else 100.0
    seconds, frames = column_of(evaluations, "seconds"), column_of(evaluations, "frames")
    names = ("shortfall", "mean_optimality", "hardest_share", "last_fall", "last_share")
    found: Row = dict.fromkeys(names)
    gap, known = column_of(evaluations, "optimality_gap"), row.get("optimality_gap") is not None
    if known and len(evaluations):
        found["shortfall"] = sign * float(row["optimality_gap"])
        optimality = 1.0 + gap if evader else 1.0 / (1.0 + gap)
        found["mean_optimality"] = mean_over(frames, optimality)
    for prefix, name in GAP_COLUMNS.items():
        values = sign * column_of(evaluations, name)
        for threshold in GAPS if known and not np.isnan(values).all() else ():
            for unit, times in (("seconds", seconds), ("frames", frames)):
                first = first_below(times, values, threshold)
                found[f"{prefix}{unit}_to_{threshold:g}"] = first if np.isfinite(first) else None
    hardest = column_of(evaluations, "on_hardest")
    told = np.isfinite(hardest)
    if told.any():
        spent = np.diff(frames, prepend=0.0)
        found["hardest_share"] = float(np.average(hardest[told], weights=spent[told]))
    lengths = column_of(evaluations, "mean_steps")
    last = lengths[-max(len(lengths) // 3, 2) :]
    if len(last) >= 2:
        half = len(last) // 2
        found["last_fall"] = float(last[:half].mean() - last[half:].mean())
        if len(last) < len(lengths) and lengths[0] != lengths[-1]:
            before = lengths[-len(last) - 1]
            found["last_share"] = float((before - lengths[-1]) / (lengths[0] - lengths[-1]))
    return found


def column_of(evaluations: Sequence[Row], name: str) -> NDArray[np.float64]:
    """[evaluations] a column; NaN for missing values."""
    return np.array([row.get(name) for row in evaluations], dtype=np.float64)


def longer_is_better(row: Row) -> bool:
    """Whether more steps are better: for "evader" or a single one ("evader_0"), without goals."""
    return str(row.get("role")).startswith("evader") and row.get("num_goals") in (None, 0)


def error_of(folder: Path) -> str | None:
    """The first line of `error.txt`; None if there is none."""
    path = folder / ERROR
    if not path.is_file():
        return None
    return next(iter(path.read_text(encoding="utf-8", errors="replace").splitlines()), "unknown")
