"""AStarChaser: the shortest way to the nearest evader, or a random move."""

from __future__ import annotations

from scripted_agents import kernels
from scripted_agents.scripted import Scripted


class AStarChaser(Scripted):
    """With probability epsilon a random move, else a first step of a shortest path.

    The path leads to the nearest active evader, by path distance; first steps to evaders that are
    equally near, and of paths that are equally short, are drawn uniformly. Not optimal: against an
    evader that flees, cutting off its way catches it sooner (see `best_response`).
    """

    kind, role = kernels.CHASER, "chaser"
