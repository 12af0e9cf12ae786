"""What all figures share: the backend, the palette, the frame, the axis of training time, and how
they are saved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pursuit.declared import one_of
from pursuit.maze import Maze
from train.files import write_beside

FORMATS = ("pdf", "svg", "png")
""".png is what pages show; the other two hold lines and letters, as journals ask for."""
UNITS = ("frames", "seconds")
"""What training time is counted in."""

# Okabe and Ito's palette: distinct for colour-blind readers, and in print.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
BLUE, ORANGE, GREEN, PINK, _, _, GREY, BLACK = PALETTE
KINK = 0.1
"""Per cent below which axes of gaps are linear: far below what is read from them."""


def pyplot() -> Any:
    """Matplotlib's pyplot, drawing to files; imported here, as it takes half a second."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def tidy(axis: Any) -> None:
    """No frame above and on the right, and a faint grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, lw=0.6)


def plain_numbers(axis: Any) -> None:
    """Numbers as they are, not as powers of ten, on a logarithmic axis (x or y)."""
    from matplotlib.ticker import LogFormatter, ScalarFormatter

    axis.set_major_formatter(ScalarFormatter())
    axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))


def short_numbers(axis: Any) -> None:
    """Numbers without needless digits on an axis (x or y)."""
    from matplotlib.ticker import FormatStrFormatter

    axis.set_major_formatter(FormatStrFormatter("%g"))


def draw_walls(axis: Any, maze: Maze) -> None:
    """The walls of a maze as lines; cell (row, column) has its middle at x = column, y = row."""
    steps = {0: (0, -0.5), 1: (0, 0.5), 2: (0.5, 0), 3: (-0.5, 0)}
    for cell in range(maze.num_cells):
        x, y = maze.columns[cell], maze.rows[cell]
        for action, (dx, dy) in steps.items():
            if maze.neighbors[cell, action] == cell:
                ends = (
                    ([x - 0.5, x + 0.5], [y + dy] * 2) if dy else ([x + dx] * 2, [y - 0.5, y + 0.5])
                )
                axis.plot(*ends, color="#222222", lw=2.2, solid_capstyle="round")


@dataclass(frozen=True)
class Look:
    """How figures are to be drawn, where a command lets one choose.

    Attributes:
        formats: in which they are saved beside their own.
        x: what training time is counted in, frames or seconds; None is each figure's own choice.
        log: whether the axis of training time is logarithmic.

    Raises:
        ValueError: an unknown format or unit.
    """

    formats: tuple[str, ...] = ()
    x: str | None = None
    log: bool = False

    def __post_init__(self) -> None:
        for name in self.formats:
            one_of("format", name, FORMATS)
        if self.x is not None:
            one_of("x", self.x, UNITS)


PLAIN = Look()


def names_of(name: str, look: Look) -> list[str]:
    """The names of all the files of a figure of this name: its own, and those in other formats."""
    path = Path(name)
    others = [path.with_suffix(f".{form}").name for form in look.formats]
    return list(dict.fromkeys([path.name, *others]))


def time_scale(unit: str) -> float:
    """What seconds or frames are multiplied by on an axis."""
    return 1e-6 if unit == "frames" else 1.0


def time_head(unit: str) -> str:
    """What that axis is called."""
    return "frames (millions)" if unit == "frames" else "training time (s)"


def time_axis(axis: Any, log: bool) -> None:
    """Make x of an axis logarithmic, with plain numbers, if asked to."""
    if not log:
        return
    from matplotlib.ticker import LogLocator, NullFormatter

    axis.set_xscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
    short_numbers(axis.xaxis)
    axis.xaxis.set_minor_formatter(NullFormatter())


def save(figure: Any, path: Path, dpi: int = 130, formats: Sequence[str] = ()) -> None:
    """Write a figure atomically, in the format of its suffix and in `formats` beside it; close it.

    The same figure makes the same bytes: without a date, and its letters embedded as they are (in
    .pdf as TrueType, in .svg as text that can be searched).

    Raises:
        ValueError: a suffix that is none of `FORMATS`.
    """
    import matplotlib

    one_of("format of a figure", path.suffix.lstrip("."), FORMATS)
    dates: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    fonts = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "pursuit"}
    for form in dict.fromkeys([path.suffix.lstrip("."), *formats]):
        write = partial(figure.savefig, dpi=dpi, format=form, metadata=dates.get(form))
        with matplotlib.rc_context(fonts):
            write_beside(path.with_suffix(f".{form}"), write)
    pyplot().close(figure)
