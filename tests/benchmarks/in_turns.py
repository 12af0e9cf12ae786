"""Two versions that take turns, each in a process of its own: machines change within minutes."""

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
    """The folder of another version: a folder as it is, or a revision in a worktree for now."""
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
    """Asks a process of the version in `folder`: (case, seconds) -> a time; first None."""
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
    """What `compare` is asked for on the command line, but for the seconds."""
    parser.add_argument("--against", help="another version: a folder, or a git revision")
    parser.add_argument("--turns", type=int, default=turns, help="of both versions")
    parser.add_argument("--only", default="", help="cases with this in their names")


def compare(
    script: str, version: str, seconds: float, turns: int, only: str, what: str = "ns a game step"
) -> None:
    """Print the least time now and then, and the median over turns of now / then.

    Args:
        script: Python that runs under either version, so it keeps to what both know. It prints its
            cases as a JSON list; for every line [case, seconds] that it reads, a time.
        version: a folder, or a git revision.
        seconds: of each measurement.
        turns: of both versions.
        only: cases with this in their names.
        what: the times are.
    """
    with (
        checkout(version) as folder,
        measuring(script, ROOT) as now,
        measuring(script, folder) as then,
    ):
        names = now(None)
        then(None)
        print(f"{what}, the least of {turns} turns; the median of their ratios")
        print(f"{'':<36}{'now':>12}{version[-24:]:>26}{'ratio':>8}")
        for name in names:
            if only not in name:
                continue
            for version_of in (now, then):
                version_of((name, 0.01))  # compiles
            found = np.array([(now((name, seconds)), then((name, seconds))) for _ in range(turns)])
            least, ratio = found.min(axis=0), np.median(found[:, 0] / found[:, 1])
            print(f"{name:<36}{least[0]:>12.1f}{least[1]:>26.1f}{ratio:>8.2f}", flush=True)
