"""PettingZoo module of the arm: every joint is an agent, and all agents share the reward.

`parallel_env(observation="positions", render_mode=None, own_number=True, **settings)`; the settings
are those of `pursuit.ReacherTask`: joints, start, hold, tolerance, max_steps, max_turn, effort,
discrete_actions.
"""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils import wrappers

from pursuit.environments.turn_based import turn_based
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


def raw_env(**settings: Any) -> AECEnv[str, Any, Any]:
    """The turn-based environment without PettingZoo's safety wrappers."""
    return turn_based(parallel_env(**settings))


def env(**settings: Any) -> AECEnv[str, Any, Any]:
    """The turn-based (AEC) environment, with PettingZoo's usual safety wrappers.

    Floats outside [-1, 1] are clipped with a warning. Invalid discrete actions raise an error.
    """
    raw = raw_env(**settings)
    if raw.unwrapped.task.discrete_actions:
        return wrappers.OrderEnforcingWrapper(wrappers.AssertOutOfBoundsWrapper(raw))
    return wrappers.OrderEnforcingWrapper(wrappers.ClipOutOfBoundsWrapper(raw))
