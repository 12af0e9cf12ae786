"""Replays: episodes as small JSON files, which the simulator plays again to the same states."""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from pursuit.files import write_beside
from pursuit.replays.adapters import ADAPTERS, Adapter, State, adapter_for, has_reward_function
from pursuit.replays.viewer.data import replay_page
from pursuit.validation import one_of
from pursuit.version import __version__

FORM = 1
"""Of the files; a newer one than this is refused."""
MOST_BYTES = 256 * 2**20
CLOSE = 1e-5
"""Rewards that differ by less are the same: processors round sines and roots differently."""


@dataclass(frozen=True)
class Episode:
    """One episode, from its start to where the recording ends.

    Attributes:
        start: where it begins, as plain values: "positions", "goals" and "maze", or of an arm
            "angles", "target", "free_joints", "hold" and "tolerance".
        actions: [steps, agents] uint8, of all seats; of an arm [steps, joints] float64.
        rewards: [steps, agents] float32.
        terminated, truncated: how it ended; neither, where the recording ends before it.
        digest: of all its states, in hexadecimal.
        label: what a person calls it.
    """

    start: dict[str, Any]
    actions: NDArray[Any]
    rewards: NDArray[np.float32]
    terminated: bool
    truncated: bool
    digest: str
    label: str = ""

    @property
    def length(self) -> int:
        """Its steps."""
        return len(self.actions)


@dataclass(frozen=True)
class Played:
    """An episode played again.

    Attributes:
        states: [steps + 1] of every state, the start included; see `replay_worlds`.
        rewards: [steps, agents] float32, as they are paid now.
        differences: in words, whatever is not as it was recorded; empty where all is.
    """

    states: list[State]
    rewards: NDArray[np.float32]
    differences: list[str]


@dataclass(frozen=True)
class Replay:
    """Episodes of one task.

    Attributes:
        task: a `pursuit.Task` or a `pursuit.ReacherTask`.
        episodes: at least none.
        title: what a person calls it.
        seed: that of the games, if it is known; replays do not need it.
        players: who acted, in words, by agent.
        versions: what it was recorded with.
        own_rewards: whether a custom reward function was used, which the file does not hold; the
            rewards are then not compared.
    """

    task: Any
    episodes: tuple[Episode, ...]
    title: str = ""
    seed: int | None = None
    players: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=lambda: versions())
    own_rewards: bool = False

    @property
    def world(self) -> Any:
        """What kind of task it is."""
        return adapter_for(self.task)

    @property
    def agents(self) -> list[str]:
        """Who is paid: the columns of the rewards."""
        return self.world.agents(self.task)

    def play(self, number: int = 0) -> Played:
        """Play an episode again, in the simulator that is installed now.

        Raises:
            ValueError: there is no such episode, or it begins where none can.
        """
        if not 0 <= number < len(self.episodes):
            raise ValueError(f"episode {number}; there are {len(self.episodes)}, from 0")
        episode, world = self.episodes[number], self.world
        simulator = world.simulator(self.task)
        world.begin(simulator, episode.start)
        states, rewards = [world.state(simulator, 0)], np.zeros_like(episode.rewards)
        differences: list[str] = []
        for step, action in enumerate(episode.actions):
            if simulator.ended[0]:
                differences.append(f"it ends after {step} steps, and not after {episode.length}")
                rewards = rewards[:step]
                break
            world.step(simulator, action)
            states.append(world.state(simulator, 0))
            rewards[step] = world.rewards(simulator, 0)
        else:
            ended = (bool(simulator.terminated[0]), bool(simulator.truncated[0]))
            if ended != (episode.terminated, episode.truncated):
                differences.append("it ends in another way")
            if digest_of(states) != episode.digest:
                differences.append("its states are others")
            if not self.own_rewards and not np.allclose(
                rewards, episode.rewards, rtol=CLOSE, atol=CLOSE
            ):
                differences.append("its rewards are others")
        return Played(states, rewards, differences)

    def check(self) -> list[str]:
        """In words, what plays differently now than when it was recorded; empty where nothing does.

        Raises:
            ValueError: an episode begins where none can.
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
        """A self-contained HTML page that plays the episodes.

        Raises:
            ValueError: there is none, or one begins where none can.
        """
        return replay_page([self], title or self.title)

    def _repr_html_(self) -> str:
        """The page within a notebook."""
        if not self.episodes:
            return "<p>A replay without episodes: play one to its end first.</p>"
        return (
            f'<iframe srcdoc="{escape(self.page())}" width="100%" height="640" '
            'style="border: 0" title="pursuit replay"></iframe>'
        )

    def save(self, path: str | Path) -> Path:
        """Write it as JSON, beside `path` and renamed; a suffix `.json` is added where none is.

        Raises:
            OSError: it cannot be written.
        """
        path = with_suffix(path)
        text = msgspec.json.format(msgspec.json.encode(_file_of(self)), indent=0)
        write_beside(path, lambda beside: beside.write_bytes(text + b"\n"))
        return path

    @classmethod
    def load(cls, path: str | Path) -> Replay:
        """Read a file that `save` wrote.

        Raises:
            ValueError: it is no replay, or a damaged one; the message names the file.
            OSError: it cannot be read.
        """
        path = Path(path)
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"{path}: larger than {MOST_BYTES // 2**20} MiB; no replay of ours is")
        try:
            return _replay_of(msgspec.json.decode(path.read_bytes(), type=_File))
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError) as error:
            raise ValueError(f"{path}: no replay that can be played: {error}") from None


def with_suffix(path: str | Path) -> Path:
    """The path of a replay: `.json` is added where there is no suffix."""
    path = Path(path)
    return path if path.suffix else path.with_suffix(".json")


def versions() -> dict[str, str]:
    """What a replay is recorded with."""
    return {"pursuit": __version__, "numpy": np.__version__}


def digest_of(states: Iterable[State]) -> str:
    """The SHA-256 of states, in hexadecimal: equal for equal states, on every machine."""
    digest = hashlib.sha256()
    for state in states:
        for name in sorted(state):
            digest.update(np.ascontiguousarray(state[name]).tobytes())
    return digest.hexdigest()


# -- the files -------------------------------------------------------------------------------------


class _EpisodeFile(msgspec.Struct):
    """An episode as JSON has it: actions are a string of digits an agent, or of an arm numbers."""

    start: dict[str, Any]
    actions: list[str] | str
    rewards: list[list[float]]
    terminated: bool
    truncated: bool
    digest: str
    label: str = ""


class _File(msgspec.Struct):
    """A replay as JSON has it."""

    kind: Literal["pursuit replay"]
    form: int
    world: str
    task: dict[str, Any]
    episodes: list[_EpisodeFile]
    title: str = ""
    seed: int | None = None
    players: dict[str, str] = {}
    versions: dict[str, str] = {}
    own_rewards: bool = False


def _file_of(replay: Replay) -> _File:
    arm = replay.world.name == "arm"
    episodes = [
        _EpisodeFile(
            episode.start,
            _numbers_text(episode.actions) if arm else _digits(episode.actions),
            [[_short(paid) for paid in column] for column in episode.rewards.T],
            episode.terminated,
            episode.truncated,
            episode.digest,
            episode.label,
        )
        for episode in replay.episodes
    ]
    return _File(
        "pursuit replay",
        FORM,
        replay.world.name,
        replay.world.settings(replay.task),
        episodes,
        replay.title,
        replay.seed,
        replay.players,
        replay.versions,
        replay.own_rewards or has_reward_function(replay.task),
    )


def _replay_of(file: _File) -> Replay:
    if file.form > FORM:
        raise ValueError(f"form {file.form}, and this version reads up to {FORM}: update pursuit")
    world = ADAPTERS[one_of("world", file.world, tuple(ADAPTERS))]
    task = world.task(file.task)
    episodes = tuple(_episode_of(each, world, task) for each in file.episodes)
    return Replay(
        task, episodes, file.title, file.seed, file.players, file.versions, file.own_rewards
    )


def _episode_of(file: _EpisodeFile, world: Adapter, task: Any) -> Episode:
    width, agents = world.width(task), world.agents(task)
    if isinstance(file.actions, str):
        raw = base64.b64decode(file.actions, validate=True)
        if len(raw) % (8 * width):
            raise ValueError(f"actions of {len(raw)} bytes; {width} numbers of 8 a step are needed")
        actions: NDArray[Any] = np.frombuffer(raw, "<f8").reshape(-1, width)
        if not (np.abs(actions) <= 1.0 + 1e-6).all():
            raise ValueError("an action outside [-1, 1]")
    else:
        if len(file.actions) != width or len({len(row) for row in file.actions}) > 1:
            raise ValueError(f"actions of {len(file.actions)} agents; {width} equal rows of digits")
        actions = np.array([[int(digit) for digit in row] for row in file.actions], np.uint8).T
        if actions.size and actions.max() >= task.num_actions:
            raise ValueError(f"an action {actions.max()}; they go from 0 to {task.num_actions - 1}")
    if (world.name == "arm") != isinstance(file.actions, str):
        raise ValueError("actions of another world")
    paid = np.array(file.rewards, dtype=np.float32).reshape(len(agents), -1).T
    if paid.shape != (len(actions), len(agents)):
        raise ValueError(f"rewards of shape {paid.shape}; [steps, agents] is {len(actions)} long")
    return Episode(
        file.start, actions, paid, file.terminated, file.truncated, file.digest, file.label
    )


def _digits(actions: NDArray[Any]) -> list[str]:
    return ["".join(map(str, row.tolist())) for row in actions.T]


def _numbers_text(actions: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(actions, "<f8").tobytes()).decode("ascii")


def _short(paid: np.float32) -> float:
    """The shortest decimal that is this float32 again."""
    value = float(str(paid))
    if not math.isfinite(value):
        raise ValueError(f"a reward of {paid}; files hold finite ones")
    return value
