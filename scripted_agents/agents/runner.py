"""A runner that goes to the nearest goal."""

from __future__ import annotations

from scripted_agents.agents import kernels
from scripted_agents.agents.scripted import Scripted


class NearestGoalRunner(Scripted):
    """With probability epsilon a random move, else a first step towards the nearest goal.

    Ties between goals and between paths are broken uniformly. It also plays evaders that collect
    goals, and ignores chasers then.
    """

    kind, role = kernels.RUNNER, "runner"
