"""Comparison of the speed of two versions in separate processes, with alternating measurements.

Measurements alternate because the speed of a machine changes within minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]


@contextmanager
def checkout(version: str) -> Iterator[Path]:
    """The folder of another version: a given folder, or a temporary worktree of a revision."""
    if Path(version).is_dir():
        yield Path(version).resolve()
        return
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "worktree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", "-q", str(folder), version], check=True)
        try:
            yield folder
        finally:
            subprocess.run([*git, "remove", "--force", str(folder)], check=True)


@contextmanager
def measuring(script: str, folder: Path) -> Iterator[Callable[[object], Any]]:
    """Start a process of the version in `folder`; yields a function (case, seconds) -> time.

    The first call has None instead, and returns the names of the cases.
    """
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    command = [sys.executable, "-c", script]
    with subprocess.Popen(command, cwd=folder, env=environment, **pipes) as process:

        def ask(case: object) -> Any:
            if case is not None:
                process.stdin.write(json.dumps(case) + "\n")
                process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield ask
        process.stdin.close()


def add_options(parser: argparse.ArgumentParser, turns: int = 7) -> None:
    """Add the options of `compare`, except the seconds."""
    parser.add_argument("--against", help="another version: a folder, or a git revision")
    parser.add_argument("--turns", type=int, default=turns, help="measurements per version")
    parser.add_argument("--only", default="", help="cases with this in their names")


def compare(
    script: str, version: str, seconds: float, turns: int, only: str, what: str = "ns per game step"
) -> None:
    """Print the least time of both versions, and the median of the ratios now / then.

    Args:
        script: Python code for both versions, so it uses only names that exist in both. It prints
            its cases as a JSON list, and a time for every line [case, seconds] that it reads.
        version: a folder, or a git revision.
        seconds: of each measurement.
        turns: number of measurements per version.
        only: cases with this in their names.
        what: unit of the times.
    """
    with (
        checkout(version) as folder,
        measuring(script, ROOT) as now,
        measuring(script, folder) as then,
    ):
        names = now(None)
        then(None)
        print(f"{what}, the minimum of {turns} measurements; the median of their ratios")
        print(f"{'':<36}{'now':>12}{version[-24:]:>26}{'ratio':>8}")
        for name in names:
            if only not in name:
                continue
            for version_of in (now, then):
                version_of((name, 0.01))  # compiles
            found = np.array([(now((name, seconds)), then((name, seconds))) for _ in range(turns)])
            least, ratio = found.min(axis=0), np.median(found[:, 0] / found[:, 1])
            print(f"{name:<36}{least[0]:>12.1f}{least[1]:>26.1f}{ratio:>8.2f}", flush=True)
