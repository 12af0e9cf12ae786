"""Tables of results on the terminal."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.table import Table

from train.result_table import ResultTable


def print_table(table: ResultTable, width: int = 120) -> None:
    """Print a table; `width` is that of a page where nobody sits at a terminal.

    Names that are too long for their column are broken, never cut: two must not read alike.
    """
    grid = Table(box=None, pad_edge=False)
    for column in table.columns:
        grid.add_column(column.head, justify="left" if column.left else "right", overflow="fold")
    for cells in table.cells():
        grid.add_row(*cells)
    Console(width=None if sys.stdout.isatty() else width, markup=False, emoji=False).print(grid)
