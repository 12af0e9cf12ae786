"""A folder with replays of the games of a user."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pursuit.files import write_atomically
from pursuit.replays.adapters import has_reward_function
from pursuit.replays.replay import Episode, Replay, digest_of
from pursuit.validation import check
from train.files import check_output_folder, hold
from train.play.session import Session

PATTERN = "game-*.json"


def replay_of(session: Session, name: str) -> Replay:
    """The current game of a session as a replay; the game may be unfinished."""
    simulator = session.simulator
    episode = Episode(
        session.start,
        np.array(session.actions, dtype=np.uint8),
        np.array(session.rewards, dtype=np.float32),
        bool(simulator.terminated[0]),
        bool(simulator.truncated[0]),
        digest_of(session.states),
        f"game {session.game + 1} of {name}",
    )
    title = f"{name}, by hand: {session.title()}"
    players = {**session.players(), session.own: f"{name}, by hand"}
    own = has_reward_function(session.task)
    return Replay(session.task, (episode,), title, session.seed, players, own_rewards=own)


class ReplayFolder:
    """Saves the games of a user as replays in a folder, and locks the folder.

    Args:
        folder: created if it does not exist.
        name: of the user.

    Raises:
        ValueError: an empty name, a folder with other contents, or one that another process uses.
        OSError: the folder cannot be written.

    Attributes:
        added: number of saved games.
    """

    def __init__(self, folder: Path, name: str) -> None:
        check(bool(name.strip()), f"name={name!r}; give a name that is not empty")
        check_output_folder(folder, lambda folder: any(folder.glob(PATTERN)))
        self.folder, self.name, self.added = folder, name, 0
        self._lock = hold(folder, "game by hand", shared=True)

    def keep(self, session: Session) -> None:
        """Write the finished game.

        Raises:
            OSError: it cannot be written.
        """
        last = max((path.stem for path in self.folder.glob(PATTERN)), default="game-0000")
        file = f"game-{int(last.removeprefix('game-')) + 1:04d}.json"
        write_atomically(self.folder / file, replay_of(session, self.name).save)
        self.added += 1
