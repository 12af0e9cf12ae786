"""`GameVectorEnv`: one agent of many games as a Gymnasium vector environment, with restarts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pursuit.environments.interface import GameInterface
from pursuit.environments.single_env import OneAgent, row_of
from pursuit.environments.types import Info, Observations, Options, Vector
from pursuit.rules.arrays import Array
from pursuit.validation import checked_seed, is_int, random_seed, whole

RESET_MASK = "reset_mask"
"""Gymnasium's name of the option with the games to reset."""


def checked_autoreset(mode: str | AutoresetMode) -> AutoresetMode:
    """The mode, given as a member, name or value; ValueError for other values."""
    for known in AutoresetMode:
        if mode is known or (isinstance(mode, str) and mode in (known.name, known.value)):
            return known
    names = ", ".join(known.name for known in AutoresetMode)
    raise ValueError(f"autoreset_mode={mode!r}; one of {names}, as gymnasium.vector.AutoresetMode")


def masked_infos(infos: dict[str, Array], games: NDArray[np.bool_]) -> Info:
    """Infos of the games of a mask in Gymnasium's form: 0 for other games, the mask as "_key"."""
    masked: Info = {}
    for key, values in infos.items():
        masked[key] = values.copy()
        masked[key][~games] = 0
        masked[f"_{key}"] = games.copy()
    return masked


class GameVectorEnv(OneAgent, Vector):
    """One agent of a batch of games, with Gymnasium's modes of automatic resets.

    `autoreset_mode` determines when a game restarts:

    - NEXT_STEP, the default: in the step after the end of the episode. That step ignores the action
      of the game, and its reward is 0.
    - SAME_STEP: in the step that ends the episode. The observation is the first of the new episode;
      `infos["final_obs"]` ([num_envs] object, None for other games) holds the last observation of
      the old episode, and `infos["final_info"]` its infos.
    - DISABLED: in `reset(options={"reset_mask": mask})`; a step before that is an error.

    The infos have the form of Gymnasium's `SyncVectorEnv`: every key comes with a mask "_key"
    [num_envs] bool of the games with a value; other games have 0. In the step that ends an episode
    they hold "episode_return" [num_envs] float64 and "episode_length" [num_envs] int64, with
    SAME_STEP in `infos["final_info"]`. (The key "episode" is reserved for Gymnasium's
    `RecordEpisodeStatistics`.)

    Args:
        interface: the games, of a simulator with `auto_restart=False`.
        agent: your agent, by name or index.
        policies: the policies of the other agents, by name.
        render_mode: None, "rgb_array" or "ansi".
        seed: seed of the first reset, if `reset` gets none.
        autoreset_mode: one of `gymnasium.vector.AutoresetMode`, or its name.
        mask_in_observation: whether observations are {"observation", "action_mask"}.

    Raises:
        ValueError: an unknown agent, an invalid render mode, seed or autoreset mode, or a missing
            policy.
    """

    def __init__(
        self,
        interface: GameInterface,
        agent: str | int,
        policies: Mapping[str, Any],
        render_mode: str | None = None,
        seed: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        mask_in_observation: bool = False,
    ) -> None:
        if render_mode not in (None, "rgb_array", "ansi"):
            raise ValueError(f"render_mode {render_mode!r}; give None, 'rgb_array' or 'ansi'")
        self.autoreset_mode = checked_autoreset(autoreset_mode)
        observed, actions = self._set_agent(interface, agent, policies, mask_in_observation)
        self.num_envs = self.simulator.num_games
        self.single_observation_space, self.single_action_space = observed, actions
        self.observation_space = batch_space(observed, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)
        self.metadata = {
            "autoreset_mode": self.autoreset_mode,
            "render_modes": ["ansi", "rgb_array"],
            "render_fps": interface.render_fps,
        }
        self.render_mode = render_mode
        self._first_seed = None if seed is None else checked_seed(seed)
        self._over = np.zeros(self.num_envs, dtype=bool)
        self._limit: int | None = None

    def limit_episodes(self, max_episode_steps: int | None) -> None:
        """Truncate as Gymnasium's TimeLimit does, also an episode that terminates in that step.

        Args:
            max_episode_steps: None and -1 set no limit.

        Raises:
            ValueError: another number below 1, or no whole number.
        """
        none = max_episode_steps is None or max_episode_steps == -1
        self._limit = None if none else whole("max_episode_steps", max_episode_steps, 1)

    def _max_steps(self) -> int:
        return min(super()._max_steps(), self._limit or super()._max_steps())

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Options = None
    ) -> tuple[Observations, Info]:
        """Start new episodes in all games, or in those of `options["reset_mask"]` [num_envs] bool.

        Args:
            seed: an integer seeds game i with (seed, i). A list has one seed per game, which then
                behaves like a single environment with that seed; the streams of games with seed
                None continue.
            options: other options are those of single environments, for all games or one row each.

        Raises:
            ValueError: an invalid seed or mask, or an invalid start. Nothing is changed then.
        """
        chosen, options = self._chosen(options)
        listed = None if seed is None or is_int(seed) else self._checked_seeds(seed)
        first = None if seed is None or listed is not None else checked_seed(seed)
        if not self._seeded and first is None and (listed is None or None in listed):
            first = random_seed() if self._first_seed is None else self._first_seed
        own, streams = first, self.simulator.streams.copy()
        if listed is not None:
            self._seed_each(listed, first, chosen)
            first, own = None, next((each for each in listed if each is not None), None)
        try:
            self.interface.start(first, options, None if chosen.all() else chosen)
        except ValueError:
            self.simulator.streams[:] = streams
            raise
        super().reset(seed=own)  # sets np_random, for wrappers
        self._over[chosen] = False
        self._seeded = True
        return self._observe(), masked_infos(self._infos(), chosen)

    def _chosen(self, options: Options) -> tuple[NDArray[np.bool_], Options]:
        """The mask of games to reset, and the other options."""
        every = np.ones(self.num_envs, dtype=bool)
        if not isinstance(options, dict) or RESET_MASK not in options:
            return every, options
        mask = np.asarray(options[RESET_MASK])
        if mask.dtype != np.bool_ or mask.shape != every.shape:
            raise ValueError(f"reset_mask={mask!r}; give an array of {self.num_envs} bools")
        if not self._seeded and not mask.all():
            raise ValueError("reset_mask before the first reset; call reset() for all games first")
        return mask, {key: value for key, value in options.items() if key != RESET_MASK}

    def _checked_seeds(self, seeds: object) -> list[int | None]:
        if not isinstance(seeds, (Sequence, np.ndarray)) or isinstance(seeds, (str, bytes)):
            raise ValueError(f"seed={seeds!r}; give one integer, or a list with one per game")
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed: {len(seeds)} seeds for {self.num_envs} games; give one each")
        return [None if each is None else checked_seed(each) for each in seeds]

    def _seed_each(
        self, seeds: list[int | None], others: int | None, chosen: NDArray[np.bool_]
    ) -> None:
        """Give game i the streams of a single game with seed `seeds[i]`."""
        simulator, single = self.simulator, type(self.simulator)(self.task, 1, 0, 0, False)
        if others is not None:
            simulator.seed(others)
        for game in np.flatnonzero(chosen):
            own = seeds[game]
            if own is not None:
                simulator.seed(0, [game])  # for other effects of a seed: a new pose
                single.seed(own)
                simulator.streams[game] = single.streams[0]

    def step(
        self, actions: ArrayLike
    ) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Step all games.

        Args:
            actions: actions in `action_space`.

        Returns:
            observations [num_envs, ...], rewards [num_envs] float32, terminations and truncations
            [num_envs] bool, infos.

        Raises:
            ValueError: a step before the first reset, a wrong shape or dtype, an action out of
                range in a game that does not restart, or a game that is over with autoreset
                DISABLED. Nothing is changed then.
        """
        if not self._seeded:
            raise ValueError("step before reset; call reset() first")
        simulator, waiting = self.simulator, self._over
        if self.autoreset_mode is AutoresetMode.DISABLED and waiting.any():
            raise ValueError(
                f"game {np.flatnonzero(waiting)[0]} is over and autoreset_mode is DISABLED; call "
                "reset(options={'reset_mask': terminations | truncations}) first"
            )
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and waiting.any():
            results = self._advance_others(self._checked(self._filled(actions, waiting)), waiting)
        else:
            results = [array.copy() for array in self._advance(self._checked(actions))]
        rewards, terminations, truncations = results
        if self._limit is not None:
            truncations |= simulator.steps >= self._limit
        ended = terminations | truncations
        infos: Info = {}
        if ended.any():
            lengths = simulator.steps.astype(np.int64)
            last = {"episode_return": self._own(simulator.returns), "episode_length": lengths}
            infos = masked_infos(last, ended)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                infos |= masked_infos(self._infos(), ended)
                infos = {
                    "final_obs": self._final_observations(ended),
                    "_final_obs": ended.copy(),
                    "final_info": infos,
                    "_final_info": ended.copy(),
                }
                simulator.reset(games=ended)
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            self._over = ended
        infos |= masked_infos(self._infos(), np.ones(self.num_envs, dtype=bool))
        return self._observe(), rewards, terminations, truncations, infos

    def _checked(self, actions: ArrayLike) -> Array:
        return self.interface.check_actions(self.seat, actions, self._over)

    def _filled(self, actions: ArrayLike, waiting: NDArray[np.bool_]) -> ArrayLike:
        """The actions, with 0 for the games of the mask `waiting`, which ignore theirs."""
        try:
            filled = np.array(actions)
            if len(filled) == self.num_envs:
                filled[waiting] = 0
        except (TypeError, ValueError):  # `_checked` says what is wrong
            return actions
        return filled

    def _final_observations(self, ended: NDArray[np.bool_]) -> NDArray[np.object_]:
        """[num_envs] object: observations of the games of the mask, None for the others."""
        observed, final = self._observe(), np.full(self.num_envs, None, dtype=object)
        for game in np.flatnonzero(ended):
            final[game] = row_of(observed, game)
        return final

    def _advance_others(self, actions: Array, waiting: NDArray[np.bool_]) -> list[Array]:
        """Restart the games of the mask `waiting`, and step the others."""
        simulator, streams = self.simulator, self.simulator.streams[waiting]
        # Truncated games do not move. (A game may continue after the capture of your evader.)
        simulator.truncated[waiting] = True
        results = [array.copy() for array in self._advance(actions)]
        simulator.streams[waiting] = streams  # policies have drawn from them
        simulator.reset(games=waiting)
        for array in results:
            array[waiting] = 0
        return results

    def action_masks(self) -> NDArray[np.bool_]:
        """[num_envs, actions] bool, the legal actions, for sb3-contrib's MaskablePPO."""
        return self.interface.masks(self.seat)

    def render(self) -> tuple[Any, ...] | None:
        """A tuple of one text or image per game, by the render mode; None without render mode."""
        if self.render_mode is None:
            return None
        scenes = [self.interface.scene(game) for game in range(self.num_envs)]
        return tuple(
            scene.text() if self.render_mode == "ansi" else scene.draw() for scene in scenes
        )
