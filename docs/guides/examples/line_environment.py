"""The line of `line_game.py` as an environment."""

import numpy as np
from gymnasium.spaces import Box, Discrete
from line_game import Line, LineBatch, LineSeat

from pursuit.environments.interface import GameInterface
from pursuit.rendering.text import text_scene


class LineInterface(GameInterface):
    """A line as the environments use it."""

    def observation_space(self, seat):
        return Box(*LineSeat.limits, dtype=np.float32)

    def action_space(self, seat):
        return Discrete(3)

    def observe(self, seat):
        return LineSeat(self.simulator.task, seat).seen(self.simulator, slice(seat, seat + 1))[:, 0]

    def has_masks(self, seat):
        return True

    def masks(self, seat):
        allowed = LineSeat(self.simulator.task, seat).allowed
        return allowed(self.simulator, slice(seat, seat + 1))[:, 0]

    def scene(self, game):
        return text_scene(self.simulator, game, self.simulator.text(game))


def line(games):
    """So many games in which all see the whole line."""
    return LineInterface(LineBatch(Line(view=5), games))
