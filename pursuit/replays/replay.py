"""The class `Replay`: recorded episodes, JSON files, and exact playback in the simulator."""

from __future__ import annotations

import hashlib
import math
from codecs import BOM_UTF8
from collections.abc import Iterable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from pursuit.files import write_atomically
from pursuit.replays.adapters import (
    ADAPTERS,
    POSITIONS,
    Adapter,
    Plain,
    State,
    adapter_for,
    has_reward_function,
)
from pursuit.replays.viewer.data import replay_page
from pursuit.rules.arrays import Array
from pursuit.validation import as_path, one_of
from pursuit.version import __version__

FORM = 1
"""Version of the file format; files of newer versions are refused."""
MOST_BYTES = 256 * 2**20
REWARD_TOLERANCE = 1e-5
"""Tolerance for equal rewards, as processors round sines and roots differently."""


@dataclass(frozen=True)
class Episode:
    """One recorded episode.

    Attributes:
        start: the start state as plain values: "positions", "goals" and "maze", or for an arm
            "angles", "target", "free_joints", "hold" and "tolerance".
        actions: [steps, agents] uint8; for an arm [steps, joints] float64.
        rewards: [steps, agents] float32.
        terminated, truncated: how the episode ended; both False if it is unfinished.
        digest: SHA-256 of all states, in hexadecimal.
        label: label for display.
    """

    start: Plain
    actions: Array
    rewards: NDArray[np.float32]
    terminated: bool
    truncated: bool
    digest: str
    label: str = ""

    @property
    def length(self) -> int:
        """Number of steps."""
        return len(self.actions)


@dataclass(frozen=True)
class Played:
    """The playback of an episode.

    Attributes:
        states: [steps + 1] all states with the start; see `pursuit.replays.adapters`.
        rewards: [steps, agents] float32, the rewards of the playback.
        differences: messages on differences from the recording; empty if there are none.
    """

    states: list[State]
    rewards: NDArray[np.float32]
    differences: list[str]


@dataclass(frozen=True)
class Replay:
    """Episodes of one task.

    Attributes:
        task: a `pursuit.Task` or a `pursuit.ReacherTask`.
        episodes: the episodes; may be empty.
        title: title for display.
        seed: the seed of the games if known, for information; playback does not use it.
        players: descriptions of the policies, by agent.
        versions: versions of the packages at recording.
        own_rewards: whether a custom reward function was used. Files do not contain it, so
            playback does not compare the rewards.
    """

    task: Any
    episodes: tuple[Episode, ...]
    title: str = ""
    seed: int | None = None
    players: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=lambda: versions())
    own_rewards: bool = False

    @property
    def world(self) -> Adapter:
        """The adapter of the task."""
        return adapter_for(self.task)

    @property
    def agents(self) -> list[str]:
        """The names of the agents, one for each column of the rewards."""
        return self.world.agents(self.task)

    def play(self, number: int = 0) -> Played:
        """Play back an episode in the installed version of the simulator.

        Raises:
            ValueError: an unknown episode number, or an invalid start state.
        """
        if not 0 <= number < len(self.episodes):
            raise ValueError(f"episode {number}; this replay has {len(self.episodes)}, from 0")
        episode, world = self.episodes[number], self.world
        simulator = world.simulator(self.task)
        try:
            world.begin(simulator, episode.start)
        except ValueError as error:
            raise ValueError(f"episode {number}: {error}") from None
        states, rewards = [world.state(simulator, 0)], np.zeros_like(episode.rewards)
        differences: list[str] = []
        for step, action in enumerate(episode.actions):
            if simulator.ended[0]:
                differences.append(f"it ends after {step} steps, not after {episode.length}")
                rewards = rewards[:step]
                break
            world.step(simulator, action)
            states.append(world.state(simulator, 0))
            rewards[step] = world.rewards(simulator, 0)
        else:
            ended = (bool(simulator.terminated[0]), bool(simulator.truncated[0]))
            if ended != (episode.terminated, episode.truncated):
                differences.append("it terminates or is truncated differently")
            if digest_of(states) != episode.digest:
                differences.append("its states differ")
            if not self.own_rewards and not np.allclose(
                rewards, episode.rewards, rtol=REWARD_TOLERANCE, atol=REWARD_TOLERANCE
            ):
                differences.append("its rewards differ")
        return Played(states, rewards, differences)

    def check(self) -> list[str]:
        """Play back all episodes; messages on differences from the recording, empty if none.

        Raises:
            ValueError: an invalid start state.
        """
        found = []
        for number in range(len(self.episodes)):
            for difference in self.play(number).differences:
                found.append(f"episode {number}: {difference}")
        if found:
            then = self.versions.get("pursuit", "unknown")
            found.append(f"recorded with pursuit {then}, played with {__version__}")
        return found

    def page(self, title: str = "") -> str:
        """A self-contained HTML page with a viewer of the episodes.

        Raises:
            ValueError: no episode, or an invalid start state.
        """
        return replay_page([self], title or self.title)

    def _repr_html_(self) -> str:
        """The page, for notebooks."""
        if not self.episodes:
            return "<p>This replay has no episodes; play an episode to its end first.</p>"
        return (
            f'<iframe srcdoc="{escape(self.page())}" width="100%" height="640" '
            'style="border: 0" title="pursuit replay"></iframe>'
        )

    def save(self, path: str | Path) -> Path:
        """Write the replay as JSON (atomically); `.json` is appended if `path` has no suffix.

        Raises:
            OSError: the file cannot be written.
        """
        path = with_suffix(path)
        text = msgspec.json.format(msgspec.json.encode(_file_of(self)), indent=0)
        write_atomically(path, lambda partial: partial.write_bytes(text + b"\n"))
        return path

    @classmethod
    def load(cls, path: str | Path) -> Replay:
        """Read a file of `save`.

        Raises:
            ValueError: not a replay, or a damaged file; the message names the file.
            OSError: the file cannot be read.
        """
        path = as_path("path", path)
        size = path.stat().st_size
        if not path.is_file():  # a device or a pipe need not end
            raise ValueError(f"{path}: not a file; give a replay (.json)")
        if size > MOST_BYTES:
            raise ValueError(f"{path}: a replay has at most {MOST_BYTES // 2**20} MiB")
        try:
            return _replay_of(
                msgspec.json.decode(path.read_bytes().removeprefix(BOM_UTF8), type=_File)
            )
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError) as error:
            raise ValueError(f"{path}: not a valid replay: {error}") from None


def with_suffix(path: str | Path) -> Path:
    """The path of a replay; `.json` is appended if there is no suffix."""
    path = Path(path)
    return path if path.suffix else path.with_suffix(".json")


def versions() -> dict[str, str]:
    """The versions of Pursuit and NumPy."""
    return {"pursuit": __version__, "numpy": np.__version__}


def digest_of(states: Iterable[State]) -> str:
    """The SHA-256 of states in hexadecimal, the same on all machines."""
    digest = hashlib.sha256()
    for state in states:
        for name in sorted(state.keys() - {POSITIONS}):  # early recordings are without
            digest.update(np.ascontiguousarray(state[name]).tobytes())
    return digest.hexdigest()


# -- the files -------------------------------------------------------------------------------------


class _EpisodeFile(msgspec.Struct):
    """The JSON form of an episode: one string of action digits per agent, for an arm base64."""

    start: Plain
    actions: list[str] | str
    rewards: list[list[float]]
    terminated: bool
    truncated: bool
    digest: str
    label: str = ""


class _File(msgspec.Struct):
    """The JSON form of a replay."""

    kind: Literal["pursuit replay"]
    form: int
    world: str
    task: Plain
    episodes: list[_EpisodeFile]
    title: str = ""
    seed: int | None = None
    players: dict[str, str] = {}
    versions: dict[str, str] = {}
    own_rewards: bool = False


def _file_of(replay: Replay) -> _File:
    world, content = replay.world, vars(replay)
    episodes = [
        _EpisodeFile(
            **vars(episode)
            | {
                "actions": world.text_of_actions(episode.actions),
                "rewards": [[_short(reward) for reward in column] for column in episode.rewards.T],
            }
        )
        for episode in replay.episodes
    ]
    own = {"own_rewards": replay.own_rewards or has_reward_function(replay.task)}
    task = world.settings(replay.task)
    form = {"kind": "pursuit replay", "form": FORM, "world": world.name}
    return _File(**content | form | own | {"task": task, "episodes": episodes})


def _replay_of(file: _File) -> Replay:
    if file.form > FORM:
        raise ValueError(f"form {file.form}; this version reads forms up to {FORM}: update pursuit")
    world = ADAPTERS[one_of("world", file.world, tuple(ADAPTERS))]
    task = world.task(file.task)
    episodes = tuple(_episode_of(each, world, task) for each in file.episodes)
    return Replay(
        task, episodes, file.title, file.seed, file.players, file.versions, file.own_rewards
    )


def _episode_of(file: _EpisodeFile, world: Adapter, task: Any) -> Episode:
    agents, actions = world.agents(task), world.actions_of_text(file.actions, task)
    rewards = np.array(file.rewards, dtype=np.float32).reshape(len(agents), -1).T
    if rewards.shape != (len(actions), len(agents)):
        raise ValueError(f"rewards of shape {rewards.shape}, but there are {len(actions)} steps")
    return Episode(
        file.start, actions, rewards, file.terminated, file.truncated, file.digest, file.label
    )


def _short(reward: np.float32) -> float:
    """The shortest decimal with the value of this float32."""
    value = float(str(reward))
    if not math.isfinite(value):
        raise ValueError(f"reward {reward}; rewards in a replay are finite")
    return value
