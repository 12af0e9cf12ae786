"""PettingZoo module of the arm: every joint is an agent, and all agents share the reward.

`parallel_env(observation="positions", render_mode=None, own_number=True, **settings)`; the settings
are those of `pursuit.ReacherTask`: joints, start, hold, tolerance, max_steps, max_turn, effort,
discrete_actions.
"""

from __future__ import annotations

from typing import Any

from pursuit.environments.turn_based import turn_based_makers
from pursuit.reacher.parallel_env import ReacherParallelEnv
from pursuit.reacher.task import make_reacher_task

__all__ = ["env", "parallel_env", "raw_env"]


def parallel_env(
    observation: str = "positions",
    render_mode: str | None = None,
    own_number: bool = True,
    **settings: Any,
) -> ReacherParallelEnv:
    """The parallel environment; `settings` are those of `pursuit.ReacherTask`."""
    return ReacherParallelEnv(make_reacher_task(**settings), observation, render_mode, own_number)


raw_env, env = turn_based_makers(parallel_env)
