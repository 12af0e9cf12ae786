"""How evaders leave games with exits: captures, escapes and time-outs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Rewards

RATES = ("capture_rate", "escape_rate", "timeout_rate")

OUTCOME_REWARDS = {
    "chaser": Rewards(capture=1.0, escape=-1.0, per_evader=True),
    "evader": Rewards(capture=-1.0, escape=1.0),
}
"""Rewards whose returns are captures minus escapes, and for an evader its negative."""


class Departures(NamedTuple):
    """How many of so many evaders were captured, and how many escaped; [games] float64."""

    captured: NDArray[np.float64]
    escaped: NDArray[np.float64]
    evaders: int

    @property
    def outcome(self) -> NDArray[np.float64]:
        """[games] captures minus escapes."""
        return self.captured - self.escaped

    def rates(self) -> dict[str, float]:
        """As `rates_of`."""
        captured, escaped = float(self.captured.mean()), float(self.escaped.mean())
        return rates_of(captured / self.evaders, escaped / self.evaders, self.evaders)


def rates_of(caught: float, escaped: float, evaders: int) -> dict[str, float]:
    """The outcome and the rates of a `Score`, from the shares of so many evaders."""
    shares = (caught, escaped, max(1.0 - caught - escaped, 0.0))
    return {"outcome": evaders * (caught - escaped), **dict(zip(RATES, shares, strict=True))}
