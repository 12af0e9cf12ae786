"""AStarEvader: away from the nearest chaser when that is near, or a random move."""

from __future__ import annotations

from pursuit.declared import whole
from scripted_agents import kernels
from scripted_agents.scripted import Scripted


class AStarEvader(Scripted):
    """Flees to the cell within `look_radius` that is farthest from the nearest chaser.

    It is alerted when the nearest chaser is nearer than `alert_distance` (path distance); then it
    draws uniformly among the first steps of all shortest paths to all such cells: among steps, not
    among cells. When no cell within reach is farther than its own it stays, if the task has that
    action, and else makes a random move. Not alerted, and with probability epsilon, it makes a
    random move: uniformly one of those that change the cell, never "stay".

    Args:
        epsilon: share of random moves in [0, 1].
        alert_distance: path distance below which a chaser is a threat.
        look_radius: path distance of the farthest cell that it considers.

    Raises:
        ValueError: a value out of range.
    """

    kind, role = kernels.EVADER, "evader"

    def __init__(self, epsilon: float = 0.0, alert_distance: int = 3, look_radius: int = 3) -> None:
        super().__init__(epsilon)
        self.alert_distance = whole("alert_distance", alert_distance, 0)
        self.look_radius = whole("look_radius", look_radius, 1)
