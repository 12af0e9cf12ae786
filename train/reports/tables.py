"""Tables of results: the same rows as Markdown, CSV and on the terminal."""

from __future__ import annotations

import re
import sys
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from train.files import write_csv

Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """One column as people read it.

    Attributes:
        head: its heading.
        cell: the text of a row's cell, in plain Unicode.
        left: whether it is set flush left, as words are; numbers stand flush right.
    """

    head: str
    cell: Callable[[Row], str]
    left: bool = False


@dataclass(frozen=True)
class ResultTable:
    """Rows of results, and how they are read.

    Attributes:
        rows: plain values by name; all of them stand in the CSV file, unrounded.
        columns: what people read of them, in Markdown and on the terminal.
    """

    rows: list[Row]
    columns: list[Column] = field(default_factory=list)

    def cells(self) -> list[list[str]]:
        """The texts of all rows, before anything in them is escaped."""
        return [[column.cell(row) for column in self.columns] for row in self.rows]

    def markdown(self) -> str:
        """A table of Markdown, without a newline at its end."""
        heads = [in_markdown(column.head) for column in self.columns]
        sides = ("---|" if column.left else "---:|" for column in self.columns)
        lines = ["| " + " | ".join(heads) + " |", "|" + "".join(sides)]
        lines += ["| " + " | ".join(map(in_markdown, cells)) + " |" for cells in self.cells()]
        return "\n".join(lines)

    def write(self, folder: Path, stem: str = "table") -> None:
        """Write `STEM.csv` into a folder, atomically."""
        write_csv(folder / f"{stem}.csv", self.rows)


def words(head: str, name: str | None = None) -> Column:
    """A column of the values called `name` (as the heading, if left out), as they are."""
    return Column(head, lambda row: str(row[head if name is None else name]), left=True)


def numeric(head: str, name: str, form: str = "", scale: float = 1, unit: str = "") -> Column:
    """A column of numbers, times `scale`, in a format; empty where a row has none, or NaN."""

    def cell(row: Row) -> str:
        value = row.get(name)
        if value is None or value != value:
            return ""
        return f"{scale * value:{form}}{unit}"

    return Column(head, cell)


def plain_table(rows: list[Row]) -> ResultTable:
    """A table of rows with the same names, as they are."""
    return ResultTable(rows, [words(name) for name in rows[0]] if rows else [])


def print_table(table: ResultTable, width: int = 120) -> None:
    """Print a table; `width` is that of a page where the output is no terminal.

    Names that are too long for their column are broken, never cut: two must not read alike.
    """
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
    """A text of others in Markdown, letter by letter: one line, nothing in it is markup.

    It may stand in a cell of a table, in a heading, and anywhere in a paragraph but at its start.
    """
    escaped = _HTML.sub(lambda found: f"&#{ord(found[0])};", one_line(text))
    return _MARKUP.sub(r"\\\g<0>", escaped)


def one_line(text: str) -> str:
    """A text without line breaks, control characters and others that show nothing."""
    kept = (" " if c.isspace() else c for c in text)
    return " ".join("".join(c for c in kept if unicodedata.category(c)[0] != "C").split())
