"""Gymnasium: one seat of a game is yours, policies fill the others; single and vectorised."""

from __future__ import annotations

from collections.abc import Mapping
from operator import index
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from pursuit.declared import as_array, truth, whole
from pursuit.keys import Keys, maze_keys
from pursuit.masks import ACTION_MASK, action_masks, masked_space, warn_of_masks
from pursuit.maze_arrays import lay_out
from pursuit.parallel_env import (
    RENDER_FPS,
    RENDER_MODES,
    begin,
    render_game,
    scene_of,
)
from pursuit.policy import Policy, check_plays
from pursuit.rendering import Window, draw_scene, scene_to_text
from pursuit.rules.layout import World
from pursuit.seeds import checked_seed, some_seed
from pursuit.simulator import Simulator
from pursuit.task import Task, checked_task
from pursuit.vector_env import LockstepVectorEnv, StepLimitInSpec

Policies = Mapping[str, Policy]


def fill_seats(task: Task, own: str | int, policies: Policies) -> tuple[int, list[Policy | None]]:
    """Your seat, and the policy of every seat (None in yours).

    Args:
        task: the game.
        own: the agent that is yours: a name ("chaser_1"), or a role for the first of it.
        policies: by agent name, or by role for all agents of that role; a name goes first.

    Raises:
        ValueError: a seat without a policy, a policy of another role, or one for an agent that does
            not exist.
    """
    seat = checked_task(task).seat(own)
    if not isinstance(policies, Mapping):
        raise ValueError(f"policies={policies!r}; give a dict, policies by agent or role")
    known = {*task.agent_names, *task.seat_roles}
    for name in policies:
        if name not in known:
            raise ValueError(
                f"a policy for {name!r}; this task has {', '.join(task.agent_names)} (or give a "
                f"role: {', '.join(sorted(set(task.seat_roles)))})"
            )
    filled: list[Policy | None] = []
    for other, (name, role) in enumerate(zip(task.agent_names, task.seat_roles, strict=True)):
        policy = policies.get(name, policies.get(role))
        if other != seat and policy is None:
            raise ValueError(f"nobody fills the seat of {name}; add policies={{{name!r}: ...}}")
        if other != seat:
            check_plays(policy, task, other)
        filled.append(None if other == seat else policy)
    return seat, filled


class SingleAgentEnv(StepLimitInSpec, gymnasium.Env[Any, np.int64]):
    """One seat of one game as a Gymnasium environment.

    The episode ends with the game, or with the capture of your evader. Every action is legal. The
    info of the last step holds "episode_return" and "episode_length".

    Args:
        task: the rules and settings.
        agent: your agent, by name or role.
        policies: whoever fills the other seats, by name or role.
        observation: one of `pursuit.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: the info holds "action_mask", [actions] int8: 1 for the moves that change the
            cell and for staying. Without the stay action it forbids waiting (with a warning).
        mask_in_observation: observations are {"observation", "action_mask"}, as many libraries
            want it; without `mask_bumps` the mask is all 1.

    Raises:
        ValueError: an unknown agent, observation or render mode, or an empty seat.
    """

    def __init__(
        self,
        task: Task,
        agent: str,
        policies: Policies,
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(
                f"unknown render_mode {render_mode!r}; None or one of {', '.join(RENDER_MODES)}"
            )
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}
        self.render_mode, self.task, self.observation = render_mode, task, observation
        self.seat, self.policies = fill_seats(task, agent, policies)
        self.simulator = Simulator(task, auto_restart=False)
        self.mask_in_observation = truth("mask_in_observation", mask_in_observation)
        seen: gymnasium.Space[Any] = self.simulator.encoder(observation).space
        if self.mask_in_observation:
            seen = masked_space(seen, task.num_actions)
        self.observation_space = seen
        self.action_space = gymnasium.spaces.Discrete(task.num_actions)
        self._actions = np.zeros((1, task.num_agents), dtype=np.int32)
        self.mask_bumps, self._world = truth("mask_bumps", mask_bumps), lay_out(task.mazes).world
        if self.mask_bumps:
            warn_of_masks(task)
        self._seeded = False
        self._window: Window | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a new episode; `options` may hold "positions" and "goals" to begin there.

        Where the task has several mazes, "maze" says in which: its number.
        """
        if seed is not None:
            seed = checked_seed(seed)
        elif not self._seeded:
            seed = some_seed()
        begin(self.simulator, seed, options)
        super().reset(seed=seed)
        self._seeded = True
        if self.render_mode == "human":
            self.render()
        return self._seen(), self._info()

    def step(self, action: np.int64 | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move your agent, and everybody else, by one step.

        Raises:
            ValueError: before the first reset, or an action out of range; then nobody has moved.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        try:
            number = index(action)
        except TypeError:
            number = -1
        if not 0 <= number < self.task.num_actions:
            raise ValueError(f"action {action!r}; integers from 0 to {self.task.num_actions - 1}")
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[0, self.seat] = number
        simulator.step(self._actions)
        captured = not simulator.active[0, self.seat]
        terminated = bool(simulator.terminated[0]) or captured
        truncated = bool(simulator.truncated[0]) and not captured
        if self.render_mode == "human":
            self.render()
        reward = float(simulator.rewards[0, self.seat])
        info = self._info()
        if terminated or truncated:
            info["episode_return"] = float(simulator.returns[0, self.seat])
            info["episode_length"] = int(simulator.steps[0])
        return self._seen(), reward, terminated, truncated, info

    def _seen(self) -> Any:
        observed = self.simulator.observe(self.observation, self.seat)[0]
        if not self.mask_in_observation:
            return observed
        return {"observation": observed, ACTION_MASK: self.action_masks().astype(np.int8)}

    def _info(self) -> dict[str, Any]:
        return {ACTION_MASK: self.action_masks().astype(np.int8)} if self.mask_bumps else {}

    def action_masks(self) -> NDArray[np.bool_]:
        """[actions] bool, for sb3-contrib's MaskablePPO: all True unless `mask_bumps`."""
        return _masks_of(self.simulator, self._world, self.seat, self.mask_bumps)[0]

    def get_keys_to_action(self) -> dict[Keys, int]:
        """For `gymnasium.utils.play.play(env, wait_on_player=True)`: see `pursuit.keys`."""
        return maze_keys(self.task)

    def render(self) -> Any:
        """A text ("ansi"), a picture [height, width, 3] uint8 ("rgb_array"), or a window."""
        if self.render_mode == "human" and self._window is None:
            self._window = Window()
        return render_game(self.simulator, self.render_mode, self._window)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


# skrl looks for Gymnasium's class among the direct bases only.
class SingleAgentVectorEnv(LockstepVectorEnv, gymnasium.vector.VectorEnv[Any, Any, Any]):
    """One seat of many games as a Gymnasium vector environment; the `Simulator` underneath.

    How games begin anew, and what the infos then hold, says `pursuit.vector_env`.

    Args:
        task: the rules and settings.
        agent: your agent, by name or role.
        policies: whoever fills the other seats, by name or role.
        num_envs: games in the batch.
        observation: one of `pursuit.observations.ENCODINGS`.
        render_mode: None, "ansi" or "rgb_array".
        seed: of the first reset, if that names none.
        mask_bumps: `infos["action_mask"]`, [num_envs, actions] int8, is 1 for the moves that change
            the cell and for staying. Without the stay action it forbids waiting (with a warning).
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.
        mask_in_observation: as in `SingleAgentEnv`.

    Raises:
        ValueError: an unknown agent, observation or mode, or an empty seat.
    """

    simulator: Simulator
    task: Task

    def __init__(
        self,
        task: Task,
        agent: str,
        policies: Policies,
        num_envs: int = 1,
        observation: str = "one_hot",
        render_mode: str | None = None,
        seed: int | None = None,
        mask_bumps: bool = False,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        mask_in_observation: bool = False,
    ) -> None:
        num_envs = whole("num_envs", num_envs, 1, 2**63 - 1)
        self.observation = observation
        self.seat, self.policies = fill_seats(task, agent, policies)
        simulator = Simulator(task, num_envs, auto_restart=False)
        self.mask_in_observation = truth("mask_in_observation", mask_in_observation)
        seen: gymnasium.Space[Any] = simulator.encoder(observation).space
        if self.mask_in_observation:
            seen = masked_space(seen, task.num_actions)
        actions = gymnasium.spaces.Discrete(task.num_actions)
        super().__init__(simulator, seen, actions, render_mode, RENDER_FPS, seed, autoreset_mode)
        self._actions = np.zeros((num_envs, task.num_agents), dtype=np.int32)
        self.mask_bumps, self._world = truth("mask_bumps", mask_bumps), lay_out(task.mazes).world
        if self.mask_bumps:
            warn_of_masks(task)

    def _begin(self, seed: int | None, options: Any) -> None:
        begin(self.simulator, seed, options)

    def _advance(self, actions: Any) -> tuple[NDArray[Any], NDArray[np.bool_], NDArray[np.bool_]]:
        simulator, own = self.simulator, as_array("actions", actions, "iu", "give integers")
        if own.shape != (self.num_envs,) or own.dtype.kind not in "iu":
            raise ValueError(
                f"actions of shape {own.shape} and dtype {own.dtype}; give {self.num_envs} integers"
            )
        if own.min() < 0 or own.max() >= self.task.num_actions:
            raise ValueError(
                f"actions from {own.min()} to {own.max()}; integers from 0 to "
                f"{self.task.num_actions - 1}"
            )
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seat] = own
        simulator.step(self._actions)
        terminations, truncations = simulator.terminated.copy(), simulator.truncated.copy()
        if self.task.num_evaders > 1:
            captured = simulator.active[:, self.seat] == 0
            terminations |= captured
            truncations &= ~captured
        return simulator.rewards[:, self.seat].copy(), terminations, truncations

    def _observe(self) -> Any:
        observed = self.simulator.observe(self.observation, self.seat)
        if not self.mask_in_observation:
            return observed
        return {"observation": observed, ACTION_MASK: self.action_masks().astype(np.int8)}

    def _returns(self) -> NDArray[np.float64]:
        return self.simulator.returns[:, self.seat]

    def _infos(self) -> dict[str, NDArray[Any]]:
        return {ACTION_MASK: self.action_masks().astype(np.int8)} if self.mask_bumps else {}

    def action_masks(self) -> NDArray[np.bool_]:
        """[num_envs, actions] bool, for sb3-contrib: all True unless `mask_bumps`."""
        return _masks_of(self.simulator, self._world, self.seat, self.mask_bumps)

    def _draw(self, game: int) -> Any:
        draw: Any = scene_to_text if self.render_mode == "ansi" else draw_scene
        return draw(scene_of(self.simulator, game))


def _masks_of(simulator: Simulator, world: World, seat: int, mask_bumps: bool) -> NDArray[np.bool_]:
    """[games, actions] bool, a fresh array."""
    actions, own = simulator.task.num_actions, slice(seat, seat + 1)
    if not mask_bumps:
        return np.ones((simulator.num_games, actions), dtype=bool)
    return action_masks(simulator.games, world, actions, own, simulator.terminated)[:, 0]
