"""`pursuit self-play --compare`: sampling schemes against each other, over several seeds."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from train.experiments.report import PALETTE
from train.experiments.statistics import (
    interquartile_mean,
    interquartile_means,
    stratified_interval,
)
from train.runs.folder import RESULTS, read_json, read_metrics, write_beside
from train.self_play.pool import SAMPLING
from train.settings.checks import check
from train.settings.self_play import SETTINGS, SelfPlaySettings, load_self_play_settings


def compare(
    settings: SelfPlaySettings,
    schemes: Sequence[str],
    seeds: Sequence[int],
    workers: int,
    rest: Sequence[str],
    out: Path,
) -> None:
    """Run every scheme with every seed as `pursuit self-play`, then report; done runs are skipped.

    Args:
        settings: of every run, but for scheme and seed.
        schemes: of `SAMPLING`.
        seeds: one run of each scheme for each.
        workers: runs at once.
        rest: the options of the command line that gave `settings`.
        out: folder of the runs, SCHEME-SEED each; interrupted ones go on.

    Raises:
        ValueError: an unknown scheme, one given twice, a game without exact
            exploitability, runs of other settings in `out`, or a run that failed.
    """
    for name in schemes:
        check(name in SAMPLING, f"unknown sampling {name!r}; one of {', '.join(SAMPLING)}")
        check(list(schemes).count(name) == 1, f"sampling {name!r} is given twice")
    check(len(set(seeds)) == len(seeds) > 0, f"seeds={list(seeds)}; give some, each once")
    check(workers >= 1, f"workers={workers}; at least 1")
    check(
        settings.task.build().is_duel and len(settings.learning) == 2,
        "a comparison is by exact exploitability; take one chaser and one evader, both learning",
    )
    out.mkdir(parents=True, exist_ok=True)
    for seed, scheme in ((seed, scheme) for seed in seeds for scheme in schemes):
        folder = out / f"{scheme}-{seed}"
        if (folder / SETTINGS).exists():
            check(
                load_self_play_settings(folder) == replace(settings, sampling=scheme, seed=seed),
                f"{folder}: a run with other settings; give another --out",
            )

    def one(job: tuple[int, str]) -> tuple[str, int, str]:
        seed, scheme = job
        folder = out / f"{scheme}-{seed}"
        if (folder / RESULTS).exists() and not read_json(folder / RESULTS)["interrupted"]:
            return folder.name, 0, ""
        command = [sys.executable, "-m", "train.commands.main", "self-play"]
        if (folder / SETTINGS).exists():
            command += ["--resume", str(folder)]
        else:
            command += [*rest, "--sampling", scheme, "--seed", str(seed), "--out", str(folder)]
        ended = subprocess.run(command, capture_output=True, text=True)
        said = (ended.stderr.strip().splitlines() or [""])[-1]
        stopped = ended.returncode == 0 and read_json(folder / RESULTS)["interrupted"]
        return folder.name, ended.returncode or int(stopped), "interrupted" if stopped else said

    jobs = [(seed, scheme) for seed in seeds for scheme in schemes]
    failed = []
    with ThreadPoolExecutor(workers) as pool:
        for number, (name, status, said) in enumerate(pool.map(one, jobs), 1):
            print(f"{number} of {len(jobs)} done: {name}", flush=True)
            if status:
                failed.append(f"{name}: {said}")
    check(not failed, f"{len(failed)} runs failed; {'; '.join(failed)}")
    print(report(out, schemes, seeds))


def report(out: Path, schemes: Sequence[str], seeds: Sequence[int]) -> str:
    """Draw `comparison.png`, write `comparison.md`, and give the latter's text."""
    rows: dict[str, list[list[dict[str, float]]]] = {}
    finals: dict[str, list[dict[str, Any]]] = {}
    for scheme in schemes:
        folders = [out / f"{scheme}-{seed}" for seed in seeds]
        rows[scheme] = [read_metrics(folder) for folder in folders]
        finals[scheme] = [read_json(folder / RESULTS) for folder in folders]
    first = finals[schemes[0]][0]
    budget = max(found["seconds"] for many in finals.values() for found in many)
    lines = [
        f"# Self-play on {first['maze']}: who is drawn as the opponent",
        "",
        "| sampling | NashConv at the end [95 %] | less than at the start, % [95 %] "
        "| worst seed, % | chaser vs A* | evader vs A* | M frames |",
        "|---|---|---|---|---|---|---|",
    ]
    for scheme in schemes:
        ends = [found["evaluation"]["nash_conv"] for found in finals[scheme]]
        less = [100 * found["nash_conv_reduction"] for found in finals[scheme]]
        cells = [scheme, _with_interval(ends, 3), _with_interval(less, 1), f"{min(less):.1f}"]
        for name in ("chaser_vs_astar", "evader_vs_astar"):
            cells.append(f"{np.mean([f['evaluation'][name] for f in finals[scheme]]):.1f}")
        cells.append(f"{np.mean([found['frames'] for found in finals[scheme]]) / 1e6:.1f}")
        lines.append("| " + " | ".join(cells) + " |")
    lines += [
        "",
        f"{len(seeds)} seeds of about {budget:.0f} s each. NashConv is exact, in discounted steps, "
        "of the two policies as they are at that moment; 0 is an equilibrium. Interquartile means "
        "with a stratified bootstrap; with few seeds the interval is hardly more than their range. "
        "Against A*: expected steps until capture.",
        "",
        "![NashConv over training time](comparison.png)",
    ]
    text = "\n".join(lines) + "\n"
    write_beside(out / "comparison.md", lambda beside: beside.write_text(text, encoding="utf-8"))
    draw_comparison(out / "comparison.png", rows, f"Self-play on {first['maze']}")
    return text


def _with_interval(values: list[float], digits: int) -> str:
    low, high = stratified_interval([values])
    middle = f"{interquartile_mean(values):.{digits}f}"
    return middle if np.isnan(low) else f"{middle} [{low:.{digits}f}, {high:.{digits}f}]"


def draw_comparison(path: Path, rows: dict[str, list[list[dict[str, float]]]], title: str) -> None:
    """NashConv over time: the interquartile mean, its interval as a band, all seeds faintly."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        1, len(rows), figsize=(2.6 * len(rows) + 0.8, 3.2), sharey=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for axis, (scheme, runs), color in zip(axes[0], rows.items(), PALETTE, strict=False):
        end = min(run[-1]["seconds"] for run in runs)
        places = np.linspace(0.0, end, 100)
        curves = []
        for run in runs:
            seconds = [row["seconds"] for row in run]
            nash = [row["nash_conv"] for row in run]
            axis.plot(seconds, nash, color=color, lw=0.8, alpha=0.45)
            curves.append(np.interp(places, seconds, nash))
        stacked = np.stack(curves, axis=-1)
        axis.plot(places, interquartile_means(stacked), color=color, lw=2.0)
        if len(runs) > 1:
            bands = np.array([stratified_interval([list(point)]) for point in stacked])
            axis.fill_between(places, bands[:, 0], bands[:, 1], color=color, alpha=0.2, lw=0)
        start = float(np.mean([run[0]["nash_conv"] for run in runs]))
        axis.axhline(0.2 * start, color="#555555", lw=1.0, ls=":")
        axis.set_title(scheme, fontsize=10)
        axis.set_ylim(bottom=0)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, lw=0.6)
    axes[0, 0].set_ylabel("NashConv, exact (discounted steps)")
    figure.supxlabel("training time (s)", fontsize=10)
    figure.suptitle(f"{title}; dotted: a fifth of the start", fontsize=11)
    write_beside(path, lambda beside: figure.savefig(beside, dpi=130, format="png"))
    pyplot.close(figure)
