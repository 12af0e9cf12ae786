"""`pursuit demo`: episodes of scripted agents with exact values, without training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import strftime
from typing import Annotated, Any

import numpy as np

from pursuit.validation import check, passes
from train.commands.parse import parse
from train.files import check_new_files
from train.play.browser import has_screen, open_page
from train.reports.pages import PLAYER_ELEMENT, write_page
from train.settings.checks import EVALUATION_SEED, Settings

EPISODES, SEED = 3, EVALUATION_SEED + 19
"""Episodes of 23 to 33 steps."""
TRAIL = 24
"""Steps shown in a trail, as in the page."""
TITLE = "An A* chaser against an A* evader that makes a random move with probability 0.2"
TEXT = """The number in a cell is the exact expected number of steps until capture from there.
Dashed moves are optimal, solid ones those of the A* chaser. `pursuit train --maze 5x5 --seconds 30`
trains a chaser; its report shows the learned moves in the same way."""


def check_suffix(path: Path | None) -> None:
    """ValueError unless this is a new .html or .gif file, or None."""
    check_new_files([path])
    known = path is None or path.suffix.lower() in (".html", ".gif")
    check(known, f"{path}: the demo is a page or an animation; give a new .html or .gif file")


@dataclass(frozen=True)
class DemoCommand(Settings):
    """Play a chase of scripted agents in a page with exact values, policies and trails, and open
    it in the browser. Without one, write an animation of the same episodes. Nothing is trained."""

    out: Annotated[Path | None, passes(check_suffix)] = None
    """A new .html or .gif file. None: runs/demo-TIME.html, or .gif without a browser."""


def demo(arguments: Sequence[str]) -> None:
    """`pursuit demo`."""
    out = parse(DemoCommand, arguments, "demo").out
    from pursuit.rendering.animation import save_animation
    from pursuit.replays.viewer.data import Builder
    from pursuit.tasks.task import make_task
    from scripted_agents import AStarEvader
    from train.evaluation.contest import GameContest
    from train.evaluation.recordings import add_compared

    evader = AStarEvader(epsilon=0.2)
    task = make_task("chase", maze="9x9")
    contest = GameContest(task, "chaser_0", {"evader": evader}, EPISODES, SEED)
    policy = contest.scripted()
    path = out or Path("runs") / f"demo-{strftime('%Y%m%d-%H%M%S')}.html"
    if out is None:
        with suppress(FileExistsError):
            path.parent.mkdir()
        check_new_files([path, path.with_suffix(".gif")])
    if path.suffix.lower() == ".html" and (out or has_screen()):
        builder = Builder()
        games = {f"episode {number + 1}": number for number in range(EPISODES)}
        add_compared(builder, contest, policy, games, "A* chaser")
        write_page(path, TITLE, [PLAYER_ELEMENT, TEXT], builder.data(TITLE))
        print(f"page: {path}")
        if open_page(path.resolve().as_uri()) or out:
            return
    path = out or path.with_suffix(".gif")
    overlay = contest.overlays(policy, most_both=0)[0]
    save_animation(path, with_overlay(contest.scenes(policy, EPISODES), overlay))
    print(f"animation: {path}\nnumbers: exact expected steps until capture; arrows: optimal moves")


def with_overlay(scenes: Sequence[Any], overlay: Any) -> Iterator[Any]:
    """The scenes of a duel with the values and optimal moves of an `Overlay`, and trails."""
    trails: list[list[int]] = []
    for scene in scenes:
        cells = [agent.cell for agent in scene.agents]
        trails = [*trails[-TRAIL:], cells] if scene.steps else [cells]
        other, neighbors = cells[overlay.other], scene.maze.neighbors
        best = overlay.optimal[:, other].argmax(axis=1)
        moves, values = neighbors[range(len(best)), best], overlay.values[:, other].copy()
        values[other] = np.nan  # there both are in one cell
        yield replace(
            scene,
            values=tuple(values.tolist()),
            moves=tuple(moves.tolist()),
            trails=tuple(zip(*trails, strict=True)),
        )
