"""The search for settings before the runs of a study: [tuning] of its file.

Everything that is searched has the same number of trials with random settings, on mazes or games
that the study does not use. All trials of a rung have the same budget; the better half goes on to
the next rung, with twice the budget (successive halving; Jamieson and Talwalkar, 2016,
"Non-stochastic best arm identification and hyperparameter optimization"). The best trial of the
last rung is chosen. One rung is random search.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from pursuit.mazes.maze import load_maze
from pursuit.mazes.suite_files import is_suite
from pursuit.mazes.suites import least_copy, load_suite
from pursuit.validation import check
from scripted_agents.games.named import game_key
from train.experiments.expansion import NO_SETTINGS, Tuned, alternating, runs_of
from train.experiments.library_runs import LIBRARY_RUN
from train.experiments.rows import read_all
from train.experiments.runs import LAYOUT, TUNING, Study, TrainingRun, read_label
from train.experiments.search import draw_samples
from train.experiments.study import Layout, StudyFile, Table, Trials, Tuning, check_once, judged
from train.experiments.variants import check_ablation
from train.reports.tables import Row
from train.runs.folder import RUN

FIRST_TRIAL_SEED = 10**6
"""The first seed of trials; runs of studies have seeds below it."""
LEAST = 1e-3
"""Added to distances in the choice of settings: smaller differences hardly count."""
MOST_TRIALS = 10_000
EPISODES = 1000
"""Of the evaluation of a trial."""


@dataclass(frozen=True)
class Searched:
    """What has settings of its own.

    Attributes:
        learner: an algorithm or library; "" for a variant of an ablation.
        task: a variant; "" for all.
        common, own: settings of its trials besides the drawn ones: those of the study, and those of
            the variant, which are not drawn.
    """

    learner: str
    task: str
    common: Table
    own: Table

    @property
    def key(self) -> tuple[str, str]:
        """As in `Tuned`."""
        return self.learner, self.task


@dataclass(frozen=True)
class TuningSearch:
    """The trials of a study.

    Attributes:
        tuning, trials: the search, and its size.
        searched: what has settings of its own.
        of: "variant", "algorithm" or "contestant": the column that names it.
        kind: of the runs.
        out: the folder of the search.
        studied: mazes of the study.
        episodes: of the evaluation of a trial.
        rows: the file with the rows of finished trials, or None.
    """

    tuning: Tuning
    trials: Trials
    searched: tuple[Searched, ...]
    of: str
    kind: str
    out: Path
    studied: tuple[str, ...] = ()
    episodes: int = EPISODES
    rows: Path | None = None

    @property
    def has_rungs(self) -> bool:
        """Whether folders and names of trials have the number of their rung: in ablations, too."""
        return self.of == "variant" or self.trials.rungs > 1

    @property
    def rungs(self) -> range:
        """The numbers of the rungs."""
        return range(self.trials.rungs)

    def folder(self, rung: int) -> Path:
        """The folder of a rung."""
        return self.out / f"rung-{rung}" if self.has_rungs else self.out

    def study(self, rung: int) -> Study:
        """The trials of a rung; of those before it the results must be known.

        Raises:
            ValueError: a maze of the search that is also one of the study, or settings that cannot
                run.
        """
        trials, left, runs = self.trials, self.left(rung), list[TrainingRun]()
        place = "game" if self.tuning.games else "maze"
        budget = {
            name: None if value is None else value * 2**rung
            for name, value in (("seconds", trials.seconds), ("frames", trials.frames))
        }
        for number, each in itertools.product(range(trials.samples), self.searched):
            if number not in left[each.key]:
                continue
            label: Table = {self.of: each.learner} if each.learner else {}
            numbers: Table = {"trial": number} | ({"rung": rung} if self.has_rungs else {})
            numbers |= {"name": each.task} if each.task else {}
            drawn = draws_of(self.tuning, trials, each)[number]
            common = {**each.common, **each.own, **budget}
            for count, unit in enumerate(self.units(each)):
                seed = FIRST_TRIAL_SEED + count + (0 if self.has_rungs else 1000 * number)
                own = {**label, place: unit, **drawn, **numbers}
                runs += runs_of(self.kind, common, own, [seed], self.episodes)
        title = f"Search for the settings of each {self.of}"
        title = f"Search for settings, rung {rung + 1}" if self.has_rungs else title
        layout = Layout(title, x="trial", group=[self.of])
        return Study(layout, alternating(runs), self.kind == LIBRARY_RUN, self.rows)

    def units(self, searched: Searched) -> Sequence[str]:
        """The games or mazes of the trials."""
        task = {**searched.common, **searched.own, "name": searched.task}
        games = self.tuning.games[: self.trials.mazes]
        return games or mazes_of(self.tuning, self.trials, task, self.studied)

    def left(self, rung: int) -> dict[tuple[str, str], list[int]]:
        """The numbers of the trials in a rung."""
        if rung == 0:
            return {each.key: list(range(self.trials.samples)) for each in self.searched}
        found, scores = self.left(rung - 1), self.scores(rung - 1)
        for key, before in found.items():
            ranked = sorted(before, key=lambda n: (scores.get(key, {}).get(n, math.inf), n))
            found[key] = sorted(ranked[: max(len(before) // 2, 1)])
        return found

    def scores(self, rung: int) -> dict[tuple[str, str], dict[int, float]]:
        """The `score` of each trial in a rung; without trials of which a run is missing."""
        found: dict[tuple[str, str], dict[int, float]] = {}
        for row in trials_in(self.folder(rung)):
            if row["score"] is not None:
                learner = "" if self.of == "variant" else row[self.of]
                found.setdefault((learner, row["task"]), {})[row["trial"]] = row["score"]
        return found

    def chosen(self) -> Tuned:
        """The settings of the best trials of the last rung, as far as they are known."""
        best, scores = dict[tuple[str, str], Table](), self.scores(self.rungs[-1])
        for each in self.searched:
            if own := scores.get(each.key):
                number = min(own, key=lambda number: (own[number], number))
                best[each.key] = draws_of(self.tuning, self.trials, each)[number]
        for name, other in self.tuning.like.items():
            if ("", other) in best:
                best["", name] = best["", other]
        return best

    def lacking(self) -> list[str]:
        """What has no complete trial in the last rung."""
        known = self.scores(self.rungs[-1])
        return [
            " on ".join(repr(name) for name in each.key if name)
            for each in self.searched
            if each.key not in known
        ]


def tuning_search_of(
    tuning: Tuning,
    version: str | None,
    out: Path,
    file: StudyFile | None = None,
    rows: Path | None = None,
) -> TuningSearch:
    """The search of a study.

    Args:
        tuning: of its file.
        version: "short" or "full"; short by default.
        out: the folder of the search.
        file: an ablation, whose variants are searched, or a comparison, whose libraries are
            searched on each task (its variants); None: algorithms are searched on the task in the
            settings of `tuning`.
        rows: the file with the rows of finished trials, or None.

    Raises:
        ValueError: names that the study does not have, or a game of the search that is also one of
            the study.
    """
    check(bool(tuning.space), "space={} in [tuning]; name the settings to search")
    search_of = partial(TuningSearch, tuning, tuning.trials(version), out=out, rows=rows)
    if file is None:
        whole = tuple(Searched(name, "", tuning.settings, {}) for name in tuning.space)
        return search_of(whole, "algorithm", RUN)
    common = {**file.settings, **tuning.settings}
    studied = tuple(judged(file, "maze"))
    if file.kind == LIBRARY_RUN:
        libraries = file.grid.get("contestant", [])
        check_once("contestant in [grid]", libraries)
        check(
            max(file.seeds or [0]) < FIRST_TRIAL_SEED,
            f"seeds={file.seeds}; give seeds below {FIRST_TRIAL_SEED}, the first seed of trials",
        )
        common["evaluations"] = 1
        whole = tuple(
            Searched(name, str(task.get("name", "")), common, settings_of_variant(task))
            for task, name in itertools.product(file.variants or [Table()], libraries)
        )
        episodes = file.episodes or EPISODES
        return search_of(whole, "contestant", LIBRARY_RUN, studied=studied, episodes=episodes)
    check_ablation(file)
    variants = {str(variant["name"]): variant for variant in file.variants or ()}
    for name in (*({*tuning.space} - {"all"}), *tuning.like):
        remedy = f"give the name of a variant: {sorted(variants)}"
        check(name in variants, f"{name!r} in [tuning]; {remedy}")
    searched = [
        name
        for name in variants
        if name in tuning.space or ("all" in tuning.space and name not in tuning.like)
    ]
    for name, other in tuning.like.items():
        remedy = "give a variant of [tuning.space]"
        check(other in searched, f"like {other!r} of {name!r} in [tuning]; {remedy}")
    keys = {game_key(game) for game in judged(file, "game")}
    used = sorted(game for game in tuning.games if game_key(game) in keys)
    check(not used, f"games {used} of [tuning] are those of the study; give others")
    whole = tuple(
        Searched("", name, common, settings_of_variant(variants[name])) for name in searched
    )
    return search_of(whole, "variant", file.kind or RUN, studied=studied)


def settings_of_variant(variant: Table) -> Table:
    """The settings of a variant."""
    return {name: value for name, value in variant.items() if name != "name"}


def draws_of(tuning: Tuning, trials: Trials, searched: Searched) -> list[Table]:
    """The settings of every trial. Those of "all" are equal for every algorithm, library or
    variant, and so are those of equal spaces."""
    name = searched.learner or searched.task
    spaces = [tuning.space[each] for each in ("all", name) if each in tuning.space]
    check(bool(spaces), f"no space of {name!r} in [tuning]; give it, or [tuning.space.all]")
    for setting in ("samples", "seed"):
        named = any(setting in space for space in spaces)
        check(not named, f"{setting!r} in [tuning.space]; give it in [tuning]")
    defaults: list[Table] = [{}] if tuning.shipped else []
    drawn: list[Table] = [{} for _ in range(trials.samples - len(defaults))]
    for place, space in enumerate(spaces if drawn else ()):
        search = {**space, "samples": len(drawn), "seed": tuning.search_seed + place}
        new = draw_samples(search, MOST_TRIALS)
        drawn = [{**old, **more} for old, more in zip(drawn, new, strict=True)]
    drawn = [{n: v for n, v in each.items() if n not in searched.own} for each in drawn]
    return defaults + drawn


def mazes_of(tuning: Tuning, trials: Trials, task: Table, others: Sequence[str] = ()) -> list[str]:
    """The mazes on which the settings of a task are searched.

    Args:
        tuning, trials: the search.
        task: the settings of its runs.
        others: further mazes of the study.

    Raises:
        ValueError: none, one given twice (also rotated or mirrored), or a maze of the study.
    """
    name, mazes = str(task.get("name", "")), tuning.mazes
    if isinstance(mazes, dict):
        mazes = mazes.get(name, [])
    own = [maze for maze in (task.get("maze"), *others) if isinstance(maze, str)]
    where = f"mazes of {name!r} in [tuning]" if name else "mazes in [tuning]"
    chosen = mazes[: trials.mazes]
    check(bool(chosen), f"{where}: none; give mazes for the search")
    studied = {key for maze in own for key in copies_in(maze)}
    copies: dict[bytes, str] = {}
    for maze in chosen:
        key = least_copy_of(maze)
        check(key not in studied, f"{where}: {maze!r} is a maze of the study; give another")
        before = copies.get(key)
        same = "is given twice" if before == maze else f"is a copy of {before!r}"
        check(before is None, f"{where}: {maze!r} {same}; give each once")
        copies[key] = maze
    return chosen


@lru_cache(maxsize=64)
def copies_in(name: str) -> list[bytes]:
    """By maze of a name, a key that is equal for its rotated and mirrored copies."""
    return [
        least_copy(maze) for maze in (load_suite(name) if is_suite(name) else [load_maze(name)])
    ]


def least_copy_of(maze: str) -> bytes:
    """The key of a name of one maze."""
    found = copies_in(maze)
    check(len(found) == 1, f"maze={maze!r} is several mazes; give one of them, as {maze}/0")
    return found[0]


# -- the choice ------------------------------------------------------------------------------------


def last_trials(out: Path) -> list[Row]:
    """`trials_in` the last rung of the search of the study in `out`; nothing without a search."""
    rungs = sorted(
        (out / TUNING).glob("rung-*"), key=lambda path: int(path.name.partition("-")[2] or 0)
    )
    return trials_in([out / TUNING, *rungs][-1])


def trials_in(folder: Path) -> list[Row]:
    """The trials in the folder of a rung, in the order of their numbers; nothing if there are none.

    Returns:
        A row for each trial of each variant, algorithm or library (and task): its settings, its
        gaps on all mazes, its `score` (None while a run is missing), and whether it is "chosen":
        the first one with the lowest score.
    """
    if not (folder / LAYOUT).exists():
        return []
    search = read_all(folder)
    of = search.layout.group[0]
    groups: dict[tuple[str, str, int], list[Row]] = {}
    for row in sorted(search.everything, key=lambda row: (row["trial"], row["seed"])):
        groups.setdefault((row[of], row["variant"] or "", row["trial"]), []).append(row)
    no_settings = (of, "maze", "game", "variant", *NO_SETTINGS)
    trials, scored = list[Row](), dict[tuple[str, str], list[Row]]()
    for (name, task, number), runs in groups.items():
        label: Row = {**read_label(folder / "runs" / runs[0]["run"])}
        label = label or {n: v for n in search.varying if (v := runs[0][n]) is not None}
        trial: Row = {of: name, "task": task, "trial": number}
        trial |= {n: value for n, value in label.items() if n not in no_settings}
        complete = all(run["status"] == "complete" for run in runs)
        trial["gaps"] = [
            run.get("optimality_gap") if run["status"] == "complete" else None for run in runs
        ]
        trial |= {"score": score(runs) if complete else None, "chosen": False}
        trials.append(trial)
        if complete:
            scored.setdefault((name, task), []).append(trial)
    for own in scored.values():
        min(own, key=lambda trial: trial["score"])["chosen"] = True  # the first of equal ones
    return trials


def score(rows: Iterable[Row]) -> float:
    """The mean logarithm of NashConv in shares of the range of returns, plus `LEAST`; without
    NashConv of the gap to the optimum."""
    logs = []
    for row in rows:
        conv, gap = row.get("played_nash_conv"), row.get("optimality_gap")
        check(
            conv is not None or gap is not None,
            f"{row['run']}: neither NashConv nor a gap to the optimum is known; use smaller games",
        )
        # Absolute, as evaders have negative gaps.
        share = abs(float(gap or 0.0)) if conv is None else conv / (row.get("payoff_range") or 1.0)
        logs.append(math.log(share + LEAST))
    return sum(logs) / len(logs)
