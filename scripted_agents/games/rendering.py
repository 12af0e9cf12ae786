"""States of small games as text."""

from __future__ import annotations

import warnings
from pathlib import Path
from traceback import extract_tb
from xml.etree import ElementTree

from pursuit.rendering.text import TextScene, text_scene
from pursuit.validation import text_of
from scripted_agents.games.game import State
from scripted_agents.games.simulator import GameSimulator, GameTask

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


def scene_of(simulator: GameSimulator, game: int = 0) -> TextScene:
    """The scene of one game; SVG of the function `draw` is left out."""
    task, state = simulator.task, simulator.task.game.states[simulator.state[game]]
    drawn = drawn_state(task, state)
    return text_scene(simulator, game, text_of(state) if drawn.lstrip().startswith(SVG) else drawn)
