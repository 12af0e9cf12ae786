"""Randomised robustness tests of the command line, for five minutes: `make campaign`.

There are 2000 maze texts, 300 commands with invalid arguments, 40 runs that are killed at random
moments and resumed, and 500 folders with a damaged or malicious file. Requirements: no traceback,
no code from files is run, errors are one line with exit status 2 (or a documented status), and
every killed run can be resumed to a bitwise equal result. The exit status is 1 if a case fails.

    python tools/campaign/campaign.py --part commands --only 17 --seed 0     repeat one case
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import warnings
from multiprocessing import get_context
from pathlib import Path
from random import Random
from shutil import rmtree
from time import monotonic

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

import commands
import damage
import kills
import mazes
from children import prepare

PARTS = {"mazes": mazes.CASES, "kills": kills.CASES, "damage": damage.CASES}
PARTS["commands"] = commands.CASES


def one_case(part: str, number: int, seed: int, root: Path) -> tuple[str, list[str]]:
    """Execute case `number` of a part: its description, and its faults."""
    random = Random(f"{seed} {part} {number}")
    folder = root / f"{part}-{number}"
    rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        if part == "mazes":
            return mazes.case(random, folder)
        if part == "kills":
            return kills.case(random, folder, number)
        attack = commands.case if part == "commands" else damage.case
        return attack(random, folder, root / "stock")
    except Exception as error:
        return "the case itself", [f"{type(error).__name__}: {error}"]
    finally:
        rmtree(folder, ignore_errors=True)


def work(numbers: list[tuple[str, int]], seed: int, root: Path, until: float, out: object) -> None:
    """Execute these cases, and put their results into the queue `out`."""
    for part, number in numbers:
        if monotonic() > until:
            break
        out.put((part, number, *one_case(part, number, seed, root)))  # type: ignore[attr-defined]
    out.put(None)  # type: ignore[attr-defined]


def main() -> int:
    """Execute all or the selected cases; returns 1 if one fails."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--part", choices=list(PARTS), help="execute only this part")
    parser.add_argument("--only", type=int, help="execute only this case of the part")
    parser.add_argument("--seed", type=int, default=0, help="seed of all cases (default: 0)")
    parser.add_argument("--cases", type=float, default=1.0, help="share of the cases (default: 1)")
    parser.add_argument("--seconds", type=float, default=300.0, help="time limit (default: 300)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="parallel processes")
    given = parser.parse_args()
    began = monotonic()
    warnings.simplefilter("ignore")
    chosen = [(p, n) for p in PARTS for n in range(round(PARTS[p] * given.cases))]
    if given.part is not None:
        chosen = [(p, n) for p, n in chosen if p == given.part]
        if given.only is not None:
            chosen = [(given.part, given.only)]
    context, faults, done = get_context("fork"), [], dict.fromkeys(PARTS, 0)
    with tempfile.TemporaryDirectory(prefix="pursuit-campaign-") as temporary:
        root = Path(temporary)
        prepare(root)
        damage.make_stock(root / "stock")
        queue = context.SimpleQueue()
        # Every worker has its own uninterrupted runs for comparison.
        shares = [
            [c for i, c in enumerate(chosen) if _worker(c, i, given.workers) == w]
            for w in range(given.workers)
        ]
        workers = [
            context.Process(
                target=work, args=(share, given.seed, root, began + given.seconds, queue)
            )
            for share in shares
        ]
        for worker in workers:
            worker.start()
        ended, shown = 0, monotonic()
        while ended < len(workers):
            brought = queue.get()
            if brought is None:
                ended += 1
                continue
            part, number, what, wrong = brought
            done[part] += 1
            if wrong:
                faults.append(brought)
                print(f"{part} {number}: {what}\n    " + "\n    ".join(wrong), flush=True)
            if monotonic() - shown > 10.0:
                shown = monotonic()
                print(f"{shown - began:4.0f} s  {_counts(done, chosen)}", flush=True)
        for worker in workers:
            worker.join()
    print(f"{monotonic() - began:.0f} s  {_counts(done, chosen)}: {len(faults)} cases failed")
    if sum(done.values()) < len(chosen):
        print("the time limit was reached before all cases were done; raise --seconds")
    return int(bool(faults) or sum(done.values()) < len(chosen))


def _worker(case: tuple[str, int], index: int, workers: int) -> int:
    """The worker of a case: the same one for all kills of one kind."""
    part, number = case
    return (number % len(kills.KINDS) if part == "kills" else index) % workers


def _counts(done: dict[str, int], chosen: list[tuple[str, int]]) -> str:
    asked = {part: sum(p == part for p, _ in chosen) for part in PARTS}
    return ", ".join(f"{part} {done[part]} of {asked[part]}" for part in PARTS if asked[part])


if __name__ == "__main__":
    sys.exit(main())
