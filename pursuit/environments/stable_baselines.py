"""A VecEnv of Stable-Baselines3, which does not accept Gymnasium's VectorEnv.

It needs the extra `sb3`: pip install 'pursuit[sb3]'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from pursuit.environments.vector import LockstepVectorEnv
from pursuit.observations.masks import ACTION_MASK


class StableBaselinesVecEnv(VecEnv):
    """A `SingleAgentVectorEnv` or `ReacherVectorEnv` for Stable-Baselines3.

    The infos hold "terminal_observation", "TimeLimit.truncated" and "episode" (return "r" and
    length "l") in the step that ends an episode, so no Monitor wrapper is needed. With
    `mask_bumps=True` in the vector environment, each info also holds its "action_mask"; without it
    `action_masks()`, which sb3-contrib's MaskablePPO uses, is all True.

    Stable-Baselines3 needs the first observation of the next episode in the step that ends one, so
    the vector environment is set to the autoreset mode SAME_STEP.

    Args:
        env: the vector environment, e.g. `gymnasium.make_vec("pursuit/Chaser-v0").unwrapped`.
    """

    def __init__(self, env: LockstepVectorEnv) -> None:
        env.autoreset_mode = AutoresetMode.SAME_STEP
        self.env = env
        self.render_mode = env.render_mode
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._next_seed: int | None = None

    def reset(self) -> Any:
        """[num_envs, ...] the first observations; a dict of arrays with `mask_in_observation`."""
        seed, self._next_seed = self._next_seed, None
        observations, _ = self.env.reset(seed=seed)
        return observations

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next reset."""
        self._next_seed = seed
        return [seed] * self.num_envs

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[Any], NDArray[Any], list[dict[str, Any]]]:
        """Observations, rewards, dones and infos of all games."""
        observations, rewards, terminations, truncations, infos = self.env.step(self._actions)
        dones = terminations | truncations
        listed: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ACTION_MASK in infos:
            listed = [{ACTION_MASK: mask} for mask in infos[ACTION_MASK]]
        for game in np.flatnonzero(dones):
            listed[game] |= {
                "terminal_observation": infos["final_obs"][game],
                "TimeLimit.truncated": bool(truncations[game]),
                "episode": {
                    "r": float(infos["final_info"]["episode_return"][game]),
                    "l": int(infos["final_info"]["episode_length"][game]),
                    "t": 0.0,
                },
            }
        return observations, rewards, dones, listed

    def close(self) -> None:
        """No effect."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute of the vector environment, once per game."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the vector environment, for all games."""
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment; its result once per game.

        Of `action_masks` every game gets its own row.
        """
        result = getattr(self.env, method_name)(*args, **kwargs)
        games = list(self._get_indices(indices))
        if method_name == "action_masks":
            return [result[game] for game in games]
        return [result] * len(games)

    def action_masks(self) -> NDArray[np.bool_]:
        """[num_envs, actions] bool: the allowed actions; ValueError for an arm."""
        if not hasattr(self.env, "action_masks"):
            raise ValueError("an arm has no action masks: every action is legal")
        masks: NDArray[np.bool_] = self.env.action_masks()
        return masks

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No game is wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of every game, with render_mode "rgb_array"."""
        return list(self.env.render() or [None] * self.num_envs)
