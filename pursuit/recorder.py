"""Recorder: keeps the episodes of any environment of ours as replays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.declared import whole
from pursuit.replay import Episode, Replay, digest_of
from pursuit.replay_worlds import State, own_rewards, world_for


class Recorder:
    """Records the episodes of an environment from now on.

    It listens at the simulator that every environment of ours stands on, so it takes any of them:
    PettingZoo's (parallel or turn-based), Gymnasium's (single or vectorised, within wrappers),
    Stable-Baselines3's, TorchRL's, and a simulator itself. Use the environment as ever, or the
    recorder in its place: whatever it does not know itself it passes on. An episode is kept once it
    has ended, with the actions of all seats.

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
        self._world = world_for(simulator.task)
        self._simulator = simulator
        self._games = min(whole("games", games, 1, 2**31), simulator.num_games)
        self._most = whole("most", most, 1, 2**31)
        self.episodes: list[Episode] = []
        self.seed: int | None = simulator.last_seed
        self._tracks: list[_Track | None] = [None] * self._games
        self._methods = {
            name: getattr(simulator, name) for name in ("step", "reset", "place", "set_state")
        }
        simulator.step = self._step
        for name in ("reset", "place", "set_state"):
            setattr(simulator, name, self._restarting(name))
        self._begin_all()

    def __getattr__(self, name: str) -> Any:
        """What is the environment's."""
        if name.startswith("__") or "env" not in vars(self):
            raise AttributeError(name)
        return getattr(self.env, name)

    @property
    def replay(self) -> Replay:
        """The episodes that have ended."""
        task = self._simulator.task
        return Replay(task, tuple(self.episodes), "", self.seed, own_rewards=own_rewards(task))

    def save(self, path: str | Path) -> Path:
        """Write the episodes that have ended; see `Replay.save`."""
        return self.replay.save(path)

    def stop(self) -> Replay:
        """Leave the environment alone again; what was recorded."""
        for name in self._methods:
            vars(self._simulator).pop(name, None)
        return self.replay

    def _repr_html_(self) -> str:
        return self.replay._repr_html_()

    def _begin_all(self) -> None:
        simulator = self._simulator
        for game in range(self._games):
            if simulator.steps[game] == 0 and not simulator.ended[game]:
                self._tracks[game] = _Track(self._world, simulator, game)
            else:  # in the middle of an episode
                self._tracks[game] = None

    def _restarting(self, name: str) -> Any:
        def restart(*arguments: Any, **settings: Any) -> None:
            steps, tracks = self._simulator.steps[: self._games].copy(), self._tracks[:]
            self._methods[name](*arguments, **settings)
            self._begin_all()
            if name == "reset":  # games that were not reset go on
                for game, (before, track) in enumerate(zip(steps, tracks, strict=True)):
                    if before and self._simulator.steps[game] == before:
                        self._tracks[game] = track
            if self._simulator.last_seed is not None:
                self.seed = self._simulator.last_seed

        return restart

    def _step(self, actions: Any) -> None:
        simulator = self._simulator
        over = np.zeros(self._games, bool) if simulator.auto_restart else simulator.ended
        self._methods["step"](actions)
        taken = np.asarray(actions)
        ended = simulator.ended
        for game, track in enumerate(self._tracks):
            if track is None or over[game]:
                continue
            final = bool(ended[game]) and simulator.auto_restart
            track.add(taken[game], final)
            if ended[game]:
                ways = bool(simulator.terminated[game]), bool(simulator.truncated[game])
                self.episodes.append(track.episode(*ways))
                del self.episodes[: -self._most]
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


def simulator_of(env: Any) -> Any:
    """The simulator that an environment of ours stands on; ValueError where there is none."""
    seen: set[int] = set()
    inner = env
    while inner is not None and id(inner) not in seen:
        seen.add(id(inner))
        if hasattr(inner, "auto_restart") and hasattr(inner, "get_state"):
            return inner
        own = vars(inner).get("simulator") if hasattr(inner, "__dict__") else None
        if own is not None:
            return own
        inner = next(
            (vars(inner)[name] for name in ("env", "aec_env", "par_env", "envs", "venv", "games")
             if hasattr(inner, "__dict__") and vars(inner).get(name) is not None),
            None,
        )  # fmt: skip
    raise ValueError(
        f"env={env!r}; give an environment of pursuit, or a Simulator: this one has none inside"
    )
