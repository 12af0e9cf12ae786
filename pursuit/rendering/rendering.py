"""Scenes of games in mazes, rendered as text and RGB arrays."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pursuit.mazes.maze import Maze
from pursuit.rendering.marks import AgentMark as AgentMark

Color = tuple[int, int, int]

WHITE: Color = (255, 255, 255)
FLOOR: Color = WHITE
OPENING: Color = (238, 238, 238)  # the faint line between connected cells
WALL: Color = (38, 42, 48)
BLOCKED: Color = (212, 212, 212)
HATCH: Color = (158, 158, 158)
EDGE: Color = (176, 180, 186)
EXIT: Color = (191, 231, 220)
CAPTURED: Color = (205, 205, 205)
CAPTURED_LINE: Color = (112, 112, 112)
# The colours of Okabe and Ito (2008), which colour-blind readers can distinguish.
ROLE_COLORS: dict[str, Color] = {
    "chaser": (213, 94, 0),
    "evader": (0, 114, 178),
    "runner": (0, 158, 115),
    "goal": (240, 228, 66),
}
SHADES = 3
"""The darkest of five shades of yellow for values."""
SUPERSAMPLING = 8
MARGIN = 12
MIN_CELL_PIXELS = 3
MIN_TOKEN_PIXELS = 9


class Drawable(Protocol):
    """A state of a game that windows and animations can render."""

    def picture(self, size: int = 480) -> Image.Image:
        """The picture in RGB; both sides are even numbers."""
        ...

    def draw(self, size: int = 480) -> NDArray[np.uint8]:
        """[height, width, 3] uint8, the same picture as an array."""
        return np.array(self.picture(size))

    def text(self) -> str:
        """The scene as text."""
        ...


@dataclass(frozen=True)
class Scene(Drawable):
    """The data of a picture of one state of a game.

    Args:
        maze: the maze.
        agents: all agents, including captured ones.
        goals: the cells of the remaining goals.
        steps, max_steps: steps of the episode, and its maximal length.
        caption: text for the footer.
        exits: the cells of the exits.
        values: of a grid, a number for every cell or NaN, shown by text and colour (white least,
            yellow most).
        moves: of a grid, the cell that a move from every cell leads to, shown as arrows.
        trails: the cells where each agent has been.

    Raises:
        ValueError: the cell of an agent, a goal or an exit is not in the maze.
    """

    maze: Maze
    agents: tuple[AgentMark, ...]
    goals: tuple[int, ...]
    steps: int
    max_steps: int
    caption: str = ""
    exits: tuple[int, ...] = ()
    values: tuple[float, ...] = ()
    moves: tuple[int, ...] = ()
    trails: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        for cell in chain((agent.cell for agent in self.agents), self.goals, self.exits):
            self.maze.check_cell(cell)

    @property
    def footer(self) -> str:
        """The step count, as in `step 12 / 200`."""
        return f"step {self.steps} / {self.max_steps}"

    def draw(self, size: int = 480, cell_pixels: int | None = None) -> NDArray[np.uint8]:
        """[height, width, 3] uint8; as `picture`."""
        return np.array(self.picture(size, cell_pixels))

    def picture(self, size: int = 480, cell_pixels: int | None = None) -> Image.Image:
        """The picture in RGB; both sides are even numbers.

        Chasers are orange triangles, evaders blue circles, runners green squares, goals yellow
        stars, exits green cells; captured agents are grey and crossed out, escaped ones grey.
        Agents of one role carry numbers if there are several of them. Agents in the same cell are
        drawn side by side. The picture depends on the scene only.

        Args:
            size: if `cell_pixels` is None, the maximal longer side of the picture without its
                footer, and both sides for a graph. It is exceeded if cells would be smaller than 3
                pixels.
            cell_pixels: the side of a cell; None to fit the maze into `size`.

        Raises:
            ValueError: `cell_pixels` or `size` is too small.
        """
        if cell_pixels is not None and cell_pixels < MIN_CELL_PIXELS:
            raise ValueError(f"cell_pixels={cell_pixels}; a cell needs at least {MIN_CELL_PIXELS}")
        least = 2 * MARGIN + MIN_CELL_PIXELS
        if size < least:
            raise ValueError(f"size={size}; a picture needs at least {least}")
        image, layout = _background(self.maze, cell_pixels, size, self.max_steps)
        image = image.copy()
        pen, half = ImageDraw.Draw(image), (0.5 if self.maze.is_grid else 0.3) * layout.inside - 1
        for x, y in (layout.middle(self.maze, cell) for cell in self.exits):
            pen.rectangle([x - half, y - half, x + half, y + half], EXIT)
        self._draw_overlay(pen, layout)
        for token, x, y in _placed_tokens(self, layout):
            image.paste(token, (x, y), token)
        draw_footer(image, layout.height, layout.font_size, self.footer, self.caption)
        return image

    def strip(self, size: int = 480) -> Image.Image:
        """The footer alone, the lower end of the picture of this size."""
        image, layout = _background(self.maze, None, size, self.max_steps)
        strip = Image.new("RGB", (image.width, image.height - layout.height), WHITE)
        draw_footer(strip, 0, layout.font_size, self.footer, self.caption)
        return strip

    def _draw_overlay(self, pen: ImageDraw.ImageDraw, layout: _Layout) -> None:
        """Draw values, trails and moves."""
        middles = [layout.middle(self.maze, cell) for cell in range(self.maze.num_cells)]
        half, font = layout.inside / 2 - 1, font_of(max(8, layout.inside // 4))
        known = [value for value in self.values if not math.isnan(value)]
        for (x, y), value in zip(middles, self.values, strict=False):
            if not math.isnan(value):
                share = round(SHADES * (value - min(known)) / max(max(known) - min(known), 1e-9))
                pen.rectangle([x - half, y - half, x + half, y + half], _shade(share))
                pen.text((x - half + 2, y - half + 1), f"{value:.{value < 9.95:d}f}", WALL, font)
        width = max(1, round(layout.inside / 16))
        for agent, cells in zip(self.agents, self.trails, strict=False):
            if len(cells) > 1:
                pen.line([middles[cell] for cell in cells], ROLE_COLORS[agent.role], width, "curve")
        color = ROLE_COLORS["runner"]
        for middle, there in zip(np.array(middles), self.moves, strict=False):
            along = np.sign(middles[there] - middle) * 0.2 * layout.inside
            across, tip = 0.6 * along[::-1], middle + along
            pen.line([*(middle - along), *tip], color, width)
            corners = (tip - 0.7 * along + across, tip, tip - 0.7 * along - across)
            pen.line([tuple(corner) for corner in corners], color, width)
            if not along.any():  # it waits
                pen.ellipse([*(middle - width), *(middle + width)], color)

    def text(self) -> str:
        """The scene in the text format of mazes, then the step count and the caption.

        Of a graph it is a line for each agent, goal and exit with the name of its cell.
        A cell holds C (chaser), E (evader), R (runner) or G (goal), in lower case when captured or
        escaped, else X if it is an exit. Several in one cell are shown by their number (`+` above
        nine), and a line below lists them.
        """
        maze = self.maze
        if not maze.is_grid:
            return self._graph_text()
        lines = [list(line) for line in maze.to_text().splitlines()]
        start = () if maze.start_mark is None else (maze.start_mark,)
        blank = dict.fromkeys((*maze.goal_marks, *maze.exit_marks, *start), " ")
        for mark, letter in (blank | dict.fromkeys(self.exits, "X")).items():
            lines[2 * maze.rows[mark] + 1][2 * maze.columns[mark] + 1] = letter
        names = defaultdict(list)
        for agent in self.agents:
            names[agent.cell].append(agent.name + f" ({agent.fate})" * bool(agent.fate))
        for goal in self.goals:
            names[goal].append("goal")
        shared = []
        for cell in sorted(names):
            row, column, here = int(maze.rows[cell]), int(maze.columns[cell]), names[cell]
            letter = here[0][0] if "(" in here[0] else here[0][0].upper()
            if len(here) > 1:
                letter = str(len(here)) if len(here) < 10 else "+"
                shared.append(f"{letter} at row {row}, column {column}: {', '.join(here)}")
            lines[2 * row + 1][2 * column + 1] = letter
        footer = f"{self.footer}  {self.caption}".rstrip()
        return "\n".join([*("".join(line) for line in lines), footer, *shared]) + "\n"

    def _graph_text(self) -> str:
        """`text` of a graph."""
        names = self.maze.cell_names
        agents = [
            f"{agent.name} at {names[agent.cell]}" + f" ({agent.fate})" * bool(agent.fate)
            for agent in self.agents
        ]
        goals = [f"goal at {names[goal]}" for goal in self.goals]
        goals += [f"exit at {names[exit_]}" for exit_ in self.exits]
        return "\n".join([*agents, *goals, f"{self.footer}  {self.caption}".rstrip()]) + "\n"


@dataclass(frozen=True)
class _Layout:
    """The layout of a picture in pixels; the upper left corner of the maze is at (left, MARGIN)."""

    cell: int
    wall: int
    left: int
    width: int
    height: int
    font_size: int

    def middle(self, maze: Maze, cell: int) -> tuple[float, float]:
        """The middle of a cell in the picture."""
        row, column = maze.picture[cell].tolist()
        to_middle = self.wall + self.inside / 2
        return self.left + column * self.cell + to_middle, MARGIN + row * self.cell + to_middle

    @property
    def inside(self) -> int:
        """The side of a cell without its walls."""
        return self.cell - self.wall


def _wall_pixels(cell: int) -> int:
    return max(1, round(0.4 * math.sqrt(cell)))


@lru_cache(maxsize=8)
def _background(
    maze: Maze, cell_pixels: int | None, size: int, max_steps: int
) -> tuple[Image.Image, _Layout]:
    """The picture of the empty maze (copy it before drawing), and its layout."""
    rows, columns = maze.picture_size
    longest = max(rows, columns)
    side = size - 2 * MARGIN
    cell = cell_pixels or max(
        MIN_CELL_PIXELS, int((side - _wall_pixels(int(side / longest))) / longest)
    )
    wall = _wall_pixels(cell)
    maze_width = int(columns * cell) + wall
    least = 0 if maze.is_grid or cell_pixels else side  # pictures of all graphs have one size
    height = max(int(rows * cell) + wall, least) + 2 * MARGIN
    font_size = min(18, max(11, max(maze_width, height) // 32))
    longest_count = font_of(font_size).getlength(f"step {max_steps} / {max_steps}")
    width = 2 * MARGIN + max(maze_width, least, math.ceil(longest_count))
    width, footer_height = width + width % 2, 2 * font_size
    layout = _Layout(cell, wall, (width - maze_width) // 2, width, height, font_size)
    image = Image.new("RGB", (width, height + footer_height + height % 2), WHITE)
    if maze.is_grid:
        image.paste(Image.fromarray(_maze_pixels(maze, cell, wall)), (layout.left, MARGIN))
    else:
        _draw_graph(image, maze, layout)
    return image, layout


def _shade(share: int) -> Color:
    """The colour of values, of `share` fifths of yellow; GIFs have these colours."""
    red, green, blue = WHITE + (np.array(ROLE_COLORS["goal"]) - WHITE) * share // 5
    return int(red), int(green), int(blue)


def _draw_graph(image: Image.Image, maze: Maze, layout: _Layout) -> None:
    """Draw the edges, with an arrow head if directed, and the cells of a graph."""
    draw = ImageDraw.Draw(image)
    middles = [np.array(layout.middle(maze, cell)) for cell in range(maze.num_cells)]
    radius = max(1.0, 0.3 * layout.cell)
    for cell, action in np.argwhere(maze.neighbors != np.arange(maze.num_cells)[:, None]):
        there = int(maze.neighbors[cell, action])
        start, end = middles[cell], middles[there]
        draw.line([*start, *end], EDGE, max(1, layout.wall))
        if cell not in maze.neighbors[there]:
            along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
            across, tip = np.array([-along[1], along[0]]), end - radius * along
            back = tip - 0.25 * layout.cell * along
            corners = (tip, back + 0.12 * layout.cell * across, back - 0.12 * layout.cell * across)
            draw.polygon([tuple(corner) for corner in corners], CAPTURED_LINE)
    for x, y in middles:
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], FLOOR, EDGE, layout.wall)


def _maze_pixels(maze: Maze, cell: int, wall: int) -> NDArray[np.uint8]:
    """[height * cell + wall, width * cell + wall, 3] uint8.

    One code per character of the text format, repeated to pixels: lines are sharp, and walls meet
    in their corners.
    """
    floor, opening, closed, blocked, hatch = range(5)
    colors = np.array([FLOOR, OPENING, WALL, BLOCKED, HATCH], dtype=np.uint8)
    codes = np.full((2 * maze.height + 1, 2 * maze.width + 1), closed, dtype=np.uint8)
    is_blocked = maze.cell_numbers < 0
    codes[1::2, 1::2] = np.where(is_blocked, blocked, floor)
    codes[2:-1:2, 1::2][maze.open_south] = opening
    codes[1::2, 2:-1:2][maze.open_east] = opening
    codes[2:-1:2, 1::2][is_blocked[:-1] & is_blocked[1:]] = blocked
    codes[1::2, 2:-1:2][is_blocked[:, :-1] & is_blocked[:, 1:]] = blocked
    # A corner is closed if any of its four walls is.
    around = np.stack(
        [codes[1:-2:2, 2:-1:2], codes[3::2, 2:-1:2], codes[2:-1:2, 1:-2:2], codes[2:-1:2, 3::2]]
    )
    codes[2:-1:2, 2:-1:2] = np.where((around == closed).any(axis=0), closed, around[0])
    spans = [np.array([wall, cell - wall] * n + [wall]) for n in (maze.height, maze.width)]
    pixels = codes.repeat(spans[0], axis=0).repeat(spans[1], axis=1)
    if cell >= 8:
        period = max(4, cell // 7)
        diagonals = np.arange(pixels.shape[0])[:, None] + np.arange(pixels.shape[1])
        striped = diagonals % period < max(1, round(0.22 * period))
        pixels[(pixels == blocked) & striped] = hatch
    return colors[pixels]


def _placed_tokens(scene: Scene, layout: _Layout) -> Iterator[tuple[Image.Image, int, int]]:
    """The tokens of the scene and the pixels of their upper left corners, those out of the game
    first."""
    visible = max(MIN_TOKEN_PIXELS, max(layout.width, layout.height) // 40)
    roles = [agent.role for agent in scene.agents]
    inside = defaultdict(list)
    for goal in scene.goals:
        inside[goal].append(("goal", "", ""))
    for agent in sorted(scene.agents, key=lambda agent: agent.active):
        label = agent.number if roles.count(agent.role) > 1 else ""
        inside[agent.cell].append((agent.role, label, agent.fate))
    for cell, tokens in inside.items():
        columns = math.ceil(math.sqrt(len(tokens)))
        rows = math.ceil(len(tokens) / columns)
        share = layout.inside / columns
        diameter = max(visible, round((0.7 if columns == 1 else 0.9) * share))
        diameter += (layout.inside - diameter) % 2  # a single token is centred exactly
        pitch = max(0.94 * share, diameter)
        middle_x, middle_y = layout.middle(scene.maze, cell)
        half = (columns - 1) / 2 * pitch + diameter / 2 + 1  # of the group, kept in the picture
        middle_x = min(max(middle_x, half), layout.width - half)
        middle_y = min(max(middle_y, half), layout.height - half)
        for place, (role, label, fate) in enumerate(tokens):
            row, column = divmod(place, columns)
            in_row = min(columns, len(tokens) - row * columns)  # a short last row is centred
            token = _token(role, label, fate, diameter)
            x = middle_x + (column - (in_row - 1) / 2) * pitch - token.width / 2
            y = middle_y + (row - (rows - 1) / 2) * pitch - token.height / 2
            yield token, math.floor(x), math.floor(y)


def _regular(corners: int, radius: float, inner: float | None = None) -> list[tuple[float, float]]:
    """The corners of a polygon that points up, centred on (0, 0); with `inner`, of a star."""
    radii = [radius] if inner is None else [radius, inner]
    count = corners * len(radii)
    angles = [2 * math.pi * i / count - math.pi / 2 for i in range(count)]
    return [
        (radii[i % len(radii)] * math.cos(a), radii[i % len(radii)] * math.sin(a))
        for i, a in enumerate(angles)
    ]


# Outlines of tokens of diameter 1, of about equal visual weight.
OUTLINES: dict[str, list[tuple[float, float]]] = {
    "chaser": [(x, y + 0.13) for x, y in _regular(3, 0.56)],
    "evader": _regular(60, 0.45),
    "runner": [(-0.38, -0.38), (0.38, -0.38), (0.38, 0.38), (-0.38, 0.38)],
    "goal": [(x, y + 0.03) for x, y in _regular(5, 0.5, 0.23)],
}


@lru_cache(maxsize=512)
def _token(role: str, label: str, fate: str, diameter: int) -> Image.Image:
    """[diameter + 2, diameter + 2] RGBA, the shape of a role with a white rim."""
    scale, side = SUPERSAMPLING * diameter, SUPERSAMPLING * (diameter + 2)
    image = Image.new("RGBA", (side, side), (*WHITE, 0))
    draw = ImageDraw.Draw(image)
    points = [(side / 2 + scale * x, side / 2 + scale * y) for x, y in OUTLINES[role]]
    line = max(SUPERSAMPLING * 0.7, 0.045 * scale)
    fill, edge = (CAPTURED, CAPTURED_LINE) if fate else (ROLE_COLORS[role], WALL)
    for color, stroke in ((WHITE, line + 2 * SUPERSAMPLING), (edge, line)):
        draw.line([*points, *points[:2]], color, round(stroke), joint="curve")
    draw.polygon(points, fill)
    if fate == "captured":
        reach = 0.26 * scale
        for sign in (-1, 1):
            ends = [(side / 2 + s * reach, side / 2 + s * sign * reach) for s in (-1, 1)]
            draw.line(ends, CAPTURED_LINE, round(1.8 * line))
    height, lower = (0.5, 0.14) if role == "chaser" else (0.64, 0.0)
    if label and not fate and height * diameter >= 8:
        font_size = round(height * scale * (1 if len(label) == 1 else 0.75))
        middle = (side / 2, side / 2 + lower * scale)
        bold = font_size // 32
        draw.text(middle, label, WHITE, font_of(font_size), "mm", stroke_width=bold)
    return image.reduce(SUPERSAMPLING)


@lru_cache(maxsize=64)
def font_of(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font of all pictures."""
    return ImageFont.load_default(size=size)


def draw_footer(image: Image.Image, top: int, font_size: int, text: str, caption: str) -> None:
    """Draw `text` on the left below row `top`, and `caption`, shortened to fit, on the right."""
    draw, font = ImageDraw.Draw(image), font_of(font_size)
    middle = top + (image.height - top - MARGIN) // 2
    draw.text((MARGIN, middle), text, WALL, font, anchor="lm")
    caption = " ".join(caption.split())
    most = image.width - 2 * MARGIN - font.getlength(text) - font_size
    if font.getlength(caption) > most:
        while caption and font.getlength(caption + "...") > most:
            caption = caption[:-1]
        caption = caption and caption.rstrip() + "..."
    draw.text((image.width - MARGIN, middle), caption, WALL, font, anchor="rm")
