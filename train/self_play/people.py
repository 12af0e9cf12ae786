"""People in a league: their games by hand, and what every entry does in the same ones.

A person has not met everybody, and never will. So each of their games is played again by every
entry of their role: from the same start, against the same opponent, with the same luck. Who does
better there has won against the other, as in the rest of the league.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy
from pursuit.simulator import Simulator
from pursuit.task import Task
from train.evaluation.games import play_out
from train.play.kept import KeptGame, is_by_hand, load_game, load_games, settings_of
from train.runs.tasks import task_of
from train.runs.worlds import GridWorld
from train.settings.checks import check
from train.settings.self_play import ROLES
from train.settings.task import TaskSettings


@dataclass(frozen=True)
class HandGame:
    """One game by hand, as a league takes it.

    Attributes:
        task: as it was played.
        opponents: the policy of every role; that of the person's own counts nothing.
        seed, game: it began as game `game` of a batch of that seed.
        steps: until capture, or until the game was cut.
    """

    task: Task
    opponents: dict[str, Policy]
    seed: int
    game: int
    steps: int


@dataclass(frozen=True)
class Person:
    """Somebody who has played by hand, in one role."""

    name: str
    role: str
    games: tuple[HandGame, ...]


@dataclass(frozen=True, eq=False)
class HandResults:
    """What came of a person's games.

    Attributes:
        name, role: of the person.
        steps: [entries of the role + 1, games] int64, the person's last.
    """

    name: str
    role: str
    steps: NDArray[np.int64]


def split_people(names: Sequence[str]) -> tuple[list[Path], list[str]]:
    """The folders of games by hand among the entries of a league, and the other entries."""
    folders = [Path(name) for name in names if is_by_hand(Path(name))]
    return folders, [name for name in names if not is_by_hand(Path(name))]


def settings_of_people(folders: Sequence[Path]) -> TaskSettings | None:
    """What the first game by hand was played by; None where there is none."""
    for folder in folders:
        for game in load_games(folder):
            return settings_of(game, folder)
    return None


def enter_people(folders: Sequence[Path], task: Task, entries: Sequence[str] = ()) -> list[Person]:
    """Whoever has played the games in these folders, in each role that they had.

    Args:
        folders: of games by hand.
        task: of the league.
        entries: the names of everybody else.

    Raises:
        ValueError: somebody of the name of an entry, a damaged folder, one without games, games of
            another kind than the league's, or replays that play differently now.
    """
    people: dict[tuple[str, str], list[HandGame]] = {}
    for folder in folders:
        games = load_games(folder)
        check(bool(games), f"{folder}: no game was played to its end; play one")
        for game in games:
            name = game.name
            check(name not in entries, f"{folder}: played by {name!r}, as an entry is called")
            role, played = _entered(folder, game, task)
            people.setdefault((game.name, role), []).append(played)
    return [Person(name, role, tuple(games)) for (name, role), games in people.items()]


def _entered(folder: Path, game: KeptGame, task: Task) -> tuple[str, HandGame]:
    where = f"{folder}: {game.file}"
    settings = settings_of(game, folder)
    own = task_of(settings)
    role = settings.agent.split("_")[0]
    check(
        role in ROLES and own.num_agents == 2,
        f"{where}: {role} of {own.num_agents} agent(s); a league rates people one against one",
    )
    for what in ("mazes", "num_goals", "stay_action", "move_order", "max_steps"):
        mine, theirs = getattr(own, what), getattr(task, what)
        if what == "mazes":
            same = [maze.to_text() for maze in mine] == [maze.to_text() for maze in theirs]
            check(same, f"{where}: in maze {mine[0].name}, and the league in {theirs[0].name}")
        else:
            check(mine == theirs, f"{where}: played with {what}={mine}; the league has {theirs}")
    episode = load_game(folder, game)
    start = Simulator(own, 1, game.seed, game.game)
    began = (start.positions[0].tolist(), start.goals[0].tolist())
    check(
        began == (episode.start["positions"], episode.start["goals"]),
        f"{where}: does not begin as game {game.game} of seed {game.seed}; restore it from a copy",
    )
    opponents = GridWorld(settings).opponents
    return role, HandGame(own, opponents, game.seed, game.game, episode.length)


def play_along(
    people: Sequence[Person], policies: Mapping[str, Sequence[Policy]]
) -> list[HandResults]:
    """Every game by hand again, by each of the policies of the person's role in their seat."""
    results = []
    for person in people:
        others = policies[person.role]
        steps = np.zeros((len(others) + 1, len(person.games)), dtype=np.int64)
        for number, game in enumerate(person.games):
            for place, policy in enumerate(others):
                steps[place, number] = _steps_of(policy, person.role, game)
            steps[-1, number] = game.steps
        results.append(HandResults(person.name, person.role, steps))
    return results


def _steps_of(policy: Policy, role: str, game: HandGame) -> int:
    simulator = Simulator(game.task, 1, game.seed, game.game, auto_restart=False)
    players = {**game.opponents, role: policy}
    filled = [players[each] for each in game.task.seat_roles]
    lengths, _ = play_out(simulator, filled, lambda games: games.ended, lambda games: games.ended)
    return int(lengths[0])
