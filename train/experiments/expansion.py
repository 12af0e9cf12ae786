"""The expansion of study files to runs: grids, variants, random search and seeds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace

from pursuit.validation import check, one_of
from train.experiments.identity import fingerprint, frozen_mazes, inputs_of
from train.experiments.library_runs import LIBRARY_RUN
from train.experiments.recorded import MEASURED
from train.experiments.rows import flat_plain
from train.experiments.runs import Study, TrainingRun, job_name
from train.experiments.search import draw_samples
from train.experiments.study import (
    ANALYSES,
    LIBRARIES,
    PAIRED,
    SUMMARY,
    VARIANTS,
    Layout,
    ReportHints,
    StudyFile,
    Table,
    check_table,
    choose_version,
    content_of,
    read_file,
)
from train.experiments.variants import MAZE, check_ablation, check_measures
from train.kinds import KINDS
from train.runs.folder import RUN, SELF_PLAY
from train.runs.forms import Final
from train.self_play.names import check_name
from train.settings.checks import check_seed

MAX_RUNS = 100_000
"""Maximum number of runs of a study, to catch typing errors."""
NO_SETTINGS = ("name", "trial", "rung")
"""Names in labels that are no settings."""

StudyChange = Callable[[StudyFile], StudyFile]
"""Modifies the contents of a study file."""
Tuned = Mapping[tuple[str, str], Table]
"""Settings found by a search, by algorithm or library ("" for any), and by variant ("" for
all)."""


def load_study(
    name: str,
    kind: str = "sweep",
    version: str | None = None,
    change: StudyChange = lambda file: file,
    tuned: Tuned | None = None,
) -> Study:
    """Read a study file and expand it, without running it.

    Args:
        name: the path of a file, or the name of a shipped one.
        kind: "sweep", "ablation" or "comparison".
        version: "short" or "full" of a file that has both; short by default.
        change: modifies the contents of the file.
        tuned: the settings that a search has found.

    Raises:
        ValueError: no such file, invalid TOML, an unknown key, a value of a wrong type, an empty
            list, a version that the file does not have, or a combination that cannot run.
    """
    path, file = read_file(name, kind, StudyFile)
    with content_of(path):
        file = change(choose_version(file, version))
        check_kind(file, kind)
        return multiply_out(file, path.stem, tuned or {})


def check_kind(file: StudyFile, kind: str) -> None:
    """ValueError unless a file is a study of a kind, as in `load_study`."""
    one_of("kind", file.kind or RUN, KINDS)
    compared = file.kind == LIBRARY_RUN
    check(not compared or kind == "comparison", f"kind={file.kind!r}; run it by `pursuit compare`")
    check(
        compared or kind != "comparison",
        f"kind={file.kind!r}; give kind = 'contestant' in a comparison, or use another command",
    )
    check(
        kind != "ablation" or file.control is not None,
        "control=None is not a variant; give one of "
        f"{[variant.get('name') for variant in file.variants or ()]}",
    )
    check(
        file.tuning is None or kind != "sweep",
        "[tuning] is for ablations, comparisons and replications; leave it out",
    )


def multiply_out(file: StudyFile, stem: str, tuned: Tuned) -> Study:
    """All combinations as validated settings."""
    kind = file.kind or RUN
    one_of("kind", kind, KINDS)
    if file.control is not None:
        check_ablation(file)
    common, grid = file.settings, file.grid
    variants, seeds = file.variants, [0] if file.seeds is None else file.seeds
    check_table(common, "[settings]")
    check_table(grid, "[grid]", values=True)
    check(bool(seeds), "seeds is an empty list; give at least one value")
    for seed in seeds:
        check_seed(seed)
    check_variants(variants)
    mazes = grid.get("maze", [])
    check(
        not file.paired or len(mazes) == len(seeds),
        f"paired=true with {len(mazes)} mazes in [grid] and {len(seeds)} seeds; give one seed for "
        "each maze",
    )
    count = math.prod(map(len, grid.values())) * len(variants or [{}]) * len(seeds)
    check(count <= MAX_RUNS, f"{count:,} runs; give values for at most {MAX_RUNS:,}")
    drawn = draw_samples(file.search, MAX_RUNS // count)
    sources = [grid, drawn[0], {name: 0 for variant in variants or () for name in variant}]
    for one, two in itertools.combinations(sources, 2):
        for name in one.keys() & two.keys():
            raise ValueError(f"{name!r} is set by two of grid, search and variants; set it in one")
    check(bool(common or grid or variants), "nothing to do; give [settings] and [grid]")
    final = Final() if file.episodes is None else Final(file.episodes)
    runs: dict[str, TrainingRun] = {}
    for chosen in itertools.product(*(range(len(values)) for values in grid.values())):
        place = dict(zip(grid, chosen, strict=True))
        values = {name: grid[name][number] for name, number in place.items()}
        own_seeds = [seeds[place["maze"]]] if file.paired else seeds
        for variant, sample in itertools.product(variants or [{}], drawn):
            label = values | variant | sample
            of = {**common, **label}.get("contestant" if kind == LIBRARY_RUN else "algorithm")
            name = label.get("name", "")
            keys = ((str(of), name), (str(of), ""), ("", name))
            found = next((tuned[key] for key in keys if key in tuned), {})
            own = {**common, **found}
            for run in runs_of(kind, own, label, own_seeds, final.episodes):
                same = runs.setdefault(run.name.rsplit("-", 1)[1], run)
                check(  # equal combinations run once
                    same.label == run.label,
                    f"{run_label(same.label)} and {run_label(run.label)} have equal "
                    "settings; change one of them, or leave it out",
                )
    # Seeds are the outer loop, so that changes of the machine's speed affect all settings.
    ordered = alternating(sorted(runs.values(), key=lambda run: seeds.index(run.seed)))
    if file.control is not None:
        check_measures(file, ordered)
    return Study(layout_of(file, stem, ordered, [*grid, *drawn[0]]), ordered, kind == LIBRARY_RUN)


def alternating(runs: Sequence[TrainingRun]) -> tuple[TrainingRun, ...]:
    """The runs with libraries in the innermost loop, rotated so that none is always the first."""
    same: dict[str, list[TrainingRun]] = {}
    for run in runs:
        other = {name: value for name, value in run.label.items() if name != "contestant"}
        key = f"{run.seed} {other}" if "contestant" in run.label else run.name
        same.setdefault(key, []).append(run)
    turns = enumerate(same.values())
    return tuple(
        run for n, each in turns for run in (*each[n % len(each) :], *each[: n % len(each)])
    )


def check_variants(variants: list[Table] | None) -> None:
    """ValueError unless variants are tables of settings with a name each."""
    if variants is None:
        return
    check(bool(variants), "variants is an empty list; give at least one")
    names = [variant.get("name") for variant in variants]
    check(
        all(isinstance(name, str) for name in names) and len(set(map(str, names))) == len(names),
        f"names of variants are {names}; give each a different name",
    )
    for variant in variants:
        check_name(variant["name"])
        check_table({k: v for k, v in variant.items() if k != "name"}, repr(variant["name"]))


def runs_of(
    kind: str, common: Table, label: Table, seeds: Sequence[int], episodes: int
) -> Iterator[TrainingRun]:
    """One combination with every seed, validated once, as validity does not depend on the seed.

    Of the label "name" (the variant), "trial" and "rung" (of a search) are no settings.
    """
    varying = {name: value for name, value in label.items() if name not in NO_SETTINGS}
    try:
        asked = KINDS[kind].settings_of(**{"threads": 1, **common, **varying, "seed": seeds[0]})
        settings, files = frozen_mazes(asked)
        inputs = inputs_of(settings)
    except ValueError as error:
        which = run_label(label | {"seed": seeds[0]})
        raise ValueError(f"combination {which}: {error}") from None
    varying |= {"variant": label["name"]} if "name" in label else {}
    varying |= {name: label[name] for name in NO_SETTINGS[1:] if name in label}
    for seed in seeds:
        own = replace(settings, seed=seed)
        name = job_name(varying, seed, fingerprint(kind, own, episodes, inputs), without=kind)
        yield TrainingRun(name, kind, own, episodes, varying, files, inputs)


def run_label(label: Table) -> str:
    """The varying settings in one line of text."""
    return ", ".join(f"{name}={value!r}" for name, value in label.items())


def layout_of(
    file: StudyFile, stem: str, runs: Sequence[TrainingRun], varying: Sequence[str]
) -> Layout:
    """The layout of the report: the setting on the axis, and those that distinguish curves
    (`variant` if there are any).

    Raises:
        ValueError: an unknown name.
    """
    variants, usual = file.variants or [], ReportHints()
    if file.kind == LIBRARY_RUN and variants:
        usual = ReportHints("variant", ["contestant"])
    hints = file.report or usual
    within = {name for variant in variants for name in variant} - {"name"}
    varying = sorted({*varying, *within})
    known = {name for run in runs for name in (*flat_plain(asdict(run.settings)), *run.label)}
    if not variants:
        known.discard("variant")

    def column(name: str) -> str:
        column = MEASURED.get(name, name)
        check(
            column in known,
            f"{name!r} in [report] is not a setting of these runs; give one that varies: "
            f"{', '.join(['variant'] * bool(variants) + varying) or 'nothing'}",
        )
        return column

    x, group = hints.x, hints.group
    if group is None:
        group = ["variant"] if variants else [name for name in varying if name != x]
    same = ("control", "primary", "margin", "threshold")
    return Layout(
        stem if file.title is None else file.title,
        x=None if x is None else column(x),
        group=[column(name) for name in group],
        variants=[variant["name"] for variant in variants],
        analysis=analysis_of(file, x, runs),
        **{name: getattr(file, name) for name in same},
    )


def analysis_of(file: StudyFile, x: str | None, runs: Sequence[TrainingRun]) -> str:
    """The analysis that a file names, or the usual one; ValueError for one that does not fit."""
    games = any(run.settings.task.game is not None for run in runs)
    fitting = fitting_analyses(file.control, file.kind or RUN, games, x)
    several = x == MAZE and len({run.label.get(MAZE) for run in runs}) > 1
    usual = PAIRED if several and PAIRED in fitting else fitting[0]
    if file.analysis is not None:
        one_of("analysis", file.analysis, ANALYSES)
        check(
            file.analysis in fitting,
            f"analysis={file.analysis!r} with control={file.control!r}, x={x!r} and runs of kind "
            f"{file.kind or RUN!r}; give {' or '.join(map(repr, fitting))}",
        )
    return file.analysis or usual


def fitting_analyses(control: str | None, kind: str, games: bool, x: str | None) -> list[str]:
    """The analyses that fit runs of a kind, the usual one (in one maze) first.

    Args:
        control: of an ablation, or None.
        kind: of the runs.
        games: whether they are in small games.
        x: the setting on the axis of the report.
    """
    if control is None:
        return [LIBRARIES, SUMMARY] if kind == LIBRARY_RUN and x == "variant" else [SUMMARY]
    if kind == SELF_PLAY or games:
        return [PAIRED]
    return [VARIANTS, PAIRED] if x in (None, MAZE) else [VARIANTS]
