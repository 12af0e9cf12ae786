"""Games by hand in a folder: a replay of each, and one list of who played what against whom."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.maze import library_names
from pursuit.parts import check_trusted, is_reference
from pursuit.replay import Episode, Replay, digest_of
from pursuit.replay_worlds import own_rewards
from pursuit.suite_files import is_suite
from train.files import check_output_folder, hold, read_json, write_beside, write_json
from train.play.session import Session
from train.runs.tasks import maze_text_of
from train.schemas import read_as
from train.settings.checks import check
from train.settings.task import AnyTask, ReacherSettings, TaskSettings

LIST = "games.json"
FORMAT = 1
"""Of the list; raised whenever older ones can no longer be read."""
RESTORE = "restore it from a copy"


@dataclass(frozen=True)
class KeptGame:
    """One game by hand.

    Attributes:
        file: its replay, in the same folder.
        name: of the person.
        seed, game: it began as game `game` of a batch of that seed, and so did all luck in it.
        task: the settings, the maze as text where it is none of ours; "role" is the person's.
        steps: that were played.
        won: as `Outcome.won`.
        optimum: the least of the bounds that were told, if any.
    """

    file: str
    name: str
    seed: int
    game: int
    task: dict[str, Any]
    steps: int
    won: bool
    optimum: float | None = None


@dataclass(frozen=True)
class _List:
    kind: str
    format: int
    games: list[KeptGame] = field(default_factory=list)


def is_by_hand(folder: Path) -> bool:
    """Whether a folder holds games by hand."""
    return (folder / LIST).exists()


def load_games(folder: Path) -> list[KeptGame]:
    """The list of the games in a folder.

    Raises:
        ValueError: none there, a damaged one, one of another version, or one that names code which
            is not allowed.
    """
    path = folder / LIST
    content = read_json(path)
    check(isinstance(content, dict), f"{path}: damaged, no list of games; {RESTORE}")
    check(
        content.get("kind") == "games by hand" and content.get("format") == FORMAT,
        f"{path}: no list of games by hand that this version reads (format {FORMAT} needed)",
    )
    check_trusted(path, content)
    games = read_as(_List, content, path, RESTORE).games
    for game in games:
        plain = Path(game.file).name == game.file and game.file.endswith(".json")
        check(plain, f"{path}: a file {game.file!r}; the replays are in this folder; {RESTORE}")
    return games


def settings_of(game: KeptGame, where: Path) -> TaskSettings:
    """What was played; ValueError where that is no game in a maze."""
    check(
        game.task.get("task") != ReacherSettings().task,
        f"{where}: {game.file} is of an arm; games in mazes are needed",
    )
    return read_as(TaskSettings, game.task, f"{where}: {game.file}: task", RESTORE)


def load_game(folder: Path, game: KeptGame) -> Episode:
    """The episode of a game, played again.

    Raises:
        ValueError: no replay, a damaged one, or one that plays differently now.
    """
    path = folder / game.file
    try:
        replay = Replay.load(path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); {RESTORE}") from None
    check(len(replay.episodes) == 1, f"{path}: {len(replay.episodes)} episodes; one is needed")
    for difference in replay.check():
        raise ValueError(f"{path}: plays differently now: {difference}")
    return replay.episodes[0]


def replay_of(session: Session, name: str) -> Replay:
    """The present game of a session as a replay; who left it early is no end of it."""
    arm = hasattr(session.task, "joints")
    over = session.simulator
    episode = Episode(
        session.start,
        np.array(session.actions, dtype=np.float64 if arm else np.uint8),
        np.array(session.rewards, dtype=np.float32),
        bool(over.terminated[0]),
        bool(over.truncated[0]),
        digest_of(session.states),
        f"game {session.game + 1} of {name}",
    )
    title = f"{name}, by hand: {session.title()}"
    players = {**session.players(), session.own: f"{name}, by hand"}
    own = own_rewards(session.task)
    return Replay(session.task, (episode,), title, session.seed, players, own_rewards=own)


class Keeper:
    """Keeps the games of a person in a folder, beside those that are there, and holds the folder.

    Args:
        folder: is made if need be.
        name: of the person.
        settings: of the games.

    Raises:
        ValueError: a name of nothing, a folder of something else, a damaged list, or another
            process that keeps games there.
        OSError: the folder cannot be written.

    Attributes:
        added: games that it has kept.
    """

    def __init__(self, folder: Path, name: str, settings: AnyTask) -> None:
        check(bool(name.strip()), f"name={name!r}; give one that a league can print")
        check_output_folder(folder, is_by_hand)
        self.folder, self.name = folder, name
        self._lock = hold(folder, "game by hand", shared=True)
        self.games = load_games(folder) if is_by_hand(folder) else []
        self.task, self.added = plain(settings), 0

    def keep(self, session: Session) -> None:
        """Write the game that is over, then the list anew.

        Raises:
            OSError: it cannot be written.
        """
        outcome, replay = session.outcomes[-1], replay_of(session, self.name)
        file = f"game-{len(self.games) + 1:04d}.json"
        write_beside(self.folder / file, replay.save)
        game = KeptGame(
            file,
            self.name,
            session.seed,
            session.game,
            self.task,
            outcome.steps,
            outcome.won,
            outcome.least,
        )
        content = _List("games by hand", FORMAT, [*self.games, game])
        write_json(self.folder / LIST, asdict(content))
        self.games.append(game)
        self.added += 1


def plain(settings: AnyTask) -> dict[str, Any]:
    """Settings as plain values that stay true elsewhere: mazes as text, opponents' whole paths."""
    if isinstance(settings, ReacherSettings):
        return asdict(settings)
    given = settings.opponent
    if given is not None and not is_reference(given) and Path(given).exists():
        settings = replace(settings, opponent=str(Path(given).resolve()))
    known = settings.maze in library_names() or is_suite(settings.maze)
    maze = settings.maze if known else maze_text_of(settings)
    return {**asdict(settings), "maze": maze}
