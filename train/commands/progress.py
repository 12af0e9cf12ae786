"""Long work on the terminal: a live bar with lines above it, or lines alone elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressLines:
    """A bar on a terminal, and a line for every `say`; enter it while the work goes on."""

    def __init__(self) -> None:
        self.console = Console()
        self.live = self.console.is_terminal
        self.progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            console=self.console,
            disable=not self.live,
        )
        self.task = self.progress.add_task("learning", total=1.0)

    def __enter__(self) -> Self:
        self.progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def advance(self, share: float) -> None:
        """Move the bar to a share of the work in [0, 1]."""
        self.progress.update(self.task, completed=share)

    def say(self, parts: Sequence[str]) -> None:
        """Print a line of these parts."""
        line = "  ".join(parts)
        if self.live:
            self.progress.console.print(line, highlight=False)
        else:
            print(line, flush=True)
