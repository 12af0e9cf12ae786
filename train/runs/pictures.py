"""The learning curve and the replay of a run."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.animation import save_animation
from train.evaluation.scores import Contest
from train.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    PLAIN,
    Look,
    plain_numbers,
    pyplot,
    save,
    short_numbers,
    tidy,
    time_axis,
    time_head,
    time_scale,
)

DASHES: tuple[Any, ...] = ("--", "-.", ":", (0, (6, 2)), (0, (3, 1, 1, 1, 1, 1)))
"""Of references of the same colour."""
COLORS = {"learned": BLUE, "optimal": GREEN, "scripted": ORANGE, "random": GREY}


def draw_learning_curve(
    path: Path,
    rows: list[dict[str, float]],
    scores: list[dict[str, Any]],
    title: str,
    lessons: list[dict[str, Any]] | None = None,
    taught: str = "",
    look: Look = PLAIN,
    column: str = "mean_steps",
) -> None:
    """The measure over frames with the baselines as lines; gap in steps and curriculum below.

    Args:
        path: of the figure, written atomically.
        rows: of `metrics.csv`.
        scores: of `results.json`.
        title: of the figure.
        lessons: of `curriculum.csv`; none where there is no curriculum.
        taught: what those lessons are.
        look: how it is drawn; over frames if it does not say.
        column: of `rows` and `scores`, what the run is judged by.
    """
    unit = look.x or "frames"
    times = np.array([row[unit] for row in rows]) * time_scale(unit)
    measured = np.array([row[column] for row in rows])
    by_name = {score["name"]: score for score in scores}
    of_steps = column == "mean_steps"
    has_gap = of_steps and "optimal" in by_name and any("optimality_gap" in row for row in rows)
    heights = [3.0] + [2.0] * has_gap + [1.3] * bool(lessons)
    figure, axes = pyplot().subplots(
        len(heights),
        1,
        figsize=(7, 0.7 + 1.15 * sum(heights)),
        sharex=True,
        squeeze=False,
        height_ratios=heights,
        layout="constrained",
    )
    upper = axes[0, 0]
    upper.plot(times, measured, "o-", color=COLORS["learned"], ms=3.5, lw=1.8, label="learned")
    dashes = itertools.cycle(DASHES)
    for name, score in by_name.items():
        if name.startswith("learned") or score.get(column) is None:
            continue
        dash = "--" if name in COLORS else next(dashes)
        color = COLORS.get(name, COLORS["scripted"])
        label = f"{name}: {score[column]:.2f}"
        upper.axhline(score[column], color=color, lw=1.4, ls=dash, label=label)
    if of_steps:
        upper.set_yscale("log")
        plain_numbers(upper.yaxis)
    words = {"mean_steps": "episode length (steps, log)", "mean_goals": "goals collected"}
    upper.set_ylabel(f"mean {words.get(column, 'return')}")
    upper.set_title(title, fontsize=11, loc="left", wrap=True)
    upper.legend(frameon=False, fontsize=9)
    if has_gap:
        lower = axes[1, 0]
        gap = 100 * np.array([row.get("optimality_gap", np.nan) for row in rows])
        lower.plot(times, gap, "o-", color=COLORS["learned"], ms=3.5, lw=1.8)
        lower.axhline(0, color=COLORS["optimal"], lw=1.4, ls="--")
        lower.set_yscale("symlog", linthresh=1.0)
        low, high = min(np.nanmin(gap), 0.0), max(np.nanmax(gap), 0.0)
        lower.set_ylim(1.5 * low - 0.3, 1.5 * high + 0.3)
        short_numbers(lower.yaxis)
        lower.set_ylabel("gap to the optimum (%)")
    if lessons:
        draw_lessons(axes[-1, 0], lessons, float(times[-1]), taught, unit)
    axes[-1, 0].set_xlabel(time_head(unit))
    for axis in axes[:, 0]:
        time_axis(axis, look.log)
        tidy(axis)
    save(figure, path, 150, look.formats)


def draw_lessons(
    axis: Any, lessons: list[dict[str, Any]], end: float, taught: str, unit: str = "frames"
) -> None:
    """What the curriculum gave: the mean as a step line, the range as a band; up to `end`, which is
    in millions of frames or in seconds."""
    places = np.array([*(row[unit] * time_scale(unit) for row in lessons), end])
    mean, low, high = (
        np.array([row[name] for row in [*lessons, lessons[-1]]]) for name in ("mean", "low", "high")
    )
    axis.plot(places, mean, color=PINK, lw=1.6, drawstyle="steps-post")
    if (high > low).any():
        axis.fill_between(places, low, high, color=PINK, alpha=0.18, lw=0, step="post")
    axis.set_ylabel(taught.replace("-", "\n", 1).replace("-", " "))


def save_replay(path: Path, contest: Contest, policy: Any, episodes: int = 3) -> None:
    """Write a replay as .gif or .mp4, by the suffix of `path`."""
    save_animation(path, contest.scenes(policy, episodes))
