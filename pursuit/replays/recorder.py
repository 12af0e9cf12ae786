"""Recorder: keeps the episodes of any environment of ours as replays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.replays.adapters import State, adapter_for, has_reward_function
from pursuit.replays.replay import Episode, Replay, digest_of
from pursuit.validation import whole

LISTENED = ("step", "reset", "place", "set_state")
"""The methods of a simulator that a recorder puts itself in front of."""


class Recorder:
    """Records the episodes of an environment from now on.

    It listens at the simulator that every environment of ours stands on, so it takes any of them:
    PettingZoo's (parallel or turn-based), Gymnasium's (single or vectorised, within wrappers),
    Stable-Baselines3's, TorchRL's, and a simulator itself. Use the environment as ever, or the
    recorder in its place: what it does not know it passes on (wrappers go inside it).

    An episode is kept once it has ended, with the actions of all seats; one that was broken off, by
    a wrapper's time limit or because one's own evader is caught while others play on, once the
    environment is reset.

    Args:
        env: an environment of ours.
        games: of a batch, how many of its games are recorded: the first ones.
        most: so many episodes are kept, the last ones.

    Raises:
        ValueError: there is no simulator of ours in `env`, or a number below 1.
    """

    def __init__(self, env: Any, games: int = 16, most: int = 1000) -> None:
        self.env = env
        simulator = simulator_of(env)
        self._world = adapter_for(simulator.task)
        self._simulator = simulator
        self._games = min(whole("games", games, 1, 2**31), simulator.num_games)
        self._most = whole("most", most, 1, 2**31)
        self.episodes: list[Episode] = []
        self.seed: int | None = simulator.last_seed
        self._tracks: list[_Track | None] = [None] * self._games
        self._methods = {name: getattr(simulator, name) for name in LISTENED}
        self._own = {name: self._restarting(name) for name in LISTENED[1:]} | {"step": self._step}
        for name, method in self._own.items():
            setattr(simulator, name, method)
        self._follow()

    def __getattr__(self, name: str) -> Any:
        """What is the environment's."""
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
        """Listen no more; what was recorded. Recorders of one environment stop in any order."""
        self._tracks, self._games = [], 0
        kept = vars(self._simulator)
        if kept.get("step") is self._own["step"]:
            for name, method in self._methods.items():
                if getattr(method, "__self__", None) is self._simulator:
                    kept.pop(name)
                else:
                    kept[name] = method
        return self.replay

    def _repr_html_(self) -> str:
        return self.replay._repr_html_()

    def _follow(self) -> None:
        """After games were put somewhere: those that stand where they were recorded go on."""
        simulator = self._simulator
        for game in range(self._games):
            track, steps = self._tracks[game], int(simulator.steps[game])
            if track is not None and not track.stands(steps):
                self._leave(track)
                track = None
            if track is None and steps == 0 and not simulator.ended[game]:
                track = _Track(self._world, simulator, game)
            self._tracks[game] = track

    def _leave(self, track: _Track) -> None:
        """Keep an episode that was broken off, by a wrapper's time limit, say, as it is."""
        if track.actions:
            self._keep(track.episode(False, False))

    def _keep(self, episode: Episode) -> None:
        self.episodes.append(episode)
        del self.episodes[: -self._most]

    def _restarting(self, name: str) -> Any:
        def restart(*arguments: Any, **settings: Any) -> None:
            self._methods[name](*arguments, **settings)
            self._follow()
            if self._simulator.last_seed is not None:
                self.seed = self._simulator.last_seed

        return restart

    def _step(self, actions: Any) -> None:
        simulator = self._simulator
        over = np.zeros(self._games, bool) if simulator.auto_restart else simulator.ended
        self._methods["step"](actions)
        taken, ended = np.asarray(actions), simulator.ended
        for game, track in enumerate(self._tracks):
            if track is None or over[game]:
                continue
            track.add(taken[game], bool(ended[game]) and simulator.auto_restart)
            if ended[game]:
                ways = bool(simulator.terminated[game]), bool(simulator.truncated[game])
                self._keep(track.episode(*ways))
                self._tracks[game] = None
        if simulator.auto_restart:
            for restarted in np.flatnonzero(ended[: self._games]).tolist():
                self._tracks[restarted] = _Track(self._world, simulator, restarted)


class _Track:
    """An episode that is being played."""

    def __init__(self, world: Any, simulator: Any, game: int) -> None:
        self.world, self.simulator, self.game = world, simulator, game
        self.start = world.start(simulator, game)
        self.states: list[State] = [world.state(simulator, game)]
        self.actions: list[NDArray[Any]] = []
        self.rewards: list[NDArray[np.float32]] = []

    def add(self, action: NDArray[Any], final: bool) -> None:
        """After a step; `final`: the simulator has begun the next episode already."""
        self.actions.append(np.array(action))
        self.rewards.append(self.world.rewards(self.simulator, self.game))
        self.states.append(self.world.state(self.simulator, self.game, final))

    def stands(self, steps: int) -> bool:
        """Whether the game is where it was recorded last, after so many steps."""
        if steps != len(self.actions):
            return False
        now = self.world.state(self.simulator, self.game)
        return all(
            np.array_equal(now[name], kept)
            for name, kept in self.states[-1].items()
            if name != "events"
        )

    def episode(self, terminated: bool, truncated: bool) -> Episode:
        """What was played."""
        kind: Any = np.float64 if self.world.name == "arm" else np.uint8
        return Episode(
            self.start,
            np.stack(self.actions).astype(kind),
            np.stack(self.rewards),
            terminated,
            truncated,
            digest_of(self.states),
        )


INNER = ("env", "aec_env", "par_env", "envs", "venv", "games")
"""What wrappers call what is in them."""


def simulator_of(env: Any) -> Any:
    """The simulator that an environment of ours stands on; ValueError where there is none."""
    for layer in _layers(env):
        if hasattr(layer, "auto_restart") and hasattr(layer, "get_state"):
            return layer
        own = vars(layer).get("simulator")
        if own is not None:
            return own
    raise ValueError(
        f"env={env!r}; give an environment of pursuit, or a Simulator: this one has none inside, "
        "or several (of a batch of single environments record each)"
    )


def _layers(env: Any) -> Iterator[Any]:
    """An environment and what it wraps, from outside to inside."""
    seen: set[int] = set()
    layer = env
    while layer is not None and id(layer) not in seen and hasattr(layer, "__dict__"):
        seen.add(id(layer))
        yield layer
        layer = next((vars(layer)[n] for n in INNER if vars(layer).get(n) is not None), None)
