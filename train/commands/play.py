"""`pursuit play`: the user plays an agent of a game in the browser."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pursuit.validation import check, rule
from train.commands.parse import fail, options_in, parse, take_allow_options
from train.play.browser import open_page
from train.play.outcome import total_line
from train.runs.interruption import Stopped
from train.settings.checks import Settings, evaluation_seed
from train.settings.task import AGENT, GAME, TaskSettings

if TYPE_CHECKING:
    from train.play.replay_folder import ReplayFolder
    from train.play.session import Session

PORT = rule(lambda value: 0 <= value < 2**16, "give 0 (any free port) to 65535")


@dataclass(frozen=True)
class PlayCommand(Settings):
    """Play a game in mazes yourself, in any role, and compare with the optimum from the same start.

    Opens a page that only this machine can reach; Ctrl-C stops the command. Move with the arrow
    keys or w, a, s, d; space stays (with --stay-action); n starts the next game.
    """

    task: TaskSettings = field(default_factory=TaskSettings)
    against: Annotated[str | None, AGENT] = None
    """The opponent: astar (default), equilibrium, random, uniform, searching, sweeping, belief,
    gathering, package.module:Name, or the folder of a run, which also sets the task."""
    beside: Annotated[str | None, AGENT] = None
    """The agent to compare with, which plays your role from the same starts. Values as of
    --against; by default astar, or for a run of self-play its other side."""
    seed: int | None = None
    """Seed of the games; random by default. Training never uses their starts."""
    out: Path | None = None
    """Save finished games as replays to this folder, for `pursuit view`."""
    name: str = "you"
    """Your name in these replays."""
    port: Annotated[int, PORT] = 0
    """Port of the page; any free port by default."""
    browser: bool = True
    """Open a browser, or only print the address of the page."""


def play(arguments: Sequence[str]) -> None:
    """`pursuit play`."""
    arguments = take_allow_options(arguments)  # before the run is read
    options = options_in(arguments)
    check(
        "game" not in options and options.get("task") != GAME,
        "small games cannot be played by hand; watch policies with `pursuit view` and a run",
    )
    against, run = options.get("against"), None
    if against and Path(against).is_dir():
        from train.runs.folder import CONFIG

        if (Path(against) / CONFIG).exists():
            from train.play.setup import game_of_run  # torch is slow to import

            run = game_of_run(against)
    given = parse(PlayCommand, arguments, "play", PlayCommand(run or TaskSettings()))
    task = settings_of(given, "opponent_epsilon" in options)
    from train.play.replay_folder import ReplayFolder
    from train.play.setup import session_of  # torch is slow to import
    from train.runs.opponents import is_self_play

    beside = given.beside or "astar"
    if given.beside is None and given.against and is_self_play(Path(given.against)):
        beside = given.against
    seed = secrets.randbelow(2**32) if given.seed is None else given.seed
    session = session_of(task, beside, evaluation_seed(seed))
    keeper = None if given.out is None else ReplayFolder(given.out, given.name)
    print(f"{session.title()}\npreparing ...", flush=True)
    session.prepare()
    on_page(session, given.port, given.browser, keeper)
    if keeper is not None and keeper.added:
        print(f"replays: {keeper.folder}")
    if line := total_line(session.outcomes):
        print(line)
    if keeper is not None and keeper.added < len(session.outcomes):
        lost = len(session.outcomes) - keeper.added
        fail(
            f"{keeper.folder}: {lost} of {len(session.outcomes)} finished games could not be "
            "written; free disk space, or give a writable folder",
            1,
        )


def settings_of(given: PlayCommand, epsilon_given: bool = False) -> TaskSettings:
    """The task with its opponent; an equilibrium has no random moves unless epsilon is given.

    Raises:
        ValueError: two opponents for one side.
    """
    task, against = given.task, given.against
    if against is None:
        return task
    check(
        task.opponent is None,
        f"against={against!r} and opponent={task.opponent!r} both set the opponent; give one",
    )
    if against == "equilibrium" and not epsilon_given:
        task = replace(task, opponent_epsilon=0.0)
    from train.play.setup import of_side  # torch is slow to import

    return of_side(replace(task, opponent=against))


def on_page(session: Session, port: int, browser: bool, keeper: ReplayFolder | None) -> None:
    """Serve the page until Ctrl-C."""
    from train.play.server import PlayServer

    def over(session: Session) -> None:
        print(f"\ngame {session.game + 1}")
        print("\n".join(session.outcomes[-1].lines()), flush=True)
        if keeper is not None:
            keeper.keep(session)

    with closing(PlayServer(session, port, over)) as server:
        opened = browser and open_page(server.address)
        print(f"{'opened' if opened else 'open'} {server.address}")
        print("stop with Ctrl-C", flush=True)
        try:
            server.serve()
        except KeyboardInterrupt as stop:
            if isinstance(stop, Stopped) and stop.status != 130:
                raise
            if sys.stderr.isatty():
                print(file=sys.stderr)  # after the terminal's ^C
