"""Generalised advantages (Schulman et al., 2016), as a compiled kernel."""

from __future__ import annotations

from typing import Any

from pursuit.compiled import compiled


@compiled
def advantages(
    reward: Any, value: Any, cut_value: Any, ended: Any, cut: Any, discounts: Any, out: Any
) -> None:
    """Of every step and game; the last step is followed by nothing that is known.

    Args:
        reward: [steps, games] float32.
        value: [steps + 1, games] float32, of what was observed before every step and after all.
        cut_value: [steps, games] float32, of what an episode ended with that was cut off there.
        ended: [steps, games] bool, where an episode ended for good: nothing follows.
        cut: [steps, games] bool, where one was cut off.
        discounts: [2] float64, gamma and gamma times lambda.
        out: [steps, games] float32.
    """
    steps, games = out.shape
    for game in range(games):
        ahead = 0.0
        for back in range(steps):
            step = steps - 1 - back
            follows = value[step + 1, game]
            if ended[step, game]:
                follows, ahead = 0.0, 0.0
            elif cut[step, game]:
                follows, ahead = cut_value[step, game], 0.0
            error = reward[step, game] + discounts[0] * follows - value[step, game]
            ahead = error + discounts[1] * ahead
            out[step, game] = ahead
