"""A VecEnv of Stable-Baselines3, which does not accept Gymnasium's VectorEnv.

It needs the extra `sb3`: pip install 'pursuit[sb3]'.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from pursuit.environments.types import Info, Observations
from pursuit.environments.vector import RESET_MASK, GameVectorEnv
from pursuit.observations.masks import ACTION_MASK
from pursuit.rules.arrays import Array

Indices = int | Iterable[int] | None
"""Games; None for all."""
SPACES = ("observation_space", "action_space")


class StableBaselinesVecEnv(VecEnv):
    """A `SingleAgentVectorEnv`, `ReacherVectorEnv` or other `GameVectorEnv` for Stable-Baselines3.

    It behaves as a `DummyVecEnv` of as many `gymnasium.make` environments, each in a `Monitor`:
    the same seeds give the same games, `reset_infos` holds the infos of the last resets, and the
    infos hold "TimeLimit.truncated" and, in the step that ends an episode, "terminal_observation"
    and "episode" (return "r", length "l" and seconds "t"). With `mask_bumps=True` in the vector
    environment, each info also holds its "action_mask"; without it `action_masks()`, which
    sb3-contrib's MaskablePPO uses, is all True.

    Stable-Baselines3 needs the first observation of the next episode in the step that ends one, so
    the vector environment is set to the autoreset mode SAME_STEP.

    Args:
        env: the vector environment, e.g. `gymnasium.make_vec("pursuit/Chaser-v0").unwrapped`.

    Raises:
        ValueError: another environment, or one in a wrapper.
    """

    def __init__(self, env: GameVectorEnv) -> None:
        if not isinstance(env, GameVectorEnv):
            raise ValueError(f"env={env!r}; give a vector environment of Pursuit: envs.unwrapped")
        env.autoreset_mode = env.metadata["autoreset_mode"] = AutoresetMode.SAME_STEP
        self.env = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self.metadata = env.metadata
        self._start = time.time()
        self._was_reset = False

    def reset(self) -> Observations:
        """Start new episodes, with the seeds of `seed` and the options of `set_options`.

        Returns:
            [num_envs, ...] the first observations; a dict of arrays with `mask_in_observation`.

        Raises:
            ValueError: invalid options.
        """
        keys = [id(each) if each else 0 for each in self._options]  # `set_options` shares a dict
        if len({*keys}) > 1 and not self._was_reset:  # a mask needs a first reset
            self.env.reset(seed=self._seeds)
        for key in dict.fromkeys(keys):
            mask = np.array([each == key for each in keys])
            options = {**self._options[keys.index(key)], RESET_MASK: mask}
            observations, infos = self.env.reset(seed=self._seeds, options=options)
            listed = self._listed(infos)
            for game in np.flatnonzero(mask):
                self.reset_infos[game] = listed[game]
        self._was_reset = True
        self._reset_seeds()
        self._reset_options()
        return observations

    def _listed(self, infos: Info) -> list[Info]:
        """The infos of each game that a vector environment gives in every reset and step."""
        if ACTION_MASK not in infos:
            return [{} for _ in range(self.num_envs)]
        return [{ACTION_MASK: mask} for mask in infos[ACTION_MASK]]

    def step_async(self, actions: Array) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, Array, Array, list[Info]]:
        """Observations, rewards, dones and infos of all games."""
        observations, rewards, terminations, truncations, infos = self.env.step(self._actions)
        dones, listed = terminations | truncations, self._listed(infos)
        for game in np.flatnonzero(dones):
            self.reset_infos[game] = listed[game]
            final = {k: v[game] for k, v in infos["final_info"].items() if not k.startswith("_")}
            listed[game] = {
                **final,
                "terminal_observation": infos["final_obs"][game],
                "episode": {
                    "r": round(float(final["episode_return"]), 6),
                    "l": int(final["episode_length"]),
                    "t": round(time.time() - self._start, 6),
                },
            }
        for info, truncated in zip(listed, (truncations & ~terminations).tolist(), strict=True):
            info["TimeLimit.truncated"] = truncated
        return observations, rewards, dones, listed

    def close(self) -> None:
        """Close the vector environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """The attribute of the vector environment, once per game; spaces are those of one game."""
        name = f"single_{attr_name}" if attr_name in SPACES else attr_name
        return [getattr(self.env, name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the vector environment, for all games.

        Raises:
            ValueError: indices of some games only.
        """
        if {*self._get_indices(indices)} != {*range(self.num_envs)}:
            raise ValueError(
                f"set_attr({attr_name!r}) for games {indices}: all games share one environment; "
                "leave indices out"
            )
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment; its result once per game.

        Of `action_masks` and `render` every game gets its own row.
        """
        result = getattr(self.env, method_name)(*args, **kwargs)
        by_game = method_name in ("action_masks", "render") and result is not None
        return [result[game] if by_game else result for game in self._get_indices(indices)]

    def action_masks(self) -> NDArray[np.bool_]:
        """[num_envs, actions] bool: the allowed actions; ValueError if not `Discrete`."""
        return self.env.action_masks()

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Whether the infos are those of this wrapper: True for `Monitor` only."""
        return [issubclass(Monitor, wrapper_class) for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of every game, with render_mode "rgb_array"; else None, with a warning."""
        if self.render_mode == "rgb_array":
            return list(self.env.render() or ())
        warnings.warn(
            f"no images: render_mode is {self.render_mode!r}, not 'rgb_array'", stacklevel=2
        )
        return [None] * self.num_envs
