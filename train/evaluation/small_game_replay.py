"""Episodes of small games for the viewer, and pictures of their states by the game's `draw`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pursuit.rendering.rendering import MARGIN, WALL, WHITE
from pursuit.replays.viewer.data import Builder
from pursuit.validation import check, raised, shortened
from scripted_agents.games.episodes import values_along
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from scripted_agents.games.small_game import SmallGame
from scripted_agents.games.solve import respond
from train.files import Plain
from train.settings.checks import EVALUATION_SEED

SVG, NAMESPACE = "<svg", 'xmlns="http://www.w3.org/2000/svg"'
LINE = 1.3
"""Height of a line of text, in font sizes."""


def drawing_of(game: SmallGame, state: int) -> str | None:
    """What the game's `draw` returns for a state, by its number; None for a game without it.

    Raises:
        ValueError: it failed, or returned no text, or SVG that is not well-formed.
    """
    function, given, root = getattr(game.source, "draw", None), game.states[state], None
    if not callable(function):
        return None
    what = f"draw({shortened(given)})"
    rule = "return text, or well-formed SVG that begins with <svg"
    try:
        found = function(given)
        if str(found).startswith(SVG):
            root = ElementTree.fromstring(found)
    except Exception as error:  # of the user's code
        raise ValueError(f"{what} failed: {raised(error)}; {rule}") from error
    check(isinstance(found, str), f"{what} returned {shortened(found)}; {rule}")
    if root is not None and root.tag == "svg":  # an image needs what a part of a page does not
        return str(found.replace(SVG, f"{SVG} {NAMESPACE}", 1))
    return str(found)


@dataclass(frozen=True)
class TextScene:
    """A state of a small game as a picture of its text; a `Drawable`.

    Attributes:
        content: the text.
        lines, columns: those of the largest text of an animation.
    """

    content: str
    lines: int
    columns: int

    def draw(self, size: int = 480) -> NDArray[np.uint8]:
        """As `Drawable`."""
        import matplotlib  # slow to import; with a font of fixed width

        file = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSansMono.ttf")
        points = (size - 2 * MARGIN) / max(0.61 * self.columns, LINE * self.lines)
        font = ImageFont.truetype(file, min(max(int(points), 6), 24))
        sides = font.getlength("M") * self.columns, LINE * font.size * self.lines
        width, height = (2 * round(side / 2 + MARGIN) for side in sides)
        image = Image.new("RGB", (width, height), WHITE)
        for number, line in enumerate(self.content.splitlines()):
            place = MARGIN, MARGIN + LINE * font.size * number
            ImageDraw.Draw(image).text(place, line, WALL, font)
        return np.asarray(image)

    def text(self) -> str:
        """As `Drawable`."""
        return self.content


def add_small_game(
    builder: Builder,
    task: GameTask,
    policies: Mapping[str, StatePolicy],
    games: Mapping[str, int],
    discount: float,
    labels: Mapping[str, str],
) -> None:
    """Play episodes of a small game and add them to a page.

    They have the exact values of their states, and the probabilities of actions by the policies and
    by the best response of each player to the others; within `max_steps` if there is no discount.

    Args:
        builder: of the page.
        task: the game.
        policies: by player.
        games: the numbers of the episodes, which are those of evaluations, by label.
        discount: of values and best responses.
        labels: the names of the policies by player.

    Raises:
        ValueError: the game's `draw` failed.
    """
    game, horizon = task.game, task.max_steps if discount == 1.0 else None
    played, best = {name: own.table(task) for name, own in policies.items()}, {}
    for name in game.players:
        others = {other: table for other, table in played.items() if other != name}
        best[name] = respond(game, name, others, discount, horizon).policies[name]
    items = [_played(task, policies, number) for number in games.values()]
    visits = [item["states"] for item in items]
    along = values_along(game, played, visits, discount, horizon)
    offsets = [game.offsets(seat) for seat in range(len(game.players))]

    def described(state: int) -> Plain:
        choices = []
        for seat, name in enumerate(game.players):
            legal = slice(*offsets[seat][state : state + 2])
            shares = {"played": played[name][legal], "best": best[name][legal]}
            actions = [str(action) for action in game.actions[seat][state]]
            rounded = {key: np.round(row, 5).tolist() for key, row in shares.items()}
            choices.append({"actions": actions, **rounded})
        text = str(game.states[state])
        return {"text": text, "drawing": drawing_of(game, state) or text, "choices": choices}

    how = "sum of rewards" if horizon else f"return discounted by {discount:g} per step"
    left = f" in what is left of {horizon} steps" if horizon else ""
    shown = np.unique(np.concatenate(visits))
    world = {
        "kind": "game",
        "agents": [{"name": name} for name in game.players],
        "states": [described(state) for state in shown.tolist()],
        "legend": f"Action and reward: of the last step; rewards are expected ones. Value: exact "
        f"expected {how} from this state on{left}, if all play their policies. Best response: to "
        f"the policies of the others{', in step 1' * bool(horizon)}; first of equal actions.",
    }
    builder.worlds.append(world)
    for name, item, values in zip(games, items, along, strict=True):
        values[-1] *= not item["terminated"]
        item |= {
            "name": name,
            "world": len(builder.worlds) - 1,
            "states": np.searchsorted(shown, item["states"]).tolist(),
            "values": np.round(values, 5).tolist(),
            "players": [labels[player] for player in game.players],
        }
        builder.items.append(item)


def _played(task: GameTask, policies: Mapping[str, StatePolicy], number: int) -> Plain:
    """One episode; "states" has the state before each step and that after the last, or if the game
    has ended again that before it."""
    games = GameSimulator(task, 1, EVALUATION_SEED, number, auto_restart=False)
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    states, chosen, rewards = [int(games.state[0])], list[list[str]](), list[list[float]]()
    while not games.ended.any():
        games.act([policies[name] for name in task.agent_names], actions)
        games.step(actions)
        named = zip(task.game.action_lists, actions[0].tolist(), strict=True)
        chosen.append([str(every[action]) for every, action in named])
        rewards.append(np.round(games.rewards[0].astype(float), 5).tolist())
        states.append(int(games.state[0]))
    return {
        "length": len(chosen),
        "terminated": bool(games.terminated[0]),
        "truncated": bool(games.truncated[0]),
        "rewards": np.transpose(rewards).tolist(),
        "states": states,
        "actions": chosen,
    }
