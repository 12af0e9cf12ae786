"""What a race came to, in numbers: times to each gap, runs, trials and curves as rows."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np

from train.experiments.comparison.plan import Race
from train.experiments.comparison.run import Result, Standing
from train.experiments.statistics import first_below
from train.reports.tables import Row

TARGETS = (0.05, 0.02, 0.01)
"""Gaps to the optimum."""
WAYS = ("greedy", "sampled")
"""How a policy plays: its most probable action, or as it was learned."""
UNITS = ("seconds", "frames")
NEVER = float("inf")


def results_of(race: Race, standing: Standing, task: str, name: str) -> list[Result | None]:
    """The bouts of one contestant on one task, by seed."""
    return [standing.finals[task, name, seed] for seed in race.seeds]


def reached(result: Result | None, way: str, target: float, unit: str) -> float:
    """Seconds or frames to the first evaluation at which the gap is at most the target; `NEVER`
    where it is not within the budget, or where the bout failed."""
    if result is None:
        return NEVER
    places = [point[unit] for point in result.points]
    return first_below(places, [point[way] for point in result.points], target)


def median_of(times: Sequence[float]) -> float | None:
    """The median of times of which some are `NEVER`; None where not more than half are times: it is
    not known then."""
    got = sum(time < NEVER for time in times)
    return float(median(times)) if 2 * got > len(times) else None


def table_rows(race: Race, standing: Standing) -> list[Row]:
    """A row for each task, way to play, target and contestant."""
    rows = []
    for on in race.tasks:
        for way in WAYS:
            for target in TARGETS:
                for name in race.contestants:
                    found = results_of(race, standing, on.name, name)
                    row: Row = {"task": on.name, "policy": way, "target": target}
                    row |= {"contestant": name, "runs": len(found)}
                    for unit in UNITS:
                        times = [reached(result, way, target, unit) for result in found]
                        row["reached"] = sum(time < NEVER for time in times)
                        row[f"median_{unit}"] = median_of(times)
                        row[unit] = " ".join("-" if t == NEVER else f"{t:.6g}" for t in times)
                    rows.append(row)
    return rows


def run_rows(race: Race, standing: Standing) -> list[Row]:
    """A row for each bout of the race."""
    rows = []
    for (task, name, seed), result in standing.finals.items():
        row: Row = {"task": task, "contestant": name, "seed": seed}
        if result is None:
            rows.append(row | {"failed": True})
            continue
        last = result.points[-1]
        row |= {"failed": False, **last, "frames_per_second": last["frames"] / last["seconds"]}
        for way in WAYS:
            for target in TARGETS:
                for unit in UNITS:
                    time = reached(result, way, target, unit)
                    key = f"{unit}_to_{100 * target:g}_percent_{way}"
                    row[key] = None if time == NEVER else time
        row |= {"library": result.library, "torch": result.torch, "commit": result.commit}
        rows.append(row | {"processor": result.processor})
    return rows


def trial_rows(race: Race, standing: Standing) -> list[Row]:
    """A row for each trial: its settings, and how it did on the held-out mazes it was run on."""
    rows = []
    for (task, name, number), scores in standing.scores.items():
        mazes = next(on.held_out for on in race.tasks if on.name == task)
        gaps = {
            f"gap on maze {place + 1}": None if score is None else float(np.exp(score))
            for place, (_, score) in enumerate(zip(mazes, scores, strict=False))
        }
        chosen = standing.chosen[task, name] == number
        row: Row = {"task": task, "contestant": name, "trial": number, "chosen": chosen}
        rows.append({**row, **race.trials[number], **gaps})
    return rows


def curve_rows(standing: Standing) -> list[Row]:
    """A row for each evaluation of the race."""
    return [
        {"task": task, "contestant": name, "seed": seed, **point}
        for (task, name, seed), result in standing.finals.items()
        for point in (result.points if result else ())
    ]
