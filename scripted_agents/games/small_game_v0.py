"""PettingZoo module of small games: every player is an agent.

`parallel_env(game, observation="one_hot", render_mode=None, mask_in_observation=False,
max_steps=200)`; `game` is an enumerated game or the name of one, as of `load_game`; `max_cycles` is
another name of `max_steps`.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.environments.parallel import RENDER_FPS, SimulatorParallelEnv
from pursuit.environments.turn_based import turn_based_makers
from pursuit.environments.types import Actions, Info, Observations, Options
from pursuit.observations.masks import ACTION_MASK
from pursuit.validation import check_bool, named_settings, one_of
from scripted_agents.games.rendering import StateScene, scene_of
from scripted_agents.games.seats import (
    PlayedGame,
    action_number,
    begin,
    spaces_of,
    task_of,
    with_waits,
)
from scripted_agents.games.simulator import ENCODINGS, ONE_HOT, GameSimulator, GameTask

__all__ = ["env", "parallel_env", "raw_env"]


class SmallGameParallelEnv(SimulatorParallelEnv):
    """One copy of a small game as a PettingZoo parallel environment; every player is an agent.

    Actions are as of `SmallGameEnv`. If any player has actions that are not always legal, the info
    of every agent holds "action_mask", [actions] int8.

    Args:
        game: the game, or its name.
        max_steps: steps after which an episode is truncated; None for those of a `GameTask`, or
            else 200.
        observation: "one_hot" ([states] float32), "index" ([1] int32), or "observe", the function
            of the game.
        render_mode: None, "ansi", "rgb_array" or "human".
        mask_in_observation: whether observations are {"observation", "action_mask"}.

    Raises:
        ValueError: an invalid argument. In `step`: an action that is not legal; no agent has moved
            then.

    Attributes:
        task, simulator: the game and its simulator.
        np_random: a generator for wrappers; seeded by `reset` and not used by the environment.
    """

    simulator: GameSimulator
    task: GameTask

    def __init__(
        self,
        game: PlayedGame,
        max_steps: int | None = None,
        observation: str = ONE_HOT,
        render_mode: str | None = None,
        mask_in_observation: bool = False,
    ) -> None:
        task = task_of(game, max_steps)
        self.observation = one_of("observation", observation, ENCODINGS)
        self.mask_in_observation = check_bool("mask_in_observation", mask_in_observation)
        self._render_as(render_mode, RENDER_FPS, name="small_game_v0", is_parallelizable=True)
        names, seats = list(task.agent_names), range(task.num_agents)
        spaces = [spaces_of(task, seat, observation, mask_in_observation) for seat in seats]
        state = gymnasium.spaces.Box(0.0, 1.0, (task.game.num_states,), np.float32)
        super().__init__(GameSimulator(task, auto_restart=False), names, *spaces[0], state)
        self.observation_spaces = {name: spaces[seat][0] for name, seat in self._seats.items()}
        self.action_spaces = {name: spaces[seat][1] for name, seat in self._seats.items()}
        self._legal = [task.legal(seat) for seat in seats]
        self.has_masks = not all(legal.all() for legal in self._legal)
        self._actions = np.zeros((1, task.num_agents), dtype=np.int32)

    def _begin(self, seed: int | None, options: Options) -> None:
        begin(self.simulator, seed, options)

    def _move(self, actions: Actions) -> None:
        for agent, seat in self._seats.items():
            number = np.array([action_number(self.task, seat, actions[agent])], dtype=np.int32)
            self._actions[:, seat] = with_waits(self.simulator, seat, number)
        self.simulator.step(self._actions)

    def _observe(self) -> list[Observations]:
        simulator, name = self.simulator, self.observation
        seen = [simulator.observe(name, seat)[0] for seat in self._seats.values()]
        if not self.mask_in_observation:
            return [*seen]
        pairs = zip(seen, self._masks(), strict=True)
        return [{"observation": row, ACTION_MASK: mask} for row, mask in pairs]

    def _infos(self) -> dict[str, Info]:
        if not self.has_masks:
            return super()._infos()
        masks = zip(self.agents, self._masks(), strict=True)
        return {agent: {ACTION_MASK: mask} for agent, mask in masks}

    def _masks(self) -> list[NDArray[np.int8]]:
        """[actions] of every agent, new arrays."""
        return [legal[self.simulator.state[0]].astype(np.int8) for legal in self._legal]

    def _scene(self) -> StateScene:
        return scene_of(self.simulator)

    def state(self) -> NDArray[np.float32]:
        """[states] float32, with a 1 at the number of the state."""
        return self.simulator.observe(ONE_HOT)[0]


def parallel_env(
    game: PlayedGame,
    observation: str = ONE_HOT,
    render_mode: str | None = None,
    mask_in_observation: bool = False,
    **settings: Any,
) -> SmallGameParallelEnv:
    """The parallel environment; `settings` are max_steps (or max_cycles)."""
    limit = named_settings("parallel_env", settings, ("max_steps",)).get("max_steps")
    return SmallGameParallelEnv(game, limit, observation, render_mode, mask_in_observation)


raw_env, env = turn_based_makers(parallel_env)
