"""Seconds until commands have ended, with an empty cache of kernels and with a full one.

python tools/benchmarks/bench_start.py [--turns 3] [--only chase]
python tools/benchmarks/bench_start.py --against 501f81b

Prints a table in Markdown, as in docs/results/data/speed/README.md: seconds of the processor, of a
command with its children, and of the clock, medians. `--against` measures another version, a folder
or a git revision, in turns with this one, and prints its seconds and the median of the ratios.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from time import perf_counter

from in_turns import ROOT, add_options, checkout

from train.machine import processor

PURSUIT = [sys.executable, "-m", "pursuit"]
SHORT = "--frames 20000 --no-report"
FIRST = {
    "chase": f"train {SHORT}",
    "maze with goals": f"train --task maze --num-goals 3 {SHORT}",
    "escape": f"train --task escape {SHORT}",
    "self-play": f"self-play {SHORT}",
    "team": f"train --algorithm ippo --num-chasers 2 {SHORT}",
}
AGAIN = ["train --frames 20000", f"train {SHORT}", "train --help", "--help", "--version", "demo"]
IMPORTS = ["pursuit", "stable_baselines3", "pettingzoo.sisl.pursuit_v5"]
CASES = {
    **{
        f"first {name}, `pursuit {line}`": [*PURSUIT, *line.split()] for name, line in FIRST.items()
    },
    **{f"again, `pursuit {line}`": [*PURSUIT, *line.split()] for line in AGAIN},
    "again, an unknown option": [*PURSUIT, "train", "--bogus"],
    **{f"`import {name}`": [sys.executable, "-c", f"import {name}"] for name in IMPORTS},
}
"""Commands by name; "first" are measured with an empty cache of kernels."""


def seconds(name: str, source: Path, scratch: Path, cache: str) -> tuple[float, float] | None:
    """Seconds of the processor and of the clock; None where a version has no such command."""
    no_screen = {"DISPLAY": "", "WAYLAND_DISPLAY": "", "PYTHONPATH": str(source)}
    with tempfile.TemporaryDirectory(dir=scratch) as fresh:
        environment = {**os.environ, **no_screen}
        environment["NUMBA_CACHE_DIR"] = fresh if name.startswith("first") else cache
        before, began = getrusage(RUSAGE_CHILDREN), perf_counter()
        done = subprocess.run(CASES[name], cwd=scratch, env=environment, capture_output=True)
        wall, after = perf_counter() - began, getrusage(RUSAGE_CHILDREN)
    if done.returncode != (2 if "unknown" in name else 0):
        return None
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, wall


def row(name: str, sources: list[Path], scratch: Path, turns: int) -> list[str]:
    """The cells of a case; of other libraries only the time of this version."""
    sources = sources if name.startswith(("first", "again", "`import pursuit`")) else sources[:1]
    caches = [str(scratch / f"cache{number}") for number, _ in enumerate(sources)]
    pairs = list(zip(sources, caches, strict=True))
    if not name.startswith("first"):  # compiles
        for source, cache in pairs:
            seconds(name, source, scratch, cache)
    found = [
        [seconds(name, source, scratch, cache) for source, cache in pairs] for _ in range(turns)
    ]
    cells = [name]
    for version in zip(*found, strict=True):
        known = [each for each in version if each]
        cells += [f"{median(part):.2f}" for part in zip(*known, strict=True)] or ["", ""]
    both = [[each[0] for each in turn if each] for turn in found]
    if all(len(each) == 2 for each in both):
        cells.append(f"{median(now / then for now, then in both):.2f}")
    return cells


def main() -> None:
    """Measure, and print a row for every command."""
    parser = argparse.ArgumentParser(description=__doc__)
    add_options(parser, turns=3)
    given = parser.parse_args()
    with ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        others = [stack.enter_context(checkout(given.against))] if given.against else []
        print(f"{processor()}, medians of {given.turns}:\n")
        head = ["command", "processor s", "wall s"]
        head += ["processor s before", "wall s before", "ratio"] if others else []
        print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
        for name in CASES:
            if given.only in name:
                cells = row(name, [ROOT, *others], scratch, given.turns)
                cells += [""] * (len(head) - len(cells))
                print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
