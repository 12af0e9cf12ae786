"""Table and figure of docs/results/frames_and_states.md: frames to a gap by number of states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.committed import grouped, read_table
from train.reports.figures import PALETTE, log_axis, pyplot, save, tidy
from train.reports.tables import plain_table

NAMES = {"table": "table (Q-learning)", "network": "network (PPO)"}
Row = dict[str, Any]


def tables(data: Path) -> dict[str, str]:
    """The table by its title."""
    found = []
    for size, own in sorted(grouped(read_table(data / "runs.csv"), "size").items()):
        line: Row = {"maze": f"{size}x{size}", "states": f"{own[0]['states']:,}"}
        for learner, runs in sorted(grouped(own, "learner").items(), reverse=True):
            line[f"{learner}, thousand frames"] = ", ".join(
                f"{row['frames'] / 1e3:,.0f}" for row in runs
            )
        found.append(line)
    return {"frames": plain_table(found).markdown()}


def figures(data: Path, out: Path) -> None:
    """The frames of every run over the states of its maze, with the least squares lines."""
    figure, axis = pyplot().subplots(figsize=(6.4, 4.2), layout="constrained")
    rows = read_table(data / "runs.csv")
    sizes = {row["states"]: f"{row['states']:,}\n({row['size']}x{row['size']})" for row in rows}
    for (learner, name), color, shift in zip(NAMES.items(), PALETTE, (0.94, 1.06), strict=False):
        own = [row for row in rows if row["learner"] == learner]
        states, frames = (
            np.array([row[n] for row in own], dtype=float) for n in ("states", "frames")
        )
        power, constant = np.polyfit(np.log(states), np.log(frames / 1e3), 1)
        label = f"{name}: states to the power of {power:.2f}"
        axis.plot(shift * states, frames / 1e3, "o", ms=5, alpha=0.7, color=color, label=label)
        ends = np.array([min(sizes), max(sizes)])
        axis.plot(ends, np.exp(constant) * ends**power, lw=1.2, color=color)
    for which in "xy":
        log_axis(axis, which)
    axis.set_xticks([*sizes], [*sizes.values()])
    axis.set_xticks([], minor=True)
    axis.set_xlabel("states of the maze (its size)")
    axis.set_ylabel("thousand frames until the gap is at most 1 %")
    axis.legend(frameon=False, loc="upper left")
    tidy(axis)
    save(figure, out / "frames_and_states.png")
