"""Attack everything that a user can reach, for five minutes: `make campaign`.

2000 maze texts, 300 commands with nonsense in them, 40 runs killed at any moment and carried on,
500 folders with a damaged or hostile file. What is promised: no traceback, no code of a file run,
no dead end, exit status 2 with one line (or the one that the README promises), and a run that was
killed ends bit for bit as one that was not. Exit status 1 where anything is otherwise.

    python tests/campaign/campaign.py --part commands --only 17 --seed 0     one case again
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


def one_case(part: str, number: int, seed: int, room: Path) -> tuple[str, list[str]]:
    """Case `number` of a part: what it was, and what is wrong with it."""
    random = Random(f"{seed} {part} {number}")
    folder = room / f"{part}-{number}"
    rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        if part == "mazes":
            return mazes.case(random, folder)
        if part == "kills":
            return kills.case(random, folder, number)
        attack = commands.case if part == "commands" else damage.case
        return attack(random, folder, room / "stock")
    except Exception as error:
        return "the case itself", [f"{type(error).__name__}: {error}"]
    finally:
        rmtree(folder, ignore_errors=True)


def work(numbers: list[tuple[str, int]], seed: int, room: Path, until: float, out: object) -> None:
    """Do these cases, and put what they brought into the queue `out`."""
    for part, number in numbers:
        if monotonic() > until:
            break
        out.put((part, number, *one_case(part, number, seed, room)))  # type: ignore[attr-defined]
    out.put(None)  # type: ignore[attr-defined]


def main() -> int:
    """Do all cases, or those asked for; 1 where anything is not as promised."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--part", choices=list(PARTS), help="this part only")
    parser.add_argument("--only", type=int, help="this case of the part only")
    parser.add_argument("--seed", type=int, default=0, help="of all cases (default: 0)")
    parser.add_argument("--cases", type=float, default=1.0, help="share of the cases (default: 1)")
    parser.add_argument("--seconds", type=float, default=300.0, help="the bound (default: 300)")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes at a time")
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
        room = Path(temporary)
        prepare(room)
        damage.make_stock(room / "stock")
        queue = context.SimpleQueue()
        # Every worker has a room of its own for the kinds of killed runs, which it compares with.
        shares = [
            [c for i, c in enumerate(chosen) if _worker(c, i, given.workers) == w]
            for w in range(given.workers)
        ]
        workers = [
            context.Process(
                target=work, args=(share, given.seed, room, began + given.seconds, queue)
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
    print(f"{monotonic() - began:.0f} s  {_counts(done, chosen)}: {len(faults)} not as promised")
    if sum(done.values()) < len(chosen):
        print("not all were done in the time; give --seconds more")
    return int(bool(faults) or sum(done.values()) < len(chosen))


def _worker(case: tuple[str, int], index: int, workers: int) -> int:
    """Which worker does a case: all kills of one kind go to the same."""
    part, number = case
    return (number % len(kills.KINDS) if part == "kills" else index) % workers


def _counts(done: dict[str, int], chosen: list[tuple[str, int]]) -> str:
    asked = {part: sum(p == part for p, _ in chosen) for part in PARTS}
    return ", ".join(f"{part} {done[part]} of {asked[part]}" for part in PARTS if asked[part])


if __name__ == "__main__":
    sys.exit(main())
