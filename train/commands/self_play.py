"""`pursuit self-play`: both sides learn; what is printed and drawn."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import strftime
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from train.commands.main import parse
from train.commands.progress import ProgressLines
from train.runs.folder import new_folder, write_beside
from train.self_play.comparison import compare
from train.self_play.trainee import (
    SelfPlay,
    resume_self_play,
    start_self_play,
)
from train.settings.checks import check
from train.settings.self_play import SelfPlaySettings

COLORS = {"nash_conv": "#000000", "chaser": "#D55E00", "evader": "#0072B2"}


@dataclass(frozen=True)
class SelfPlayCommand:
    """Chasers and evaders learn against each other; every evaluation has the exact exploitability.

    Each role meets opponents from a pool of the other role's snapshots, another one in every game.
    """

    settings: SelfPlaySettings = field(default_factory=lambda: SelfPlaySettings(seconds=120.0))
    out: Path | None = None
    """A new folder; runs/self-play-MAZE-TIME if left out."""
    resume: Path | None = None
    """Go on with the self-play in this folder instead; all other options are taken from there."""
    episodes: int = 1000
    """Episodes of the final evaluation, where it is not exact."""
    compare: tuple[str, ...] = ()
    """Run several sampling schemes and report which does best: latest window uniform pfsp psro."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """With --compare: one run of each scheme for each."""
    workers: int = 2
    """With --compare: runs at once."""


def self_play(arguments: Sequence[str]) -> None:
    """`pursuit self-play`."""
    budget: dict[str, Any] = {"seconds": 120.0}
    if any(a == "--frames" or a.startswith("--frames=") for a in arguments):
        budget = {"frames": 1}
    default = SelfPlayCommand(SelfPlaySettings(**budget))
    given = parse(SelfPlayCommand, arguments, "self-play", default)
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    if given.compare:
        check(given.resume is None, "--compare goes on by itself; leave out --resume")
        name = f"self-play-{Path(given.settings.task.maze).stem}-compared"
        rest = _without_own(arguments)
        compare(
            given.settings,
            given.compare,
            given.seeds,
            given.workers,
            rest,
            given.out or Path("runs") / name,
        )
        return
    if given.resume is not None:
        check(given.resume.is_dir(), f"{given.resume}: no such folder")
        run = resume_self_play(given.resume)
    else:
        name = f"self-play-{Path(given.settings.task.maze).stem}-{strftime('%Y%m%d-%H%M%S')}"
        run = start_self_play(given.settings, new_folder(given.out or Path("runs") / name))
    task = run.task
    print(
        f"self-play: {task.name} on maze {task.mazes[0].name}, {task.num_chasers} chaser(s), "
        f"{task.num_evaders} evader(s); opponents: {run.settings.sampling}"
    )
    print(f"folder: {run.folder}")
    with _Watch() as watch:
        run.train(watch)
    if run.stopped:
        print(f"interrupted; go on with: pursuit self-play --resume {run.folder}", file=sys.stderr)
    content = run.results(given.episodes)
    draw_self_play(run.folder / "learning_curve.png", run.metrics.rows, _title(run))
    _print_results(run, content)


def _without_own(arguments: Sequence[str]) -> list[str]:
    """The arguments without those of the comparison itself, and what it sets."""
    own = ("--compare", "--seeds", "--workers", "--out", "--sampling", "--seed")
    kept: list[str] = []
    dropping = False
    for argument in arguments:
        if argument.startswith("--"):
            dropping = argument.split("=")[0] in own
        if not dropping:
            kept.append(argument)
    return kept


def _title(run: SelfPlay) -> str:
    task = run.task
    return f"Self-play on {task.mazes[0].name} ({run.settings.sampling})"


class _Watch(ProgressLines):
    """Shows self-play as it learns."""

    def __call__(self, run: SelfPlay, row: dict[str, float]) -> None:
        """Report an iteration (an empty row) or an evaluation."""
        self.advance(run.progress)
        if not row:
            return
        parts = [
            f"{100 * run.progress:3.0f} %",
            f"{run.seconds:6.1f} s",
            f"{run.frames / 1e6:6.2f} M frames",
            f"{row['frames_per_second'] / 1e3:5.1f} k/s",
        ]
        if "nash_conv" in row:
            parts.append(f"NashConv {row['nash_conv']:6.3f}")
        if "chaser_exploitability" in row:
            parts.append(
                f"(chaser {row['chaser_exploitability']:.3f}, evader "
                f"{row['evader_exploitability']:.3f})"
            )
        parts.append(f"{row['steps']:6.1f} steps")
        for role in ("chaser", "evader"):
            if f"{role}_vs_astar" in row:
                parts.append(f"{role} vs A* {row[f'{role}_vs_astar']:6.1f}")
        self.say(parts)


def _print_results(run: SelfPlay, content: dict[str, Any]) -> None:
    found, matches = content["evaluation"], content["matches"]
    names = list(dict.fromkeys(row["evader"] for row in matches))
    exact = not any(row["games"] for row in matches)
    print(
        f"\nsteps until capture, at most {run.task.max_steps} "
        f"({'exact' if exact else '± is the 95 % interval'}); chasers down, evaders across"
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for name in names:
        table.add_column(name, justify="right")
    for chaser in dict.fromkeys(row["chaser"] for row in matches):
        cells = [
            f"{row['steps']:.2f}" + (f" ± {row['ci95']:.2f}" if row["games"] else "")
            for row in matches
            if row["chaser"] == chaser
        ]
        table.add_row(chaser, *cells)
    Console(width=None if sys.stdout.isatty() else 100).print(table)
    if "nash_conv_reduction" in content:
        print(
            f"\nNashConv {content['nash_conv_at_start']:.3f} -> {found['nash_conv']:.3f} "
            f"discounted steps, {100 * content['nash_conv_reduction']:.1f} % less (exact; 0 is an "
            "equilibrium)"
        )
    if "game_value" in found:
        print(f"value {found['value']:.3f}, of the game {found['game_value']:.3f}")
    for name, steps in content.get("approximate_best_response", {}).items():
        print(f"approximate best response {name.replace('_', ' the ')}: {steps:.2f} steps")
    print(f"results, curve and pool: {run.folder}")


def draw_self_play(path: Path, rows: list[dict[str, float]], title: str) -> None:
    """Exploitability over time, and both sides against the scripted agents below."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    seconds = np.array([row["seconds"] for row in rows])
    exact = "nash_conv" in rows[0]
    figure, axes = pyplot.subplots(
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
            upper.plot(seconds, values, style, color=color, lw=width, label=label)
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
                lower.plot(seconds, values, style, color=COLORS[role], lw=1.5, label=label)
    lower.set_yscale("log")
    lower.yaxis.set_major_formatter(matplotlib.ticker.ScalarFormatter())
    lower.yaxis.set_minor_formatter(matplotlib.ticker.LogFormatter(labelOnlyBase=False))
    lower.set_ylabel("steps until capture (log)")
    lower.legend(frameon=False, fontsize=8, ncol=2)
    lower.set_xlabel("training time (s)")
    axes[0, 0].set_title(title, fontsize=11, loc="left")
    for axis in axes[:, 0]:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, lw=0.6)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=150, format="png"))
    pyplot.close(figure)
