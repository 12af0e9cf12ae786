"""Figures: style, interval plots, heat maps, mazes, and saving."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.files import write_atomically
from pursuit.mazes.maze import Maze
from pursuit.validation import one_of

if TYPE_CHECKING:  # slow to import
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

FORMATS = ("png", "svg", "pdf")
""".png is what pages show; .svg and .pdf hold lines and letters, as journals ask for."""

UNITS = ("frames", "seconds")
"""Units of training time."""

# Okabe and Ito's palette: distinct for colour-blind readers, and in print.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY, GREY, BLACK = PALETTE
KINK = 0.1
"""Gaps below this number of per cent are on the linear part of the axis."""
LABEL_WIDTH = 24
"""Characters per line of a label."""


def pyplot() -> ModuleType:
    """Matplotlib's pyplot, drawing to files; imported here, as it takes half a second."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def tidy(axis: Axes) -> None:
    """Remove the upper and right frame, and add a faint grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, lw=0.6)


def log_axis(axis: Axes, which: str) -> None:
    """Make the axis x or y logarithmic, with plain numbers."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    getattr(axis, f"set_{which}scale")("log")
    one = getattr(axis, f"{which}axis")
    low, high = getattr(axis, f"get_{which}lim")()
    if high < 1e4 * low:  # else a tick for each power of ten is enough
        one.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
    one.set_major_formatter(FormatStrFormatter("%g"))
    one.set_minor_formatter(NullFormatter())


def gap_axis(axis: Axes, which: str, values: ArrayLike) -> None:
    """Make the axis x or y fit these gaps in per cent: linear near 0, logarithmic beyond."""
    from matplotlib.ticker import FormatStrFormatter

    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    getattr(axis, f"set_{which}scale")("symlog", linthresh=KINK)
    getattr(axis, f"set_{which}lim")(1.5 * min(low, 0.0) - KINK / 5, 1.6 * max(high, 0.0) + 0.2)
    getattr(axis, f"{which}axis").set_major_formatter(FormatStrFormatter("%g"))
    line = axis.axhline if which == "y" else axis.axvline
    line(0, color="#333333", lw=1.0, ls=":")


def draw_walls(axis: Axes, maze: Maze) -> None:
    """Draw the walls of a maze, or the edges of a graph.

    A cell has its centre at x = column, y = row of `maze.picture`.
    """
    if not maze.is_grid:
        for cell, action in np.argwhere(maze.neighbors != np.arange(maze.num_cells)[:, None]):
            y, x = maze.picture[[cell, maze.neighbors[cell, action]]].T
            axis.plot(x, y, color="#b0b4ba", lw=1.5, zorder=0)
        return
    steps = {0: (0, -0.5), 1: (0, 0.5), 2: (0.5, 0), 3: (-0.5, 0)}
    for cell in range(maze.num_cells):
        x, y = maze.columns[cell], maze.rows[cell]
        for action, (dx, dy) in steps.items():
            if maze.neighbors[cell, action] == cell:
                across, down = [x - 0.5, x + 0.5], [y - 0.5, y + 0.5]
                ends = (across, [y + dy] * 2) if dy else ([x + dx] * 2, down)
                axis.plot(*ends, color="#222222", lw=2.2, solid_capstyle="round")


def draw_cells(
    axis: Axes, maze: Maze, values: NDArray[np.float64], title: str, **style: Any
) -> ScalarMappable:
    """Draw the cells of a maze in the colours of their values, and its walls; returns the image.

    Args:
        axis: to draw on.
        maze: the maze.
        values: [cells]; a cell of NaN stays white.
        title: of the axis.
        **style: as `imshow` takes it.
    """
    if maze.is_grid:
        grid = np.full((maze.height, maze.width), np.nan)
        grid[maze.rows, maze.columns] = values
        image: ScalarMappable = axis.imshow(grid, **style)
    else:
        y, x = maze.picture.T
        image = axis.scatter(x, y, c=values, s=60, **style)
        axis.invert_yaxis()
    draw_walls(axis, maze)
    axis.set_title(title, fontsize=10)
    axis.set_aspect("equal")
    axis.axis("off")
    return image


def in_legend(label: str | None) -> str | None:
    """A label with a blank before `_`, with which Matplotlib would leave it out of legends."""
    return f" {label}" if label is not None and label.startswith("_") else label


def legend_beside(figure: Figure, axes: Iterable[Axes]) -> None:
    """Draw one legend of these axes beside all axes, each label once."""
    handles: dict[str, Artist] = {}
    for axis in axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    where = "outside right upper"
    figure.legend(handles.values(), handles.keys(), loc=where, frameon=False, fontsize=9)


def time_scale(unit: str) -> float:
    """The factor from seconds or frames to the unit of the axis."""
    return 1e-6 if unit == "frames" else 1.0


def save(figure: Figure, path: Path, also: str | None = None, dpi: int = 130) -> None:
    """Write a figure atomically, in the format of its suffix and that of `also`, and close it.

    Equal figures give equal bytes: files contain no date, and .svg contains text as text. Names
    are drawn as they are: a dollar sign begins no formula.

    Raises:
        ValueError: the suffix is not in `FORMATS`.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.text import Text

    own = path.suffix.lstrip(".")
    one_of("format of a figure", own, FORMATS)
    figure.set_dpi(dpi)
    for text in figure.findobj(Text):
        text.set_parse_math(False)
    settings = {"svg.fonttype": "none", "svg.hashsalt": "pursuit", "text.parse_math": False}
    settings["pdf.fonttype"] = 42  # whole fonts, as journals ask for
    for form in dict.fromkeys((own, also or own)):
        # `Figure.savefig` draws twice: first only to find the layout.
        write: Any = FigureCanvasAgg(figure).print_png
        if form == "svg":
            write = partial(_write_svg, FigureCanvasSVG(figure))
        elif form == "pdf":
            write = partial(FigureCanvasPdf(figure).print_pdf, metadata={"CreationDate": None})
        with matplotlib.rc_context(settings):
            write_atomically(path.with_suffix(f".{form}"), write)
        figure.set_layout_engine("none")  # the layout is found; it takes as long as drawing
    pyplot().close(figure)


def _write_svg(canvas: FigureCanvasSVG, path: Path) -> None:
    """A picture without background, which has that of the page."""
    patches = [canvas.figure.patch, *(axis.patch for axis in canvas.figure.axes)]
    for patch in patches:
        patch.set_visible(False)
    canvas.print_svg(path, metadata={"Date": None})
    for patch in patches:
        patch.set_visible(True)


# -- intervals -------------------------------------------------------------------------------------


class PlottedEstimate(NamedTuple):
    """A value with its interval (NaN if unknown), on a line of an interval plot.

    Attributes:
        line: name of the line.
        value, low, high: the value and its interval.
        points: values of single runs.
        color: of all of them.
        group: in the legend; groups are drawn side by side on a line.
    """

    line: str
    value: float
    low: float
    high: float
    points: Sequence[float] = ()
    color: str = BLUE
    group: str | None = None


def draw_intervals(
    path: Path,
    panels: Mapping[str, tuple[str, Sequence[PlottedEstimate]]],
    title: str,
    ylabel: str = "",
    also: str = "svg",
    note: str = "",
) -> None:
    """Draw an interval plot: values with their intervals, one per line.

    Args:
        path: of the figure.
        panels: by label of the axis: its scale ("linear", "log", "ratio" with a line at 1, "gap",
            or "share" from 0 to 1), and the values.
        title: of the figure.
        ylabel: label of the lines.
        also: as of `save`.
        note: text below the figure.
    """
    everything = [each for _, estimates in panels.values() for each in estimates]
    lines = list(dict.fromkeys(each.line for each in everything))
    groups = list(dict.fromkeys(each.group for each in everything))
    height = 1.3 + (0.3 + 0.12 * len(groups)) * len(lines)
    size = (2.8 + 3.6 * len(panels), max(height, 2.6))
    figure, axes = pyplot().subplots(
        1, len(panels), figsize=size, sharey=True, squeeze=False, layout="constrained"
    )
    for axis, (label, (scale, estimates)) in zip(axes[0], panels.items(), strict=True):
        for each in estimates:
            shift = 0.6 * ((groups.index(each.group) + 0.5) / len(groups) - 0.5)
            at = lines.index(each.line) + shift
            style = {"color": each.color}
            ends = [each.low, each.high]
            axis.plot(ends, [at, at], lw=5, alpha=0.35, solid_capstyle="butt", **style)
            axis.plot(each.points, [at] * len(each.points), "|", ms=9, **style)
            axis.plot(each.value, at, "o", ms=6, label=in_legend(each.group), **style)
        if scale == "gap":
            gap_axis(axis, "x", [point for each in estimates for point in each.points])
        elif scale in ("log", "ratio"):
            log_axis(axis, "x")
            if scale == "ratio":
                axis.axvline(1.0, color="#333333", lw=1.0, ls=":")
        elif scale == "share":
            axis.set_xlim(-0.03, 1.03)
            axis.axvline(0.5, color="#333333", lw=1.0, ls=":")
        axis.set_xlabel(label)
        tidy(axis)
    axes[0, 0].set_yticks(range(len(lines)), lines)
    axes[0, 0].set_ylim(len(lines) - 0.5, -0.5)
    axes[0, 0].set_ylabel(ylabel)
    if len(groups) > 1:
        legend_beside(figure, axes[0, :1])
    figure.suptitle(title, fontsize=11)
    figure.supxlabel(fill(note, int(12 * size[0])), fontsize=8)
    save(figure, path, also)


# -- matrices --------------------------------------------------------------------------------------


def draw_matrix(
    path: Path,
    values: NDArray[np.float64],
    rows: tuple[str, Sequence[str]],
    columns: tuple[str, Sequence[str]],
    label: str,
    title: str,
) -> None:
    """Draw a heat map with numbers, coloured on a logarithmic scale if all are above 0.

    Args:
        path: of the figure.
        values: [rows, columns].
        rows, columns: label of the axis, and the name of each row or column.
        label: of the values.
        title: of the figure.
    """
    down, across = values.shape
    figure, axis = pyplot().subplots(
        figsize=(3.6 + 0.85 * across, 1.8 + 0.55 * down), layout="constrained"
    )
    positive = bool((values > 0.0).all())
    norm, digits = ("log", 1) if positive else ("linear", 2)
    image = axis.imshow(values, cmap="viridis", aspect="auto", norm=norm)
    for (i, j), value in np.ndenumerate(values):
        color = "white" if image.norm(value) < 0.6 else "black"
        axis.text(j, i, f"{value:z.{digits}f}", ha="center", va="center", fontsize=9, color=color)
    names = [[fill(name, LABEL_WIDTH) for name in each] for _, each in (rows, columns)]
    axis.set_yticks(range(down), names[0])
    axis.set_xticks(range(across), names[1], rotation=30, ha="right")
    axis.set_ylabel(rows[0])
    axis.set_xlabel(columns[0])
    ticks = round_numbers(float(values.min()), float(values.max())) if positive else None
    figure.colorbar(image, label=label, ticks=ticks, format="%g").ax.minorticks_off()
    axis.set_title(title, fontsize=11)
    save(figure, path, "svg")


def round_numbers(low: float, high: float) -> list[float]:
    """Some numbers of one or two digits from `low` to `high`, for a logarithmic scale."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    if high > 5.0 * low:
        subs = (1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)
        locator: Any = LogLocator(subs=subs, numticks=7)
    else:
        locator = MaxNLocator(5, steps=[1, 2, 5, 10])
    return [tick for tick in locator.tick_values(low, high).tolist() if low <= tick <= high]
