"""Successive halving of the settings of the variants of an ablation: [tuning] of its file.

Every searched variant has the same number of trials, with random settings. All of a rung have the
same frames, on games (or mazes) that the study does not use; the better half goes on to the next
rung, with twice the frames (Jamieson and Talwalkar, 2016, "Non-stochastic best arm identification
and hyperparameter optimization"). The best trial of the last rung is chosen.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pursuit.validation import check
from scripted_agents.games.named import game_key
from train.experiments.expansion import Tuned, alternating, check_ablation, runs_of
from train.experiments.rows import read_all
from train.experiments.runs import LAYOUT, Study, TrainingRun
from train.experiments.study import Layout, StudyFile, Table, Trials, Tuning, judged
from train.experiments.tuning import FIRST_TRIAL_SEED, draws_of, mazes_of
from train.reports.tables import Row
from train.runs.folder import RUN

LEAST = 1e-3
"""Added to NashConv, in shares of the range of returns: smaller differences hardly count."""


@dataclass(frozen=True)
class Halving:
    """The rungs of a search.

    Attributes:
        tuning: the search.
        version: "short" or "full"; short by default.
        file: the ablation.
        out: the folder of the search.
        rows: the file with the rows of finished trials, or None.
    """

    tuning: Tuning
    version: str | None
    file: StudyFile
    out: Path
    rows: Path | None

    def __post_init__(self) -> None:
        check_ablation(self.file)
        variants = {variant.get("name") for variant in self.file.variants or ()}
        like = self.tuning.like
        for name in (*({*self.tuning.space} - {"all"}), *like):
            check(
                name in variants,
                f"{name!r} in [tuning]; give the name of a variant: {sorted(map(str, variants))}",
            )
        for name, other in like.items():
            check(
                other in self.searched,
                f"like {other!r} of {name!r} in [tuning]; give a variant of [tuning.space]",
            )
        frames = self.trials.frames
        check(frames is not None, "seconds in [tuning]; rungs are counted in frames: give frames")
        keys = {game_key(game) for game in judged(self.file, "game")}
        used = sorted(game for game in self.tuning.games if game_key(game) in keys)
        check(not used, f"games {used} of [tuning] are those of the study; give others")

    @property
    def trials(self) -> Trials:
        """The trials of the version."""
        return self.tuning.trials(self.version)

    @property
    def searched(self) -> list[str]:
        """The names of the variants with a search of their own."""
        names = [str(variant["name"]) for variant in self.file.variants or ()]
        space = self.tuning.space
        rest = "all" in space
        return [n for n in names if n in space or (rest and n not in self.tuning.like)]

    @property
    def rungs(self) -> range:
        """The numbers of the rungs."""
        return range(self.trials.rungs)

    def folder(self, rung: int) -> Path:
        """The folder of a rung."""
        return self.out / f"rung-{rung}"

    def study(self, rung: int) -> Study:
        """The trials of a rung; of those before it the results must be known."""
        trials = self.trials
        common = {**(self.file.settings or {}), **self.tuning.settings}
        common.pop("seconds", None)
        common["frames"] = int(trials.frames or 0) * 2**rung
        of = "game" if self.tuning.games else "maze"
        units = self.tuning.games[: trials.mazes] or mazes_of(
            self.tuning, trials, common, judged(self.file, "maze")
        )
        runs: list[TrainingRun] = []
        for variant in self.file.variants or ():
            name = str(variant["name"])
            if name not in self.searched:
                continue
            drawn = draws_of(self.tuning, trials, name)
            for number, (place, unit) in itertools.product(self.left(name, rung), enumerate(units)):
                tried = {n: value for n, value in drawn[number].items() if n not in variant}
                label = {of: unit, **tried, "trial": number, "rung": rung}
                own = {**common, **variant, **label}
                fixed = {n: v for n, v in own.items() if n not in label and n != "name"}
                seed = FIRST_TRIAL_SEED + place
                runs += runs_of(self.file.kind or RUN, fixed, {"name": name, **label}, [seed], 1000)
        runs.sort(key=lambda run: str(run.label[of]))
        layout = Layout(f"Search for settings, rung {rung + 1}", x="trial", group=["variant"])
        return Study(layout, alternating(runs), rows=self.rows)

    def left(self, variant: str, rung: int) -> list[int]:
        """The numbers of the trials of a variant in a rung."""
        if rung == 0:
            return list(range(self.trials.samples))
        before = self.left(variant, rung - 1)
        scores = self.scores(variant, rung - 1)
        ranked = sorted(before, key=lambda number: (scores.get(number, math.inf), number))
        return sorted(ranked[: max(len(before) // 2, 1)])

    def scores(self, variant: str, rung: int) -> dict[int, float]:
        """By trial, its `score` in a rung; without trials of which a run is missing."""
        folder = self.folder(rung)
        if not (folder / LAYOUT).exists():
            return {}
        rows = [row for row in read_all(folder).everything if row["variant"] == variant]
        found = {}
        for number in {row["trial"] for row in rows}:
            own = [row for row in rows if row["trial"] == number]
            if all(row["status"] == "complete" for row in own):
                found[int(number)] = score(own)
        return found

    def chosen(self) -> Tuned:
        """The settings of the best trial of each variant; nothing before the last rung ended."""
        best: dict[tuple[str, str], Table] = {}
        last = self.folder(self.rungs[-1])
        for name in self.searched:
            scores = self.scores(name, self.rungs[-1])
            check(
                bool(scores) or not (last / LAYOUT).exists(),
                f"{name!r}: no trial of the last rung is complete; see the error.txt files in "
                f"{last}",
            )
            if scores:
                number = min(scores, key=lambda number: (scores[number], number))
                best["", name] = draws_of(self.tuning, self.trials, name)[number]
        for name, other in self.tuning.like.items():
            if ("", other) in best:
                best["", name] = best["", other]
        return best


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
        share = abs(float(gap or 0.0)) if conv is None else conv / (row.get("payoff_range") or 1.0)
        logs.append(math.log(share + LEAST))
    return sum(logs) / len(logs)
