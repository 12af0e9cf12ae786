"""Games whose picture is a text."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import Any

from PIL import Image, ImageDraw

from pursuit.rendering.rendering import MARGIN, WALL, WHITE, Drawable, draw_footer, font_of
from pursuit.simulator.batch import Batch

WIDEST = 60
"""Letters of a line in a picture."""
FONT, FOOTER = 15, 36
"""Of the footer of a picture, in pixels."""


@dataclass(frozen=True)
class TextScene(Drawable):
    """One state of a game as text.

    Attributes:
        shown: the text of the state.
        steps, max_steps: steps of the episode, and its maximal length.
        caption: text for the footer of a picture.
    """

    shown: str
    steps: int
    max_steps: int
    caption: str = ""

    @property
    def footer(self) -> str:
        """The step count, as in `step 12 / 200`."""
        return f"step {self.steps} / {self.max_steps}"

    def text(self) -> str:
        """The state, then the step count."""
        return f"{self.shown.rstrip()}\n{self.footer}\n"

    def picture(self, size: int = 480) -> Image.Image:
        """The text in columns of equal width; both sides are even numbers.

        Lines of more than `WIDEST` letters are broken. All pictures of one size are equally large.
        """
        rows = self.shown.expandtabs().rstrip().splitlines()
        lines = [part for row in rows for part in wrap(row, WIDEST, drop_whitespace=False) or [""]]
        side = size + size % 2
        image = Image.new("RGB", (side, side + FOOTER), WHITE)
        widest, inside = max(map(len, lines), default=1), size - 2 * MARGIN
        height = min(inside / (0.6 * max(widest, 1)), inside / (1.2 * max(len(lines), 1)), 32.0)
        pen, font = ImageDraw.Draw(image), font_of(max(4, int(height)))
        for row, line in enumerate(lines):
            for column, letter in enumerate(line):
                x, y = 0.6 * height * (column + 0.5), 1.2 * height * (row + 0.5)
                pen.text((MARGIN + x, MARGIN + y), letter, WALL, font, anchor="mm")
        draw_footer(image, side, FONT, self.footer, self.caption)
        return image


def text_scene(simulator: Batch[Any], game: int, text: str) -> TextScene:
    """The scene of one game of a batch whose state is shown as `text`."""
    most = simulator.task.max_steps * simulator.task.steps_per_round
    return TextScene(text, int(simulator.steps[game]), most)
