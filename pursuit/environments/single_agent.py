"""Gymnasium environments of one agent, single and vectorised; policies play the other agents."""

from __future__ import annotations

from collections.abc import Mapping
from operator import index
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.parallel import RENDER_FPS, MazeGames
from pursuit.environments.single_env import SingleEnv, checked_actions
from pursuit.environments.types import Observations, Single, Vector
from pursuit.environments.vector import LockstepVectorEnv
from pursuit.observations.masks import ACTION_MASK
from pursuit.rules.arrays import Array
from pursuit.simulator.policy import Policy, seat_policies
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, checked_task
from pursuit.validation import whole

Policies = Mapping[str, Policy]


def fill_seats(task: Task, own: str | int, policies: Policies) -> tuple[int, list[Policy | None]]:
    """The index of your agent, and the policy of every agent (None for yours).

    Args:
        task: the game.
        own: your agent: a name ("chaser_1"), or a role for the first agent of it.
        policies: by agent name, or by role for all agents of that role; names take precedence.

    Raises:
        ValueError: an agent without a policy, a policy of another role, or one for an unknown
            agent.
    """
    seat = checked_task(task).seat(own)
    filled = seat_policies(task, policies)
    filled[seat] = None
    for other, name in enumerate(task.agent_names):
        if other != seat and filled[other] is None:
            raise ValueError(f"{name} has no policy; add policies={{{name!r}: ...}}")
    return seat, filled


class SeatOfGames(MazeGames):
    """One agent in a batch of games, with policies for the other agents.

    Implements the methods that `SingleEnv` and `LockstepVectorEnv` need.
    """

    task: Task
    policies: list[Policy | None]

    def _take_seat(self, task: Task, agent: str, policies: Policies, num_envs: int) -> Simulator:
        """Set the policies of the other agents; return the simulator."""
        self.seat, self.policies = fill_seats(task, agent, policies)
        simulator = Simulator(task, num_envs, auto_restart=False)
        self._actions = np.zeros((num_envs, task.num_agents), dtype=np.int32)
        return simulator

    def _advance(self, actions: Array | int) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        simulator = self.simulator
        simulator.act(self.policies, self._actions)
        self._actions[:, self.seat] = actions
        simulator.step(self._actions)
        rewards = simulator.rewards[:, self.seat]
        terminations, truncations = simulator.terminated, simulator.truncated
        if self.task.num_evaders > 1:  # your evader may leave a game that goes on
            captured = simulator.active[:, self.seat] == 0
            terminations, truncations = terminations | captured, truncations & ~captured
        return rewards, terminations, truncations

    def _observe(self) -> Observations:
        own = slice(self.seat, self.seat + 1)
        observed: Array = self._encoder.encode(self.simulator.games, own)[:, 0]
        if not self.mask_in_observation:
            return observed
        return {"observation": observed, ACTION_MASK: self._masks().astype(np.int8)}

    def _returns(self) -> NDArray[np.float64]:
        return self.simulator.returns[:, self.seat]

    def _infos(self) -> dict[str, Array]:
        return {ACTION_MASK: self._masks().astype(np.int8)} if self.mask_bumps else {}

    def _masks(self) -> NDArray[np.bool_]:
        """[games, actions], a new array: all True unless `mask_bumps`."""
        return self._masks_of(slice(self.seat, self.seat + 1))[:, 0]


# skrl looks for Gymnasium's class among the direct bases only.
class SingleAgentEnv(SeatOfGames, SingleEnv, Single):
    """One agent of one game as a Gymnasium environment.

    The episode ends with the game, or with the capture of your evader. Every action is legal. The
    info of the last step holds "episode_return" and "episode_length".

    Args:
        task: the rules and settings.
        agent: your agent, by name or role.
        policies: the policies of the other agents, by name or role.
        observation: one of `pursuit.observations.observations.ENCODINGS`.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_bumps: the info holds "action_mask", [actions] int8: 1 for the moves that change the
            cell and for staying. Without the stay action it forbids waiting (with a warning).
        mask_in_observation: observations are {"observation", "action_mask"}, as many libraries
            expect; without `mask_bumps` the mask is all 1.
        observation_dtype: "uint8" for planes, windows and "one_hot", in a quarter of the memory;
            None for the dtype of the encoding.

    Raises:
        ValueError: an unknown agent, observation or render mode, or a missing policy.
    """

    simulator: Simulator
    task: Task

    def __init__(
        self,
        task: Task,
        agent: str,
        policies: Policies,
        observation: str = "one_hot",
        render_mode: str | None = None,
        mask_bumps: bool = False,
        mask_in_observation: bool = False,
        observation_dtype: str | None = None,
    ) -> None:
        self._render_as(render_mode, RENDER_FPS)
        simulator = self._take_seat(task, agent, policies, 1)
        masks = mask_bumps, mask_in_observation
        spaces = self._spaces(simulator, observation, masks, observation_dtype)
        super().__init__(simulator, *spaces)

    def _checked(self, actions: Any) -> int:
        try:
            action = index(actions)
        except TypeError:
            action = -1
        if not 0 <= action < self.task.num_actions:
            raise ValueError(f"action {actions!r}; integers from 0 to {self.task.num_actions - 1}")
        return action

    def action_masks(self) -> NDArray[np.bool_]:
        """[actions] bool, for sb3-contrib's MaskablePPO: all True unless `mask_bumps`."""
        return self._masks()[0]


class SingleAgentVectorEnv(SeatOfGames, LockstepVectorEnv, Vector):
    """One agent of many games as a Gymnasium vector environment over a `Simulator`.

    For restarts and infos see `pursuit.environments.vector`.

    Args:
        task: the rules and settings.
        agent: your agent, by name or role.
        policies: the policies of the other agents, by name or role.
        num_envs: games in the batch.
        observation: one of `pursuit.observations.observations.ENCODINGS`.
        render_mode: None, "ansi" or "rgb_array".
        seed: seed of the first reset, if `reset` gets none.
        mask_bumps: `infos["action_mask"]`, [num_envs, actions] int8, is 1 for the moves that change
            the cell and for staying. Without the stay action it forbids waiting (with a warning).
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.
        mask_in_observation, observation_dtype: as in `SingleAgentEnv`.

    Raises:
        ValueError: an unknown agent, observation or mode, or a missing policy.
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
        observation_dtype: str | None = None,
    ) -> None:
        num_envs = whole("num_envs", num_envs, 1, 2**63 - 1)
        simulator = self._take_seat(task, agent, policies, num_envs)
        masks = mask_bumps, mask_in_observation
        spaces = self._spaces(simulator, observation, masks, observation_dtype)
        super().__init__(simulator, *spaces, render_mode, RENDER_FPS, seed, autoreset_mode)

    def _checked(self, actions: ArrayLike) -> Array:
        most = self.task.num_actions - 1
        rule = f"integers from 0 to {most}"
        return checked_actions(actions, "iu", (self.num_envs,), rule, (0, most))

    def action_masks(self) -> NDArray[np.bool_]:
        """[num_envs, actions] bool, for sb3-contrib: all True unless `mask_bumps`."""
        return self._masks()
