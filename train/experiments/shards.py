"""Shards of a study: parts of its runs, each for a command of its own, as in a job array.

The part depends on the names and budgets of the runs alone, not on what has finished. A shard
writes its rows to a file of its own, as runs-3-of-10.csv.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pursuit.validation import check


@dataclass(frozen=True)
class Shard:
    """One of the parts of a study.

    Attributes:
        number: from 1 to `count`.
        count: of the parts.
    """

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def file(self, rows: Path) -> Path:
        """The file of the rows of this shard, beside that of the whole study."""
        return rows.with_stem(f"{rows.stem}-{self.number}-of-{self.count}")

    def chosen(self, costs: Mapping[str, float]) -> set[str]:
        """The names of the runs of this shard; the sums of the costs of all shards are about equal.

        The dearest run comes first, and each goes to the shard with the least so far. Equal runs
        are dealt out in turns that start at another shard each time, so that seeds and variants
        mix.
        """
        loads, mine = [0.0] * self.count, set[str]()
        for place, name in enumerate(sorted(costs, key=lambda name: -costs[name])):
            turn = place // self.count
            least = min(range(self.count), key=lambda k: (loads[k], (k - turn) % self.count))
            loads[least] += costs[name]
            if least == self.number - 1:
                mine.add(name)
        return mine


def shard_of(text: str) -> Shard:
    """The shard of a text such as "3/10"; ValueError for others."""
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    number, count = map(int, found.groups()) if found else (0, 0)
    check(1 <= number <= count, f"shard={text!r}; give K/N, such as 3/10, with K from 1 to N")
    return Shard(number, count)


def row_files(rows: Path) -> list[Path]:
    """The existing files of the rows of a study: `rows`, and those of its shards beside it."""
    shards = rows.parent.glob(f"{rows.stem}-[0-9]*-of-[0-9]*{rows.suffix}")
    return [path for path in (rows, *sorted(shards)) if path.exists()]
