"""Tables of results: the same rows as Markdown, CSV, TeX and on the terminal."""

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

from train.files import write_csv, write_text

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
        columns: what people read of them, in Markdown, in TeX and on the terminal.
    """

    rows: list[Row]
    columns: list[Column] = field(default_factory=list)

    def cells(self) -> list[list[str]]:
        """The texts of all rows, as Markdown and TeX show them before they escape anything."""
        return [[column.cell(row) for column in self.columns] for row in self.rows]

    def markdown(self) -> str:
        """A table of Markdown, without a newline at its end."""
        heads = [in_markdown(column.head) for column in self.columns]
        sides = ("---|" if column.left else "---:|" for column in self.columns)
        lines = ["| " + " | ".join(heads) + " |", "|" + "".join(sides)]
        lines += ["| " + " | ".join(map(in_markdown, cells)) + " |" for cells in self.cells()]
        return "\n".join(lines)

    def tex(self) -> str:
        """A `tabular` of LaTeX with the rules of the package booktabs, for `\\input` in a table."""
        form = "".join("l" if column.left else "r" for column in self.columns)
        lines = [
            r"% needs \usepackage{booktabs}; where it is too wide, also graphicx, and then",
            r"% \resizebox{\linewidth}{!}{\input{THIS FILE}}",
            rf"\begin{{tabular}}{{{form}}}",
            r"\toprule",
            " & ".join(in_tex(column.head) for column in self.columns) + r" \\",
            r"\midrule",
            *(" & ".join(map(in_tex, cells)) + r" \\" for cells in self.cells()),
            r"\bottomrule",
            r"\end{tabular}",
        ]
        return "\n".join(lines) + "\n"

    def write(self, folder: Path, stem: str = "table") -> None:
        """Write `STEM.csv` and `STEM.tex` into a folder, atomically."""
        write_csv(folder / f"{stem}.csv", self.rows)
        write_text(folder / f"{stem}.tex", self.tex())


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


_TEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\char`\"{}",
    "−": "$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "∞": r"$\infty$",
    "→": r"$\rightarrow$",
    "–": "--",
    "—": "---",
    "…": r"\ldots{}",
    "`": r"\textasciigrave{}",
    **{c: "\\" + c for c in "&%$#_{}"},
    **{c: f"{{{c}}}" for c in "[]"},  # after \\ a bracket would be an optional argument
}
_MINUS = re.compile(r"(?<![\w.)\]-])-(?=\d)")


def in_tex(text: str) -> str:
    """A text as LaTeX shows it, letter by letter: nothing in it is a command.

    Minus signs before numbers are set as such. Letters beyond those of pdfLaTeX's fonts (those of
    East Asia, say) are left as they are: LuaLaTeX and XeLaTeX set them.
    """
    plain = _MINUS.sub("−", one_line(text))
    parts = re.split(r"(-+)", plain)  # hyphens side by side would be set as a dash
    return "".join(
        "{}".join(part) if part[:1] == "-" else "".join(_TEX.get(c, c) for c in part)
        for part in parts
    )
