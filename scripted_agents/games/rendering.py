"""States of small games as text, and the text as a picture."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from traceback import extract_tb
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from pursuit.rendering.rendering import MARGIN, WALL, WHITE, draw_footer, font_of
from pursuit.validation import text_of
from scripted_agents.games.game import State
from scripted_agents.games.simulator import GameSimulator, GameTask

WIDEST = 60
"""Letters of a line in a picture."""
FONT, FOOTER = 15, 36
"""Of the footer of a picture, in pixels."""
SVG = "<svg"


def drawn_state(task: GameTask, state: State, warns: bool = True) -> str:
    """What `draw(state)` of a game returns, text or well-formed SVG, else the state as text.

    The warning that it failed is the same for all states, so that it is shown once.
    """
    function = getattr(task.game.source, "draw", None)
    if not callable(function):
        return text_of(state)
    try:
        drawn = function(state)
    except Exception as error:  # of the user's code
        (line,) = extract_tb(error.__traceback__, limit=-1)
        why = f"raised {type(error).__name__} ({Path(line.filename).name}:{line.lineno})"
    else:
        why = why_not_drawn(drawn)
    if why and warns:
        name = type(task.game.source).__name__
        warnings.warn(f"draw(state) of {name} {why}; such states are shown as text", stacklevel=2)
    return text_of(state if why else drawn)


def why_not_drawn(drawn: object) -> str:
    """Why this is neither a text nor well-formed SVG; empty if it is."""
    if not isinstance(drawn, str):
        return f"returned a value of type {type(drawn).__name__}, not a text"
    if drawn.lstrip().startswith(SVG):
        try:
            ElementTree.fromstring(drawn.lstrip())
        except ElementTree.ParseError:
            return "returned SVG that is not well-formed"
    return ""


@dataclass(frozen=True)
class StateScene:
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

    def draw(self, size: int = 480) -> NDArray[np.uint8]:
        """[height, width, 3] uint8, the text in RGB, in columns of equal width.

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
        return np.array(image)


def scene_of(simulator: GameSimulator, game: int = 0) -> StateScene:
    """The scene of one game; SVG of the function `draw` is left out."""
    task, state = simulator.task, simulator.task.game.states[simulator.state[game]]
    drawn = drawn_state(task, state)
    shown = text_of(state) if drawn.lstrip().startswith(SVG) else drawn
    return StateScene(shown, int(simulator.steps[game]), task.max_steps)
