"""What all figures share: the backend, the palette, the frame, and how they are saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from train.files import write_beside

# Okabe and Ito's palette: distinct for colour-blind readers, and in print.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F", "#000000")
BLUE, ORANGE, GREEN, PINK, _, _, GREY, BLACK = PALETTE


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


def save(figure: Any, path: Path, dpi: int = 130) -> None:
    """Write a figure as .png, atomically, and close it."""
    write_beside(path, lambda beside: figure.savefig(beside, dpi=dpi, format="png"))
    pyplot().close(figure)
