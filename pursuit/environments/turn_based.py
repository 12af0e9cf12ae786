"""Turn-based (AEC) environments made from parallel environments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gymnasium.spaces import Discrete
from pettingzoo.utils import wrappers
from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from pursuit.environments.types import Parallel, TurnBased


class TurnBasedEnv(TurnBased):
    """PettingZoo's `parallel_to_aec_wrapper` with a different `unwrapped`.

    In PettingZoo `unwrapped` is the parallel environment, which has no turns, so its
    `TerminateIllegalWrapper` cannot end the game. Here `unwrapped` is the turn-based environment.
    Other attributes (the task, the simulator, ...) are those of the parallel environment.

    The methods are copied and not inherited, as PettingZoo's tests refuse an `unwrapped` that is an
    instance of its conversion classes.
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
        if name.startswith("_") or name == "env":  # not set yet while an object is copied
            raise AttributeError(name)
        return getattr(self.env, name)


def turn_based_makers(
    parallel_env: Callable[..., Parallel],
) -> tuple[Callable[..., TurnBased], Callable[..., TurnBased]]:
    """The functions `raw_env` and `env` of a PettingZoo module with this `parallel_env`."""

    def raw_env(**settings: Any) -> TurnBased:
        """The turn-based environment without PettingZoo's safety wrappers.

        Calls out of order raise PettingZoo's errors.
        """
        return wrappers.OrderEnforcingWrapper(TurnBasedEnv(parallel_env(**settings)))

    def env(**settings: Any) -> TurnBased:
        """The turn-based (AEC) environment, with PettingZoo's usual safety wrappers.

        Invalid discrete actions raise an error. Floats outside [-1, 1] are clipped with a warning.
        """
        raw = raw_env(**settings)
        discrete = isinstance(raw.action_space(raw.possible_agents[0]), Discrete)
        checks = wrappers.AssertOutOfBoundsWrapper if discrete else wrappers.ClipOutOfBoundsWrapper
        return wrappers.OrderEnforcingWrapper(checks(raw))

    return raw_env, env
