"""The class `Recorder`, which records the episodes of any Pursuit environment as replays."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.replays.adapters import Adapter, State, adapter_for, has_reward_function
from pursuit.replays.replay import Episode, Replay, digest_of
from pursuit.rules.arrays import Array
from pursuit.validation import whole

WRAPPED = ("step", "reset", "place", "set_state")
"""The methods of a simulator that a recorder wraps."""


class Recorder:
    """Records the episodes of an environment from now on.

    It wraps the methods of the simulator inside the environment. It accepts environments of
    PettingZoo (parallel or turn-based), Gymnasium (single or vectorised, with wrappers),
    Stable-Baselines3 and TorchRL, a `SmallGameEnv` of a task, and simulators. Use the environment
    as before, or the recorder in its place, which forwards all other attributes (apply wrappers
    before the recorder).

    An episode is stored when it ends, with the actions of all agents. An unfinished episode is
    stored at the next reset: one cut off by the time limit of a wrapper, or one that continued
    after your evader was captured.

    Args:
        env: an environment or simulator of Pursuit.
        games: number of games of a batch to record, from the first.
        most: maximal number of stored episodes; the oldest are dropped.

    Raises:
        ValueError: `env` contains no simulator of Pursuit, or a number below 1.
    """

    def __init__(self, env: Any, games: int = 16, most: int = 1000) -> None:
        self.env = env
        simulator = simulator_of(env)
        self._adapter = adapter_for(simulator.task)
        self._simulator = simulator
        self._games = min(whole("games", games, 1, 2**31), simulator.num_games)
        self._most = whole("most", most, 1, 2**31)
        self.episodes: list[Episode] = []
        self.seed: int | None = simulator.last_seed
        self._tracks: list[_Track | None] = [None] * self._games
        self._methods = {name: getattr(simulator, name) for name in WRAPPED}
        restarting = {name: self._restarting(name) for name in WRAPPED[1:]}
        self._wrappers = {"step": self._step, **restarting}
        for name, method in self._wrappers.items():
            setattr(simulator, name, method)
        self._update_tracks()

    def __getattr__(self, name: str) -> Any:
        """An attribute of the environment."""
        if name.startswith("__") or "env" not in vars(self):
            raise AttributeError(name)
        return getattr(self.env, name)

    @property
    def replay(self) -> Replay:
        """The episodes that have ended."""
        task = self._simulator.task
        return Replay(
            task, tuple(self.episodes), "", self.seed, own_rewards=has_reward_function(task)
        )

    def save(self, path: str | Path) -> Path:
        """Write the episodes that have ended; see `Replay.save`."""
        return self.replay.save(path)

    def stop(self) -> Replay:
        """Stop recording and return the replay. Several recorders may stop in any order."""
        self._tracks, self._games = [], 0
        kept = vars(self._simulator)
        if kept.get("step") is self._wrappers["step"]:
            for name, method in self._methods.items():
                if getattr(method, "__self__", None) is self._simulator:
                    kept.pop(name)
                else:
                    kept[name] = method
        return self.replay

    def _repr_html_(self) -> str:
        return self.replay._repr_html_()

    def _update_tracks(self) -> None:
        """After a reset: continue recordings that still match their games, and start new ones."""
        simulator = self._simulator
        for game in range(self._games):
            track, steps = self._tracks[game], int(simulator.steps[game])
            if track is not None and not track.matches(steps):
                if track.actions:  # unfinished, for example after the time limit of a wrapper
                    self._keep(track.episode(False, False))
                track = None
            if track is None and steps == 0 and not simulator.ended[game]:
                track = _Track(self._adapter, simulator, game)
            self._tracks[game] = track

    def _keep(self, episode: Episode) -> None:
        self.episodes.append(episode)
        del self.episodes[: -self._most]

    def _restarting(self, name: str) -> Callable[..., None]:
        def restart(*arguments: Any, **settings: Any) -> None:
            self._methods[name](*arguments, **settings)
            self._update_tracks()
            if self._simulator.last_seed is not None:
                self.seed = self._simulator.last_seed

        return restart

    def _step(self, actions: ArrayLike) -> None:
        simulator = self._simulator
        over = np.zeros(self._games, bool) if simulator.auto_restart else simulator.ended
        self._methods["step"](actions)
        taken, ended = np.asarray(actions), simulator.ended
        for game, track in enumerate(self._tracks):
            if track is None or over[game]:
                continue
            track.add(taken[game], bool(ended[game]) and simulator.auto_restart)
            if ended[game]:
                flags = bool(simulator.terminated[game]), bool(simulator.truncated[game])
                self._keep(track.episode(*flags))
                self._tracks[game] = None
        if simulator.auto_restart:
            for restarted in np.flatnonzero(ended[: self._games]).tolist():
                self._tracks[restarted] = _Track(self._adapter, simulator, restarted)


class _Track:
    """The recording of an episode in progress."""

    def __init__(self, adapter: Adapter, simulator: Any, game: int) -> None:
        self.adapter, self.simulator, self.game = adapter, simulator, game
        self.start = adapter.start(simulator, game)
        self.states: list[State] = [adapter.state(simulator, game)]
        self.actions: list[Array] = []
        self.rewards: list[NDArray[np.float32]] = []

    def add(self, action: Array, final: bool) -> None:
        """Record a step. `final`: the simulator has already restarted, so read the final state."""
        self.actions.append(np.array(action))
        self.rewards.append(self.adapter.rewards(self.simulator, self.game))
        self.states.append(self.adapter.state(self.simulator, self.game, final))

    def matches(self, steps: int) -> bool:
        """Whether the game, after `steps` steps, is in the last recorded state."""
        if steps != len(self.actions):
            return False
        now = self.adapter.state(self.simulator, self.game)
        return all(
            np.array_equal(now[name], kept)
            for name, kept in self.states[-1].items()
            if name != "events"
        )

    def episode(self, terminated: bool, truncated: bool) -> Episode:
        """The recorded episode."""
        actions = np.stack(self.actions).astype(self.adapter.action_dtype)
        rewards, digest = np.stack(self.rewards), digest_of(self.states)
        return Episode(self.start, actions, rewards, terminated, truncated, digest)


INNER = ("env", "aec_env", "par_env", "envs", "venv", "games")
"""Attributes in which wrappers hold the wrapped object."""


def simulator_of(env: object) -> Any:
    """The simulator inside an environment of Pursuit; ValueError if there is none."""
    for layer in _layers(env):
        if hasattr(layer, "auto_restart") and hasattr(layer, "get_state"):
            return layer
        kept = vars(layer)  # a small game has the simulator of its task in `recorded`
        own = kept.get("recorded", kept.get("simulator"))
        if own is not None:
            return own
    raise ValueError(
        f"env={env!r}; give an environment of pursuit (a SmallGameEnv only of game_of_task), or a "
        "Simulator; this one contains none or several (record the environments of a batch one by "
        "one)"
    )


def _layers(env: object) -> Iterator[object]:
    """An environment and the layers that it wraps, from the outermost to the innermost."""
    seen: set[int] = set()
    layer = env
    while layer is not None and id(layer) not in seen and hasattr(layer, "__dict__"):
        seen.add(id(layer))
        yield layer
        layer = next((vars(layer)[n] for n in INNER if vars(layer).get(n) is not None), None)
