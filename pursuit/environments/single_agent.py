"""Gymnasium environments of one agent in a maze, single and vectorised."""

from __future__ import annotations

from gymnasium.vector import AutoresetMode

from pursuit.environments.maze_interface import MazeInterface, Policies
from pursuit.environments.maze_interface import fill_seats as fill_seats
from pursuit.environments.single_env import GameEnv
from pursuit.environments.types import Single, Vector
from pursuit.environments.vector import GameVectorEnv
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from pursuit.validation import whole


# skrl looks for Gymnasium's class among the direct bases only.
class SingleAgentEnv(GameEnv, Single):
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
        simulator = Simulator(task, auto_restart=False)
        games = MazeInterface(simulator, observation, mask_bumps, observation_dtype)
        super().__init__(games, agent, policies, render_mode, mask_in_observation)
        self.observation, self.mask_bumps = observation, self.has_masks


class SingleAgentVectorEnv(GameVectorEnv, Vector):
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
        simulator = Simulator(task, whole("num_envs", num_envs, 1, 2**63 - 1), auto_restart=False)
        games = MazeInterface(simulator, observation, mask_bumps, observation_dtype)
        modes = render_mode, seed, autoreset_mode, mask_in_observation
        super().__init__(games, agent, policies, *modes)
        self.observation, self.mask_bumps = observation, self.has_masks
