"""Runs that are killed at random moments: one command resumes each to the same result."""

from __future__ import annotations

import json
import signal
from functools import cache
from pathlib import Path
from random import Random
from shutil import rmtree
from typing import Any

import torch
from children import Outcome, call
from damage import SWEEP

CASES = 40
SMALL = "--maze 3x3 --max-steps 20 --threads 1 --num-games 16 --frames 1500 --episodes 20"
BATCH = "--minibatch-size 64"
KINDS = {
    "ppo": f"train {BATCH} {SMALL}",
    "a2c": f"train --algorithm a2c {SMALL}",
    "reinforce": f"train --algorithm reinforce {SMALL}",
    "dqn": f"train --algorithm dqn {SMALL} --learning-starts 200",
    "cross_entropy": "train --algorithm cross_entropy --maze 3x3 --max-steps 40 --threads 1 "
    "--frames 20000 --episodes 50",
    "q_learning": f"train --algorithm q_learning {SMALL}",
    "epsilon": f"train {BATCH} --curriculum opponent-epsilon {SMALL}",
    "gated": f"train {BATCH} {SMALL} --curriculum success-gated --axis opponent-epsilon "
    "--solved-within 0",
    "replay": f"train {BATCH} --curriculum level-replay --task maze --num-goals 2 {SMALL}",
    "self-play": f"self-play {BATCH} {SMALL} --snapshots 4",
    "psro": f"self-play {BATCH} {SMALL} --snapshots 4 --sampling psro",
    "frozen": f"self-play {BATCH} {SMALL} --snapshots 4 --evader astar",
    "sweep": "sweep two.toml --workers 1",
}
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
STATUSES = {signal.SIGKILL: -9, signal.SIGTERM: 143, signal.SIGINT: 130}


def case(random: Random, folder: Path, number: int) -> tuple[str, list[str]]:
    """Kill a run once or twice and resume it: the description, and the faults."""
    kind = list(KINDS)[number % len(KINDS)]
    whole, seconds = uninterrupted(kind, folder.parent / f"whole-{kind}")
    steps, faults = [kind], []
    command = first = begin(kind, folder)
    for _ in range(random.choice((1, 1, 2))):
        number_sent = random.choice(SIGNALS)
        moment = random.uniform(0.0, 1.1 * seconds)
        outcome = call(command, folder, limit=60.0, kill=(moment, number_sent))
        steps.append(f"{signal.Signals(number_sent).name} after {moment:.2f} s")
        done = 2 if "complete" in outcome.err else 0  # the previous kill was after its end
        begun = (folder / "run").exists()  # before, there may be no signal handler
        unhandled = STATUSES[number_sent] if begun else -number_sent
        faults += outcome.faults((0, done, unhandled, STATUSES[number_sent]))
        command = carry_on(kind, folder, first)
    if outcome.status != 0:
        outcome = call(command, folder, limit=60.0)
        steps.append(f"then `pursuit {' '.join(command)}`")
        faults += [f"{fault}: {outcome.last_line()}" for fault in outcome.faults((0, 2))]
        faults += dead_end(outcome, kind, folder)
    faults += [] if faults else compare(kind, whole, folder)
    return ", ".join(steps), faults


def begin(kind: str, folder: Path) -> list[str]:
    """The command that starts a run of a kind."""
    (folder / "two.toml").write_text(SWEEP)
    return [*KINDS[kind].split(), "--out", "run"]


def carry_on(kind: str, folder: Path, first: list[str]) -> list[str]:
    """The command that resumes a run, or starts it again without `config.json`."""
    if kind == "sweep" or not (folder / "run" / "config.json").exists():
        return first
    return [first[0], "--resume", "run"]


def dead_end(outcome: Outcome, kind: str, folder: Path) -> list[str]:
    """The faults of a resumed run that is not complete."""
    if outcome.status == 2 and "complete" in outcome.err and missing(kind, folder) == []:
        return []
    if outcome.status != 0:
        return [f"cannot be resumed: {outcome.last_line()}"]
    return [f"{name} is missing" for name in missing(kind, folder)]


def missing(kind: str, folder: Path) -> list[str]:
    """The missing files of complete runs, and leftover temporary files."""
    names = ["config.json", "metrics.csv", "results.json", "checkpoint.pt"]
    if kind != "sweep":
        names.append("learning_curve.png")
    found = [name for run in runs(kind, folder) for name in names if not (run / name).exists()]
    left = [str(path.name) for path in folder.rglob("*.part")]
    return found + left if runs(kind, folder) else ["a run"]


def runs(kind: str, folder: Path) -> list[Path]:
    """The folders of the runs."""
    if kind != "sweep":
        return [folder / "run"]
    return sorted(path.parent for path in (folder / "run").rglob("config.json"))


def compare(kind: str, whole: Path, folder: Path) -> list[str]:
    """The differences to the uninterrupted run; with budgets in frames, results are equal."""
    pairs = list(zip(runs(kind, whole), runs(kind, folder), strict=False))
    if not pairs:
        return ["no run"]
    faults = []
    for theirs, ours in pairs:
        if json.loads((ours / "results.json").read_text()).get("interrupted"):
            faults.append("results.json says interrupted")
        one, other = (
            torch.load(run / "checkpoint.pt", weights_only=True) for run in (theirs, ours)
        )
        faults += [f"{place} differs" for place in different(one["trainee"], other["trainee"])[:3]]
    return faults


def different(one: Any, other: Any, place: str = "trainee") -> list[str]:
    """The paths at which two states differ."""
    if type(one) is not type(other):
        return [place]
    if isinstance(one, dict):
        if one.keys() != other.keys():
            return [place]
        return [
            d
            for key in one
            if key != "seconds"  # wall time
            for d in different(one[key], other[key], f"{place}.{key}")
        ]
    if isinstance(one, list | tuple):
        if len(one) != len(other):
            return [place]
        inner = zip(one, other, strict=True)
        return [d for i, pair in enumerate(inner) for d in different(*pair, f"{place}.{i}")]
    if isinstance(one, torch.Tensor):
        same = one.shape == other.shape and torch.equal(
            one.nan_to_num() if one.is_floating_point() else one,
            other.nan_to_num() if other.is_floating_point() else other,
        )
        return [] if same else [place]
    return [] if one == other or one != one else [place]


@cache
def uninterrupted(kind: str, folder: Path) -> tuple[Path, float]:
    """The same run without a kill, and its seconds."""
    rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    outcome = call(begin(kind, folder), folder, limit=120.0)
    if outcome.status != 0:
        raise RuntimeError(f"{kind}: {outcome.last_line()}")
    return folder, outcome.seconds
