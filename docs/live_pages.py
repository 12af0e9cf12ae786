"""Pages of the site that move: a trained chaser in the viewer, and a chase to play.

    python docs/live_pages.py     # trains the chaser of docs/live/viewer.json, draws docs/front.gif

`site_hooks.py` writes the pages from that file and from exact tables.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import pursuit
import train
from pursuit.rendering.animation import save_animation
from pursuit.rendering.rendering import Drawable
from pursuit.replays.viewer.data import Builder
from pursuit.replays.viewer.page import page
from train.commands.demo import with_overlay
from train.evaluation.contest import GameContest
from train.evaluation.recordings import add_compared
from train.play.server import SCRIPTS, state_of
from train.play.setup import session_of
from train.runs.folder import RUN
from train.runs.parts import contest_of
from train.settings.task import TaskSettings

DOCS = Path(__file__).parent
VIEWER, ANIMATION = DOCS / "live" / "viewer.json", DOCS / "front.gif"
CHASE: dict[str, Any] = {"task": "chase", "role": "chaser", "maze": "7x7", "opponent_epsilon": 0.2}
FRAMES = 400_000
"""Of training: the chaser then catches from every start, and visibly later than the optimum."""
LEARNED = f"PPO after {FRAMES:,} frames"
TITLE = f"A chaser after {FRAMES:,} frames of PPO, against an A* evader with epsilon 0.2"
EPISODES, TRIED, SEED = 4, 40, 5_000_000
PLAYED = 200
"""Starts of games to play; then they come again."""


def play_page() -> str:
    """The page of a chase in which the user is the chaser, without a server."""
    session = session_of(TaskSettings(**CHASE), "astar", SEED)
    scripts = (*SCRIPTS[:-1], "play_tables.js", SCRIPTS[-1])
    return page("Play a chase", state_of(session, True) | {"tables": tables(session)}, scripts)


def viewer_page() -> str:
    """The page of episodes of a trained chaser with values, policy and trails."""
    data = json.loads(VIEWER.read_text(encoding="utf-8"))
    return page(data["title"], data)


def tables(session: Any) -> dict[str, Any]:
    """What `play_tables.js` needs of a duel: a step of the rules from all cells by all actions."""
    task, best = session.task, session.best
    cells, actions = task.max_cells, task.num_actions
    grid = np.indices((cells, cells, actions, actions)).reshape(4, -1).T
    grid = grid[grid[:, 0] != grid[:, 1]]
    games = pursuit.Simulator(task, len(grid), 0, auto_restart=False)
    games.place(grid[:, :2])
    games.step(grid[:, 2:].astype(np.int32))
    caught = games.terminated
    after = np.where(caught, -1 - games.positions[:, 0], games.positions @ [cells, 1])
    outcomes = np.zeros((cells * cells, actions * actions), dtype=int)
    outcomes[grid[:, :2] @ [cells, 1], grid[:, 2:] @ [actions, 1]] = after
    chances = session.contest.opponent_table().transpose(1, 0, 2).reshape(cells * cells, -1)
    starts = []
    for game in range(PLAYED):
        session.start_game(game)
        starts.append(session.start["positions"])
    session.start_game(0)
    return {
        "after": outcomes.tolist(),  # -1 - the cell of a capture
        "chances": chances.round(5).tolist(),
        "values": best.values.round(3).tolist(),
        "rewards": [games.rewards[caught == end][0].round(3).tolist() for end in (False, True)],
        "starts": starts,
        "start": starts[0],
        "played": [],
    }


@dataclass(frozen=True)
class Beside(Drawable):
    """Two scenes side by side."""

    left: Drawable
    right: Drawable

    def picture(self, size: int = 480) -> Image.Image:
        """Both pictures; as `Drawable`."""
        left, right = self.left.picture(size), self.right.picture(size)
        image = Image.new("RGB", (left.width + right.width, left.height), "white")
        image.paste(left, (0, 0))
        image.paste(right, (left.width, 0))
        return image


def shown(contest: GameContest, policy: Any, number: int, name: str, best: bool) -> list[Any]:
    """The scenes of an episode with values, trails and the moves of the policy or the best."""
    (overlay,) = contest.overlays(policy, most_both=0)
    moves = overlay.optimal if best else overlay.learned
    games, play = contest.game(policy, number)
    scenes: list[Any] = [contest.scene(games, name)]
    for _ in play:
        scenes.append(contest.scene(games, name, scenes[-1]))
    return [*with_overlay(scenes, replace(overlay, optimal=moves))]


def draw(contest: GameContest, policy: Any) -> None:
    """The animation of the first page: the learned chaser beside the optimal one, from the start of
    `TRIED` where it loses most steps."""
    best = contest.best_policy()
    lost = contest.play(policy)[0] - contest.play(best)[0]
    number = int(lost.argmax())
    learned = shown(contest, policy, number, LEARNED, False)
    optimal = shown(contest, best, number, "optimal", True)
    pairs = zip_longest(learned, optimal)
    scenes = [Beside(left or learned[-1], right or optimal[-1]) for left, right in pairs]
    save_animation(ANIMATION, scenes, fps=3, size=320)


def main() -> None:
    """Train the chaser, and write what depends on it."""
    settings = train.settings_of(**CHASE, frames=FRAMES, seed=0, log="none")
    with tempfile.TemporaryDirectory() as folder:
        run: Any = train.start(RUN, settings, Path(folder))
        run.train()
    policy = run.trainee.learner.policy(True)
    draw(contest_of(settings.task, TRIED, SEED), policy)
    contest: Any = contest_of(settings.task, EPISODES, SEED)
    builder = Builder()
    names = {f"episode {number + 1}": number for number in range(EPISODES)}
    add_compared(builder, contest, policy, names, LEARNED)
    data = builder.data(TITLE)
    VIEWER.parent.mkdir(exist_ok=True)
    VIEWER.write_text(json.dumps(data, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
