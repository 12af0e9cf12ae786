"""Compiled kernels of teams that draw together."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled
from pursuit.rules.layout import team_stream
from pursuit.rules.randomness import mix


@compiled
def draw_together(streams: Any, steps: Any, numbers: Any) -> None:
    """Fill `numbers` [games] with a uniform float64 in [0, 1) that all who ask in a step find.

    A function of the state of the stream of teams, which moves on with every episode, and of the
    step; no stream moves on.
    """
    for game in range(numbers.shape[0]):
        word = mix(streams[game, team_stream(streams[game])]) ^ mix(np.uint64(steps[game] + 1))
        numbers[game] = np.float64(mix(word) >> np.uint64(11)) * (1.0 / 9007199254740992.0)
