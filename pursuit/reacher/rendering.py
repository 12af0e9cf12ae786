"""Scenes of an arm, rendered as text and RGB arrays."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from PIL import Image, ImageDraw

from pursuit.reacher.simulator import ReacherSimulator
from pursuit.rendering.rendering import (
    BLOCKED,
    HATCH,
    MARGIN,
    ROLE_COLORS,
    WALL,
    WHITE,
    Color,
    Drawable,
    draw_footer,
)

Point = tuple[float, float]

LINK: Color = ROLE_COLORS["evader"]
TIP: Color = ROLE_COLORS["chaser"]
TARGET: Color = ROLE_COLORS["goal"]
REACHED: Color = ROLE_COLORS["runner"]
SUPERSAMPLING = 4
MIN_SIZE = 96
TEXT_ROWS, TEXT_COLUMNS = 8, 16
"""Characters from the base to the rim in the text; characters are about twice as high as wide."""


@dataclass(frozen=True)
class ArmScene(Drawable):
    """The data of a picture of one state of an arm.

    Args:
        angles: the angles of the joints in radians, relative to the link before.
        target: the position of the target; the base is at (0, 0).
        tolerance: the tip is in reach within this distance.
        steps, max_steps: steps of the episode, and its maximal length.
        held, hold: consecutive steps with the tip in reach, and how many end the episode.
        caption: text for the footer.
        trace: earlier positions of the tip, to be drawn.
    """

    angles: tuple[float, ...]
    target: Point
    tolerance: float
    steps: int
    max_steps: int
    held: int = 0
    hold: int = 1
    caption: str = ""
    trace: tuple[Point, ...] = ()

    @property
    def points(self) -> list[Point]:
        """The base, and the end of every link; the last one is the tip."""
        directions = np.cumsum(self.angles)
        steps = np.stack([np.cos(directions), np.sin(directions)], axis=1)
        return [(0.0, 0.0), *((float(x), float(y)) for x, y in steps.cumsum(axis=0))]

    @property
    def distance(self) -> float:
        """The distance from the tip to the target."""
        return math.dist(self.points[-1], self.target)

    @property
    def in_reach(self) -> bool:
        """Whether the tip is in reach of the target."""
        return self.distance <= self.tolerance

    @property
    def footer(self) -> str:
        """For example `step 12 / 400, distance 0.53`, with `held 3 / 50` if `hold` is above 1."""
        held = f", held {self.held} / {self.hold}" if self.hold > 1 else ""
        return f"step {self.steps} / {self.max_steps}, distance {self.distance:.2f}{held}"

    def picture(self, size: int = 480) -> Image.Image:
        """The picture in RGB; both sides are even numbers.

        The links are blue and thinner towards the tip, which is orange; the target is a yellow disc
        as wide as the tolerance, green while the tip is in reach; a faint circle is the rim, a
        faint line the trace. The picture depends on the scene only.

        Args:
            size: the width; the height is larger by the footer.

        Raises:
            ValueError: `size` is too small.
        """
        if size < MIN_SIZE:
            raise ValueError(f"size={size}; a picture of an arm needs at least {MIN_SIZE}")
        joints, points = len(self.angles), self.points
        image, unit = _background(joints, size - size % 2, min(self.tolerance, float(joints)))
        image = image.copy()
        draw, middle = ImageDraw.Draw(image), image.width / 2

        def at(point: Point) -> Point:
            return middle + unit * point[0], middle - unit * point[1]

        wide = min(16.0 * SUPERSAMPLING, 0.34 * unit)
        least = 2.0 * SUPERSAMPLING
        target, radius = at(self.target), max(self.tolerance * unit, 2.5 * least)
        color = REACHED if self.in_reach else TARGET
        _disc(draw, target, radius, color, HATCH, SUPERSAMPLING)
        if len(self.trace) > 1:
            draw.line([at(point) for point in self.trace], BLOCKED, round(least), joint="curve")
        widths = [max(wide * (1.0 - 0.6 * i / joints), least) for i in range(joints + 1)]
        (x, y), half = at(points[0]), 0.8 * widths[0]
        draw.rectangle([x - half, y - half, x + half, y + half], WALL)
        for i in range(joints):
            _link(draw, at(points[i]), at(points[i + 1]), widths[i], widths[i + 1])
        for i in range(joints):
            edge = max(0.12 * widths[i], 0.5 * least)
            _disc(draw, at(points[i]), 0.4 * widths[i], WHITE, WALL, edge)
        _disc(draw, at(points[-1]), max(0.75 * widths[-1], 2.0 * least), TIP, WHITE, SUPERSAMPLING)
        # The edge and centre of the target stay visible over the arm.
        _disc(draw, target, radius, None, HATCH, SUPERSAMPLING)
        _disc(draw, target, 1.2 * least, WALL, WHITE, 0.4 * least)
        small = image.reduce(SUPERSAMPLING)
        font_size = min(18, max(9, small.width // 32))
        picture = Image.new("RGB", (small.width, small.height + 2 * font_size), WHITE)
        picture.paste(small)
        draw_footer(picture, small.height, font_size, self.footer, self.caption)
        return picture

    def text(self) -> str:
        r"""The arm in 17 lines of 33 characters, then the footer, the angles and the caption.

        `#` is the base, `o` a joint, `@` the tip, `X` the target, `*` both of them; links are drawn
        in `-`, `|`, `/` and `\`. The base is in the centre, and the rim at the edge.
        """
        joints, points = len(self.angles), self.points
        lines = [[" "] * (2 * TEXT_COLUMNS + 1) for _ in range(2 * TEXT_ROWS + 1)]

        def cell(point: Point) -> tuple[int, int]:
            # Targets outside the rim are drawn at the edge.
            right = min(max(round(point[0] / joints * TEXT_COLUMNS), -TEXT_COLUMNS), TEXT_COLUMNS)
            up = min(max(round(point[1] / joints * TEXT_ROWS), -TEXT_ROWS), TEXT_ROWS)
            return TEXT_ROWS - up, TEXT_COLUMNS + right

        for (x, y), (far_x, far_y) in pairwise(points):
            sign = "-/|\\"[round(math.atan2(far_y - y, far_x - x) / (math.pi / 4.0)) % 4]
            (row, column), (last_row, last_column) = cell((x, y)), cell((far_x, far_y))
            count = max(abs(last_row - row), abs(last_column - column), 1)
            for i in range(count + 1):
                down, right = (i * (last_row - row), i * (last_column - column))
                lines[row + round(down / count)][column + round(right / count)] = sign
        marks = [*((point, "o") for point in points[1:-1]), (points[0], "#"), (self.target, "X")]
        on_target = cell(points[-1]) == cell(self.target)
        for point, mark in (*marks, (points[-1], "*" if on_target else "@")):
            row, column = cell(point)
            lines[row][column] = mark
        angles = " ".join(f"{angle:.2f}" for angle in self.angles)
        footer = f"{self.footer}, angles {angles}  {self.caption}".rstrip()
        return "\n".join([*("".join(line).rstrip() for line in lines), footer]) + "\n"


def scene_of(
    simulator: ReacherSimulator, arm: int = 0, caption: str = "", trace: Sequence[Point] = ()
) -> ArmScene:
    """The scene of one arm of a simulator."""
    x, y = simulator.targets[arm].tolist()
    return ArmScene(
        angles=tuple(simulator.angles[arm].tolist()),
        target=(x, y),
        tolerance=float(simulator.arms.tolerance[arm]),
        steps=int(simulator.steps[arm]),
        max_steps=simulator.task.max_steps,
        held=int(simulator.held[arm]),
        hold=int(simulator.arms.hold[arm]),
        caption=caption,
        trace=tuple(trace),
    )


def _disc(
    draw: ImageDraw.ImageDraw,
    middle: Point,
    radius: float,
    fill: Color | None,
    edge: Color,
    line: float,
) -> None:
    x, y = middle
    box = [x - radius, y - radius, x + radius, y + radius]
    draw.ellipse(box, fill, edge, round(line))


def _link(draw: ImageDraw.ImageDraw, start: Point, end: Point, first: float, last: float) -> None:
    """A tapered bar with round ends; widths in pixels. A white rim separates crossing links."""
    along = math.atan2(end[1] - start[1], end[0] - start[0])
    aside = (-math.sin(along), math.cos(along))
    for color, rim in ((WHITE, 0.75 * SUPERSAMPLING), (LINK, 0.0)):
        corners = [
            (x + side * (width / 2 + rim) * aside[0], y + side * (width / 2 + rim) * aside[1])
            for (x, y), width, sides in ((start, first, (1, -1)), (end, last, (-1, 1)))
            for side in sides
        ]
        for middle, width in ((start, first), (end, last)):
            _disc(draw, middle, width / 2 + rim, color, color, 0)
        draw.polygon(corners, color)


@lru_cache(maxsize=8)
def _background(joints: int, size: int, beyond: float) -> tuple[Image.Image, float]:
    """The enlarged square with the rim (copy it before drawing), and its pixels per link."""
    side = size * SUPERSAMPLING
    unit = (side / 2 - MARGIN * SUPERSAMPLING) / (joints + beyond)
    image = Image.new("RGB", (side, side), WHITE)
    _disc(ImageDraw.Draw(image), (side / 2, side / 2), joints * unit, WHITE, BLOCKED, SUPERSAMPLING)
    return image, unit
