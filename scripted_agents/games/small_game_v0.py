"""PettingZoo module of small games: every player is an agent.

`parallel_env(game, observation="one_hot", render_mode=None, mask_in_observation=False,
max_steps=200)`; `game` is an enumerated game or the name of one, as of `load_game`; `max_cycles` is
another name of `max_steps`.
"""

from __future__ import annotations

from typing import Any

from pursuit.environments.parallel import GameParallelEnv
from pursuit.environments.turn_based import turn_based_makers
from pursuit.validation import named_settings
from scripted_agents.games.interface import PlayedGame, SmallGameInterface, task_of
from scripted_agents.games.simulator import ONE_HOT, GameSimulator, GameTask

__all__ = ["env", "parallel_env", "raw_env"]


class SmallGameParallelEnv(GameParallelEnv):
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
        simulator = GameSimulator(task_of(game, max_steps), auto_restart=False)
        copy = SmallGameInterface(simulator, observation)
        super().__init__(copy, render_mode, mask_in_observation, "small_game_v0")
        self.observation = observation


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
