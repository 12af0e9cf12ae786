"""The pictures of self-play: exploitability over time, and the payoff matrix of a league."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from train.figures import (
    BLACK,
    BLUE,
    ORANGE,
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
from train.self_play.league import LeagueTable
from train.self_play.past import Standings

LABEL_WIDTH = 24
"""Letters in a line of a label."""
COLORS = {"nash_conv": BLACK, "chaser": ORANGE, "evader": BLUE}


def draw_self_play(
    path: Path, rows: list[dict[str, float]], title: str, look: Look = PLAIN
) -> None:
    """Exploitability over time (seconds if `look` does not say), and both sides against the
    scripted agents below."""
    unit = look.x or "seconds"
    times = np.array([row[unit] for row in rows]) * time_scale(unit)
    exact = "nash_conv" in rows[0]
    figure, axes = pyplot().subplots(
        2 if exact else 1,
        1,
        figsize=(7, 6.4 if exact else 3.6),
        sharex=True,
        squeeze=False,
        layout="constrained",
    )
    if exact:
        upper = axes[0, 0]
        for name, label in (
            ("nash_conv", "NashConv"),
            ("chaser_exploitability", "of the chaser"),
            ("evader_exploitability", "of the evader"),
        ):
            if name not in rows[0]:
                continue
            values = [row[name] for row in rows]
            color = COLORS[name.split("_exp")[0]]
            width = 2.2 if name == "nash_conv" else 1.3
            style = "-" if name == "nash_conv" else "--"
            upper.plot(times, values, style, color=color, lw=width, label=label)
        upper.set_ylim(bottom=-0.03 * max(row["nash_conv"] for row in rows))  # 0 can be seen
        upper.set_ylabel("exploitability, exact\n(discounted steps)")
        upper.legend(frameon=False, fontsize=9)
    lower = axes[-1, 0]
    styles = {"astar": "-", "random": ":", "optimal": "--"}
    shown = {"astar": "A*", "random": "random", "optimal": "optimal"}
    for role in ("chaser", "evader"):
        for name, style in styles.items():
            column = f"{role}_vs_{name}"
            if column in rows[0]:
                values = [row[column] for row in rows]
                label = f"{role} against {shown[name]}"
                lower.plot(times, values, style, color=COLORS[role], lw=1.5, label=label)
    lower.set_yscale("log")
    plain_numbers(lower.yaxis)
    lower.set_ylabel("steps until capture (log)")
    lower.legend(frameon=False, fontsize=8, ncol=2)
    lower.set_xlabel(time_head(unit))
    axes[0, 0].set_title(title, fontsize=11, loc="left", wrap=True)
    for axis in axes[:, 0]:
        time_axis(axis, look.log)
        tidy(axis)
    save(figure, path, 150, look.formats)


def draw_league(path: Path, table: LeagueTable, title: str, look: Look = PLAIN) -> None:
    """The payoff matrix as a heat map."""
    chasers, evaders = table.payoff.shape
    figure, axis = pyplot().subplots(
        figsize=(3.6 + 0.85 * evaders, 1.8 + 0.55 * chasers), layout="constrained"
    )
    image = axis.imshow(table.payoff, cmap="viridis", aspect="auto")
    low, high = table.payoff.min(), table.payoff.max()
    for i in range(chasers):
        for j in range(evaders):
            value = table.payoff[i, j]
            dark = value < low + 0.6 * (high - low)
            axis.text(
                j, i, f"{value:.1f}", ha="center", va="center", fontsize=9,
                color="white" if dark else "black",
            )  # fmt: skip
    axis.set_yticks(range(chasers), [_broken(name) for name in table.chasers])
    axis.set_xticks(
        range(evaders), [_broken(name) for name in table.evaders], rotation=30, ha="right"
    )
    axis.set_ylabel("chaser")
    axis.set_xlabel("evader")
    figure.colorbar(image, label="steps until capture")
    axis.set_title(title, fontsize=11)
    save(figure, path, formats=look.formats)


def draw_snapshots(path: Path, sides: Sequence[Standings], title: str, look: Look = PLAIN) -> None:
    """Elo and exploitability of snapshots by the frames at which they were taken."""
    figure, (upper, lower) = pyplot().subplots(
        2, 1, figsize=(7, 6.0), sharex=True, layout="constrained"
    )
    for one in sides:
        frames, color = one.frames * time_scale("frames"), COLORS[one.role]
        upper.plot(frames, one.elo, "o-", color=color, ms=3.5, lw=1.3, label=f"{one.role}s")
        lower.plot(frames, one.exploitability, "o-", color=color, ms=3.5, lw=1.3)
    least = min(float(one.exploitability.min()) for one in sides)
    lower.set_yscale("log")
    lower.set_ylim(bottom=max(least / 1.5, 1e-9))  # below, it is rounding
    short_numbers(lower.yaxis)
    upper.set_ylabel("Elo")
    lower.set_ylabel("exploitability, exact\n(discounted steps, log)")
    lower.set_xlabel(time_head("frames"))
    upper.legend(frameon=False, fontsize=9)
    upper.set_title(title, fontsize=11, loc="left", wrap=True)
    for axis in (upper, lower):
        time_axis(axis, look.log)
        tidy(axis)
    save(figure, path, 150, look.formats)


def _broken(name: str) -> str:
    """A name in lines that a label has room for; nothing of it is left out."""
    return textwrap.fill(name, LABEL_WIDTH)
