"""Tables of results as Markdown, CSV and terminal output."""

from __future__ import annotations

import re
import sys
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import floor, isfinite, log10
from pathlib import Path
from types import MappingProxyType
from typing import Any

from train.files import write_csv

Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """A column of Markdown and terminal tables.

    Attributes:
        head: its heading.
        cell: makes the plain text of a cell from a row.
        left: whether it is aligned left, for text; numbers are aligned right.
    """

    head: str
    cell: Callable[[Row], str]
    left: bool = False


@dataclass(frozen=True)
class ResultTable:
    """A table of results.

    Attributes:
        rows: plain values by name, all of which are written to CSV, unrounded.
        columns: of Markdown and terminal tables.
    """

    rows: list[Row]
    columns: list[Column] = field(default_factory=list)

    def cells(self) -> list[list[str]]:
        """The texts of all rows, not escaped."""
        return [[column.cell(row) for column in self.columns] for row in self.rows]

    def markdown(self) -> str:
        """The table in Markdown, without a final newline."""
        heads = [in_markdown(column.head) for column in self.columns]
        sides = ("---|" if column.left else "---:|" for column in self.columns)
        lines = ["| " + " | ".join(heads) + " |", "|" + "".join(sides)]
        lines += ["| " + " | ".join(map(in_markdown, cells)) + " |" for cells in self.cells()]
        return "\n".join(lines)

    def write(self, folder: Path, stem: str = "table") -> None:
        """Write `STEM.csv` into a folder, atomically."""
        write_csv(folder / f"{stem}.csv", self.rows)


def words(head: str, name: str | None = None) -> Column:
    """A column of the unformatted values of `name`, by default the heading."""
    return Column(head, lambda row: str(row[head if name is None else name]), left=True)


def numeric(head: str, name: str, form: str = "", scale: float = 1, unit: str = "") -> Column:
    """A column of formatted numbers, times `scale`; empty for a missing value or NaN."""

    def cell(row: Row) -> str:
        value = row.get(name)
        if value is None or value != value:
            return ""
        return f"{scale * value:{form}}{unit}"

    return Column(head, cell)


def with_interval(head: str, name: str, form: str = "") -> Column:
    """A column of numbers NAME with their interval from NAME_low to NAME_high, in a format, by
    default `three_digits`; empty for NaN, and without an interval where its ends are NaN."""

    def cell(row: Row) -> str:
        values = [row[f"{name}{end}"] for end in ("", "_low", "_high")]
        value, low, high = (format(each, form) if form else three_digits(each) for each in values)
        if values[0] != values[0]:
            return ""
        return value if values[1] != values[1] else f"{value} [{low}, {high}]"

    return Column(head, cell)


def three_digits(value: float) -> str:
    """A number with about three digits; "never" for infinity."""
    if value == float("inf"):
        return "never"
    size = abs(value)
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 10 else f"{value:z.2f}"


def short(value: object) -> str:
    """A setting as text; at most six digits of a float."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def in_lines(facts: Mapping[str, str], width: int) -> str:
    """Names and their values, one per line; values begin at column `width`."""
    return "\n".join(f"{name:<{width}}{text}" for name, text in facts.items())


def plain_table(rows: list[Row], heads: Mapping[str, str] = MappingProxyType({})) -> ResultTable:
    """A table of rows with equal names, their values as `plain_text`.

    Args:
        rows: at least one for a table with columns.
        heads: the headings by name of the columns whose heading is not their name.
    """

    def column(name: str) -> Column:
        return Column(heads.get(name, name), lambda row: plain_text(row[name]), left=True)

    return ResultTable(rows, [column(name) for name in rows[0]] if rows else [])


def plain_text(value: object) -> str:
    """A value as text: a number with three digits, at most four of them behind the point; of a list
    [value, low, high] the value and its interval; None is empty."""
    if isinstance(value, list):
        center, low, high = map(plain_text, value)
        return f"{center} [{low}, {high}]"
    if isinstance(value, float) and isfinite(value):
        digits = max(2 - floor(log10(abs(value))), 0) if value else 0
        return "< 0.0001" if 0.0 < value < 1e-4 else f"{value:.{min(digits, 4)}f}"
    return "" if value is None else str(value)


def print_table(table: ResultTable, width: int = 120) -> None:
    """Print a table, `width` characters wide if the output is not a terminal.

    Texts that are too long for their column are wrapped.
    """
    from rich.console import Console  # slow to import
    from rich.table import Table

    grid = Table(box=None, pad_edge=False)
    for column in table.columns:
        grid.add_column(column.head, justify="left" if column.left else "right", overflow="fold")
    for cells in table.cells():
        grid.add_row(*cells)
    Console(width=None if sys.stdout.isatty() else width, markup=False, emoji=False).print(grid)


_MARKUP = re.compile(
    r"[\\`|]"
    r"|\](?=[(\[:])"  # links and images
    r"|\*(?=\S)|(?<![^\W_])_(?=\S)"
)
_HTML = re.compile(r"<(?=[A-Za-z/!?])|&(?=[#\w]+;)|~(?=~)")


def in_markdown(text: str) -> str:
    """Escape a text for Markdown, in one line and without markup.

    It can be used in table cells, in headings, and anywhere in a paragraph except at its start.
    """
    escaped = _HTML.sub(lambda found: f"&#{ord(found[0])};", one_line(text))
    return _MARKUP.sub(r"\\\g<0>", escaped)


def one_line(text: str) -> str:
    """A text without line breaks, control characters and invisible characters."""
    kept = (" " if c.isspace() else c for c in text)
    return " ".join("".join(c for c in kept if unicodedata.category(c)[0] != "C").split())
