"""The turn-based (AEC) form of the parallel environments, and what PettingZoo wraps it in."""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils import wrappers
from pettingzoo.utils.conversions import parallel_to_aec_wrapper


class TurnBasedEnv(AECEnv[str, Any, Any]):
    """PettingZoo's turns over a parallel environment, with one thing mended.

    The `unwrapped` of PettingZoo's own is the parallel environment, which has no turns, so that its
    `TerminateIllegalWrapper` cannot end the game there. Of this one it is itself; what it has not
    (the task, the simulator, ...) is that of the parallel environment.

    The methods are PettingZoo's, but not by inheritance: its tests allow no `unwrapped` that is one
    of its own conversions.
    """

    __init__ = parallel_to_aec_wrapper.__init__
    observation_space = parallel_to_aec_wrapper.observation_space
    action_space = parallel_to_aec_wrapper.action_space
    reset = parallel_to_aec_wrapper.reset
    step = parallel_to_aec_wrapper.step
    observe = parallel_to_aec_wrapper.observe
    last = parallel_to_aec_wrapper.last
    state = parallel_to_aec_wrapper.state
    render = parallel_to_aec_wrapper.render
    close = parallel_to_aec_wrapper.close
    __str__ = parallel_to_aec_wrapper.__str__

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "env":  # not there yet: a copy that is being made
            raise AttributeError(name)
        return getattr(self.env, name)


def turn_based(env: ParallelEnv[str, Any, Any]) -> AECEnv[str, Any, Any]:
    """A parallel environment by turns; out of turn, or before a reset, PettingZoo complains."""
    return wrappers.OrderEnforcingWrapper(TurnBasedEnv(env))
