"""Variants of an ablation against its control: the analyses "variants" and "paired", from rows.

"variants" compares single agents by their gaps to the optimum: the runs are the units, and those of
other tasks in [grid] are permuted within each. "paired" has mazes or games as random units: a
variant and the control are paired by unit after the mean over seeds; of one maze the runs are the
units. Self-play is compared by exact NashConv, single agents in small games by the return that a
best response has more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from itertools import combinations
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check
from train.experiments import figures
from train.experiments.measures import budget_note, evaluated_policies, note
from train.experiments.rows import GAPS, Content, StudyRows, by_variant
from train.experiments.runs import Study, TrainingRun
from train.experiments.statistics import (
    LEVEL,
    NAN,
    bounded,
    difference_interval,
    distance_interval,
    holm,
    least_p,
    least_sign_flip_p,
    logrank_p,
    mean_interval,
    permutation_p,
    probability_of_improvement,
    sign_flip_p,
)
from train.experiments.study import PAIRED, REPORTED_GAPS, Layout, StudyFile
from train.reports.tables import (
    Column,
    ResultTable,
    Row,
    in_markdown,
    numeric,
    three_digits,
    with_interval,
    words,
)
from train.runs.folder import METRICS, SELF_PLAY
from train.runs.worlds import contest_of
from train.self_play.parts import game_of_all
from train.settings.task import GAME, SmallGameSettings, TaskSettings

MOST_RUNS = 100
UNITS = ("seconds", "frames")
NEVER = float("inf")
MAZE = "maze"
SPENT = 0.8
"""Variants with a smaller share of frames on the hardest stage are marked."""
EQUAL = (
    *("seconds", "clock", "frames", "seed", "threads", "processes", "evaluate"),
    *(field.name for form in (TaskSettings, SmallGameSettings) for field in fields(form)),
)
"""Settings that all variants of an ablation share."""


@dataclass(frozen=True)
class Distance:
    """An exact distance to the equilibrium, or to a best response, by which runs are compared.

    Attributes:
        column: in the table of runs.
        name: in reports.
        scale: its unit.
        unit: what runs are paired by.
        note: what explains it in reports, of `notes.toml`.
        least: smaller values count as this one: ratios to 0 are not defined.
    """

    column: str
    name: str
    scale: str
    unit: str
    note: str
    least: float = 1e-3


NASH_CONV = Distance("played_nash_conv", "NashConv", "discounted steps", MAZE, "values")
GAME_NASH_CONV = Distance("played_nash_conv", "NashConv", "returns", GAME, "values")
GAME_REGRET = Distance("return_regret", "return regret", "returns", GAME, "regret")
MAZE_GAP = Distance("shortfall", "gap to the optimum", "per cent", MAZE, "gap", least=0.1)


def distance_of(study: StudyRows) -> Distance | None:
    """The distance of the analysis "paired", which is usual for self-play, small games and several
    mazes; None for "variants"."""
    rows = study.rows
    games = any(row.get("game") is not None for row in rows)
    if rows[0]["kind"] == SELF_PLAY:
        return GAME_NASH_CONV if games else NASH_CONV
    if games:
        return GAME_REGRET
    several = study.x == MAZE and len({row["_x"] for row in rows}) > 1
    paired = several if study.layout.analysis is None else study.layout.analysis == PAIRED
    return MAZE_GAP if paired else None


WIDEST = 1000.0
"""The largest ratio of the ends of an interval that is given; wider ones say nothing."""


def against_control(study: StudyRows) -> list[Row]:
    """A row for each variant: its results, its tests against the control, and the "verdict".

    Raises:
        ValueError: a run whose distance to the optimum or equilibrium is not known.
    """
    layout, variants = study.layout, by_variant(study)
    control = variants.get(str(layout.control), [])
    distance = distance_of(study)
    for row in study.rows if distance in (None, MAZE_GAP) else ():
        check(
            row["objective"] == "mean_steps",
            f"{row['run']}: scored by {row['objective']}, but an ablation needs the gap in steps; "
            "use a single runner, or a chase",
        )
        check(
            row.get("shortfall") is not None or row.get("optimality_gap") is None,
            f"{row['run']}: has no evaluations; restore its {METRICS} from a copy",
        )
        check(
            row.get("shortfall") is not None,
            f"{row['run']}: the exact optimum of its task is not known, but an ablation needs it; "
            "use a single runner, or one chaser against one evader",
        )
    if distance is not None:
        rows = [paired_row(name, own, control, distance) for name, own in variants.items()]
        add_corrected(rows, layout, {"p_holm": "p"})
        return [row | {"verdict": paired_verdict(row, layout, distance)} for row in rows]
    rows = [gap_row(name, own, control) for name, own in variants.items()]
    add_corrected(rows, layout, {"p_holm": "p", "p_time": f"p_to_{layout.threshold:g}"})
    return [row | {"verdict": gap_verdict(row, layout)} for row in rows]


def add_corrected(rows: list[Row], layout: Layout, names: dict[str, str]) -> None:
    """Add p corrected for the number of variants, except that of the primary one, under new names,
    and correct "least_p", the least p that so many runs can give.

    Args:
        rows: of all variants.
        layout: names the control and the primary variant.
        names: the columns of p by the new ones.
    """
    others = [row for row in rows if row["variant"] not in (layout.control, layout.primary)]
    for row in rows:
        row["least_p"] *= 1 if row["variant"] == layout.primary else len(others)
    for name, source in names.items():
        for row in rows:
            row[name] = NAN if row["variant"] == layout.control else row[source]
        for row, p in zip(others, holm([row[source] for row in others]), strict=True):
            row[name] = p


def by_task(rows: Sequence[Row], column: str, tasks: Iterable[str] = ()) -> list[list[float]]:
    """The values of a column for each task, sorted by task; by default of all tasks of the rows."""
    chosen = sorted(set(tasks) or {str(row["_x"]) for row in rows})
    own = [[row[column] for row in rows if str(row["_x"]) == task] for task in chosen]
    return [[NEVER if value is None else value for value in values] for values in own]


# -- gaps ------------------------------------------------------------------------------------------


def gap_row(name: str, own: list[Row], control: list[Row]) -> Row:
    """One variant as a flat row, with gaps in per cent, and `times_row`."""
    finals = by_task(own, "shortfall")
    row: Row = {"variant": name, "runs": len(own)}
    row |= bounded("gap", mean_of(finals), distance_interval(finals))
    row |= {"best": min(map(min, finals)), "worst": max(map(max, finals))}
    row["each_run"] = [value for task in finals for value in task]
    row |= times_row(own, REPORTED_GAPS)
    areas = by_task(own, "mean_optimality")
    row |= bounded("area", mean_of(areas), distance_interval(areas))
    row |= hardest_row(own)
    better, p, least, ends, apart = NAN, NAN, NAN, (NAN, NAN), (NAN, NAN)
    if {str(r["_x"]) for r in own} == {str(r["_x"]) for r in control}:
        theirs = by_task(control, "shortfall")
        better, ends = probability_of_improvement(finals, theirs)
        p = permutation_p(finals, theirs)
        least = least_p([(len(a), len(b)) for a, b in zip(finals, theirs, strict=True)])
        apart = difference_interval(finals, theirs, 1.0 - 2.0 * LEVEL)
    row |= bounded("improvement", better, ends)
    row |= {"least_p": least, "p": p, "apart_low": apart[0], "apart_high": apart[1]}
    tasks = {str(r["_x"]) for r in [*own, *control]}
    ended = by_task(own, "frames", tasks), by_task(control, "frames", tasks)
    for gap in REPORTED_GAPS:
        first, other = (by_task(r, f"frames_to_{gap:g}", tasks) for r in (own, control))
        row[f"p_to_{gap:g}"] = logrank_p(first, other, ended)
    return row


def hardest_row(rows: Sequence[Row]) -> Row:
    """The mean share of frames in the hardest stage of a curriculum, "hardest_share", NaN without
    one; "never_hardest": in how many runs it is 0."""
    shares = [row.get("hardest_share") for row in rows]
    known = [share for share in shares if share is not None]
    mean = float(np.mean(known)) if known and len(known) == len(shares) else NAN
    return {"hardest_share": mean, "never_hardest": known.count(0.0)}


def mean_of(tasks: Sequence[Sequence[float]]) -> float:
    """The mean over tasks of the mean of their runs."""
    return float(np.mean([np.mean(task) for task in tasks]))


def times_row(rows: Sequence[Row], gaps: Iterable[float] = GAPS, prefix: str = "") -> Row:
    """For each gap the number of runs that reached it, and medians of seconds and frames to it.

    A median is infinite unless more than half of the runs reached the gap.
    """
    row: Row = {}
    for gap in gaps:
        for unit in UNITS:
            values = [each.get(f"{prefix}{unit}_to_{gap:g}") for each in rows]
            times = [NEVER if value is None else value for value in values]
            row[f"reached_{gap:g}"] = sum(time < NEVER for time in times)
            row[f"{unit}_to_{gap:g}"] = float(median(times)) if times else NEVER
    return row


def gap_verdict(row: Row, layout: Layout) -> str:
    """The verdict on a variant against the control."""
    if row["variant"] == layout.control:
        return "control"
    p, margin = row["p_holm"], layout.margin
    if np.isnan(row["improvement_low"]):
        return "too few runs"
    note = f"p = {p_text(p)}" + (", primary" if row["variant"] == layout.primary else "")
    if p < LEVEL:
        return f"{'better' if row['improvement'] > 0.5 else 'worse'} ({note})"
    if margin is not None and -margin < row["apart_low"] <= row["apart_high"] < margin:
        return f"equal within {margin:g} points ({note})"
    return not_shown(row, note)


def not_shown(row: Row, note: str) -> str:
    """The verdict where p is not below `LEVEL`."""
    if row["least_p"] >= LEVEL:
        least = min(row["least_p"], 1.0)
        return f"p < {LEVEL:g} could not be reached, at best {least:.2g} ({note})"
    return f"no difference shown ({note})"


def p_text(p: float) -> str:
    """A p as text; empty for NaN."""
    return "" if np.isnan(p) else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def equal_results(study: StudyRows) -> list[tuple[str, str]]:
    """The pairs of variants with equal results in all evaluations of all runs."""

    def results(rows: list[Row]) -> list[tuple[object, ...]]:
        names = ("frames", "optimality_gap")
        return sorted(
            (str(row["_x"]), row["seed"], *(e.get(name) or 0 for name in names for e in curve))
            for row in rows
            for curve in [study.curves[row["run"]]]
        )

    found = {name: results(rows) for name, rows in by_variant(study).items()}
    return [(one, other) for one, other in combinations(found, 2) if found[one] == found[other]]


# -- variants that are paired by maze or game ------------------------------------------------------


def distances(rows: Iterable[Row], distance: Distance = NASH_CONV) -> dict[str, list[float]]:
    """The distances of the policies that runs play, by maze or game, sorted."""
    found: dict[str, list[float]] = {}
    for row in rows:
        value = row.get(distance.column)
        remedy = "use duels of at most 49 cells" if distance is NASH_CONV else "resume the run"
        check(value is not None, f"{row['run']}: no exact {distance.name}; {remedy}")
        found.setdefault(str(row["_x"]), []).append(max(float(value or 0), distance.least))
    return dict(sorted(found.items()))


def unit_means(mazes: dict[str, list[float]]) -> NDArray[np.float64]:
    """[units]: the mean over seeds of each maze; of one maze the value of each run."""
    if len(mazes) == 1:
        return np.array(next(iter(mazes.values())))
    return np.array([np.mean(runs) for runs in mazes.values()])


def paired_row(
    name: str, rows: Sequence[Row], control: Sequence[Row], distance: Distance = NASH_CONV
) -> Row:
    """One variant as a flat row; ratios are of geometric means, to the control."""
    own, other = distances(rows, distance), distances(control, distance)
    units = unit_means(own)
    logs = np.log(units)
    row: Row = {"variant": name, f"{distance.unit}s": len(own), "runs": len(rows)}
    row |= of_logs("distance", float(logs.mean()), mean_interval([logs.tolist()]))
    row |= {"worst": float(units.max()), "each_run": units.tolist()}
    ratio, ends, p, lower = NAN, (NAN, NAN), NAN, ""
    row["least_p"] = least_sign_flip_p(len(own))
    if rows is not control and list(own) == list(other):
        theirs = np.log(unit_means(other))
        if len(own) > 1:
            differences = logs - theirs
            ratio, ends = float(differences.mean()), mean_interval([differences.tolist()])
            p, lower = sign_flip_p(differences), f"{(differences < 0).sum()} of {len(own)}"
        else:
            sides = [logs.tolist()], [theirs.tolist()]
            row["least_p"] = least_p([(len(logs), len(theirs))])
            ratio = float(np.mean(logs) - np.mean(theirs))
            ends, p = difference_interval(*sides), permutation_p(*sides)
    row |= of_logs("ratio", ratio, ends)
    return row | hardest_row(rows) | {"lower_in": lower, "p": p}


def of_logs(name: str, mean: float, ends: tuple[float, float]) -> Row:
    """As `bounded`, of a geometric mean; without an interval that spans more than `WIDEST`."""
    low, high = ends if ends[1] - ends[0] <= np.log(WIDEST) else (NAN, NAN)
    return bounded(name, float(np.exp(mean)), (float(np.exp(low)), float(np.exp(high))))


def paired_verdict(row: Row, layout: Layout, distance: Distance = NASH_CONV) -> str:
    """The verdict on a variant against the control, paired by maze or game."""
    if row["variant"] == layout.control:
        return "control"
    if np.isnan(row["p_holm"]):
        return f"not compared: other {distance.unit}s than the control"
    note = f"p = {row['p_holm']:.3g}" + ", primary" * (row["variant"] == layout.primary)
    if row["p_holm"] < LEVEL:
        return f"{'lower' if row['ratio'] < 1.0 else 'higher'} {distance.name} ({note})"
    return not_shown(row, note)


def undecidable(rows: Sequence[Row]) -> str:
    """A note on the variants whose p could not be below `LEVEL`; empty if there are none."""
    names = [row["variant"] for row in rows if row["p_holm"] >= LEVEL <= row["least_p"]]
    text = f"Too few runs for p < {LEVEL:g} after the correction: {', '.join(names)}"
    return text if names else ""


# -- tables and figures ----------------------------------------------------------------------------


def variant_columns(layout: Layout) -> list[Column]:
    """The columns of variants that are compared by gaps."""
    control = layout.control
    better = with_interval(f"P(better than {control}) [95 %]", "improvement")
    return [
        words("variant"),
        words("verdict"),
        numeric("runs", "runs"),
        with_interval("final gap, mean, % [95 %]", "gap"),
        EXTREMES,
        *time_columns(REPORTED_GAPS),
        Column(f"log-rank p, to {layout.threshold:g} %", lambda row: p_text(row["p_time"])),
        with_interval("optimality over training [95 %]", "area"),
        HARDEST,
        Column(better.head, lambda row: "" if row["variant"] == control else better.cell(row)),
    ]


def time_columns(gaps: Sequence[float]) -> list[Column]:
    """For each gap the medians of seconds and frames to it, and how many runs reached it."""

    def cell(gap: float, row: Row) -> str:
        reached, runs = row[f"reached_{gap:g}"], row["runs"]
        seconds, frames = row[f"seconds_to_{gap:g}"], row[f"frames_to_{gap:g}"]
        if not np.isfinite(seconds):
            return f"median not reached ({reached} of {runs})"
        scale, unit = (1e6, "M") if frames >= 1e6 else (1e3, "k")
        digits = three_digits(seconds), three_digits(frames / scale)
        return f"{digits[0]}, {digits[1]} {unit} ({reached} of {runs})"

    return [Column(f"to {g:g} %: seconds, frames (runs)", partial(cell, g)) for g in gaps]


EXTREMES = Column(
    "best to worst", lambda row: f"{three_digits(row['best'])} to {three_digits(row['worst'])}"
)


def _hardest(row: Row) -> str:
    share = row["hardest_share"]
    if np.isnan(share):
        return ""
    text = f"{100 * share:.0f} %" + ("" if share >= SPENT else f", below {100 * SPENT:.0f} %")
    never = row["never_hardest"]
    return text + (f"; none in {never} of {row['runs']} runs" if never else "")


HARDEST = Column("frames on the hardest stage", _hardest)


def paired_columns(layout: Layout, distance: Distance) -> list[Column]:
    """The columns of variants that are paired by maze or game."""
    hardest = [HARDEST] if distance is MAZE_GAP else []
    return [
        words("variant"),
        words("verdict"),
        numeric("runs", "runs"),
        numeric(f"{distance.name}, geometric mean", "distance", ".3f"),
        numeric("worst", "worst", ".3f"),
        with_interval(f"ratio to {layout.control} [95 %]", "ratio", ".2f"),
        words(f"{distance.unit}s below {layout.control}", "lower_in"),
        *hardest,
    ]


def variant_notes(study: StudyRows) -> list[str]:
    """The explanation of the table of variants that are compared by gaps."""
    layout, kinds = study.layout, evaluated_policies(study.rows)
    pairs = [in_markdown(f"Variants {one} and {other}") for one, other in equal_results(study)]
    lines = [
        *(note("gaps.equal", pair=pair) for pair in pairs),
        budget_note(study),
        note("gaps.verdict", level=LEVEL),
        note("gaps.times", kinds=kinds, cut=note("gaps.cut")),
        note("gaps.hardest", spent=100 * SPENT),
    ]
    pair = in_markdown(f"{layout.primary} against {layout.control}")
    primary = "gaps.no_primary" if layout.primary is None else "gaps.primary"
    lines.append(note(primary, pair=pair))
    return lines + ([note("gaps.margin", margin=layout.margin)] if layout.margin else [])


def paired_notes(study: StudyRows, table: Sequence[Row], distance: Distance) -> list[str]:
    """The explanation of the table of variants that are paired by maze or game."""
    unit = distance.unit
    units = "mazes" if max(row[f"{unit}s"] for row in table) > 1 else "runs"
    named = {"unit": unit, "units": f"{unit}s".capitalize(), "level": LEVEL}
    values = note(f"paired.{distance.note}", least=distance.least, scale=distance.scale)
    hardest = [note("gaps.hardest", spent=100 * SPENT)] if distance is MAZE_GAP else []
    return [budget_note(study), note(f"paired.{units}", **named), values, *hardest]


def variants_content(study: StudyRows, folder: Path, how: figures.Drawing) -> Content:
    """The report of an ablation of single agents, with the runs as units."""
    rows = against_control(study)
    panels = {
        "final gap to the optimum (%)": ("gap", "gap", "each_run"),
        f"P(better than {study.layout.control})": ("share", "improvement", ""),
    }
    figures.draw_final(folder / "final.png", study, rows, "variant", panels, how, undecidable(rows))
    names = ["final.png", *figures.draw_stages(folder, study, how)]
    return ResultTable(rows, variant_columns(study.layout)), variant_notes(study), names


def paired_content(study: StudyRows, folder: Path, how: figures.Drawing) -> Content:
    """The report of an ablation by maze or game, without curves over training time."""
    rows, distance = against_control(study), distance_of(study)
    assert distance is not None
    panels = {f"{distance.name} ({distance.scale})": ("log", "distance", "each_run")}
    figures.draw_final(folder / "final.png", study, rows, "variant", panels, how, undecidable(rows))
    table = ResultTable(rows, paired_columns(study.layout, distance))
    return table, paired_notes(study, rows, distance), ["final.png"]


# -- what a study must have ------------------------------------------------------------------------


def check_ablation(file: StudyFile) -> None:
    """ValueError unless the variants can be compared with the control: an equal budget and task.

    Without a curriculum in [settings] variants have none unless they name one.
    """
    variants, control, primary = file.variants or [], file.control, file.primary
    check(len(variants) > 1, "give at least two [[variants]], with names")
    names = [variant.get("name") for variant in variants]
    check(control in names, f"control={control!r} is not a variant; give one of {names}")
    others = [name for name in names if name != control]
    check(
        primary in (None, *others),
        f"primary={primary!r} is not a variant other than the control; give one of {others}",
    )
    check(
        file.margin is None or file.margin > 0,
        f"margin={file.margin}; give points of the gap, above 0",
    )
    check(
        file.threshold in REPORTED_GAPS,
        f"threshold={file.threshold:g}; give one of the gaps {REPORTED_GAPS} in %",
    )
    for variant in variants:
        own = sorted(set(EQUAL) & set(variant))
        check(
            not own,
            f"variant {variant.get('name')!r} sets {', '.join(own)}; all variants have the same "
            "budget, task and seeds, so set it in [settings]",
        )
        if file.kind != SELF_PLAY and "curriculum" not in file.settings:
            variant.setdefault("curriculum", "none")
    grid, hints = list(file.grid), file.report
    check(
        hints is None or hints.group is None,
        "group in [report]: an ablation draws one curve per variant; leave it out",
    )
    x = None if hints is None else hints.x
    check(x in (None, *grid), f"x={x!r} in [report] is not in [grid]; give one of {grid}")
    check(
        len(grid) <= 1 and (x is not None or not grid),
        f"[grid] {grid} and x={x!r} in [report]; give at most one setting in [grid], and name it "
        "as x in [report]: variants are compared for each of its values",
    )


def check_measures(file: StudyFile, runs: Sequence[TrainingRun]) -> None:
    """ValueError for runs whose distance to the exact optimum or equilibrium is not known."""
    tasks = dict.fromkeys(run.settings.task for run in runs)
    games = any(task.game is not None for task in tasks)
    if file.kind == SELF_PLAY or games:
        where, unit = ("games in returns", "game") if games else ("self-play", "maze")
        what = "gaps in steps" if games else "single-agent runs"
        for name in ("primary", "margin"):
            value = getattr(file, name)
            check(value is None, f"{name}={value!r} is for {what}; leave it out")
        x = file.report.x if file.report else None
        check(x in (None, unit), f"x={x!r} in [report]; in {where} give [grid] {unit} = [...]")
        for task in tasks:
            why = game_of_all(task).why_not_always()
            check(
                why is None,
                f"task {task.task!r} with these agents has no exact NashConv for every run: {why}",
            )
        return
    check(
        file.margin is None or len({run.label.get("maze") for run in runs}) == 1,
        f"margin={file.margin} is for runs in one maze; leave it out, as mazes are paired",
    )
    for task in tasks:
        contest = contest_of(task, 2)
        check(
            contest.optimal() is not None,
            f"the exact optimum of task {task.task!r} with these agents is not known, but an "
            "ablation needs it; use a single runner, one chaser against one evader, or a smaller "
            "game without goals for evaders",
        )
        check(
            contest.measure.by_steps,
            f"task {task.task!r} is scored by {contest.measure.name}, but an ablation needs the "
            "gap in steps; use a single runner, or a chase",
        )


# -- beforehand ------------------------------------------------------------------------------------


def out_of_reach(study: Study) -> list[str]:
    """A line for the variants (or libraries) whose corrected p cannot be below LEVEL; [] if none.

    Holm's correction multiplies the smallest of m values by m.
    """
    layout, runs = study.layout, study.runs
    seeds = len({run.seed for run in runs})
    if layout.control is None:
        least = least_p([(seeds, seeds)])
        line = f"p < {LEVEL:g} cannot be reached: with {seeds} seeds the least p is {least:.2g}"
        return [line] if study.pinned and least >= LEVEL else []
    tasks = len({run.label.get(str(layout.x)) for run in runs})
    games = layout.x == GAME
    by_maze = layout.analysis == PAIRED and tasks > 1
    corrected = [v for v in layout.variants if v not in (layout.control, layout.primary)]
    unit, now = ("games" if games else "mazes", tasks) if by_maze else ("seeds", seeds)

    def least_of(count: int) -> float:
        return least_sign_flip_p(count) if by_maze else least_p([(count, count)] * tasks)

    lines = []
    for names in (corrected, [layout.primary] if layout.primary is not None else []):
        p, counts = least_of(now) * len(names), range(now, MOST_RUNS)
        if names and p >= LEVEL:
            enough = next((n for n in counts if least_of(n) * len(names) < LEVEL), None)
            remedy = f"{enough} {unit} or more" if enough else "fewer variants"
            lines.append(
                f"{', '.join(names)}: p < {LEVEL:g} cannot be reached: with {now} {unit} the least "
                f"p is {least_of(now):.2g}, corrected for {len(names)} comparisons "
                f"{min(p, 1.0):.2g}; give {remedy}"
            )
    return lines
