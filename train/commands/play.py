"""`pursuit play`: a person in a seat of a game, in the browser or in the terminal."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from train.commands.parse import fail, heard, named_task, parse, taken_allowed
from train.play.browser import open_page
from train.play.kept import Keeper
from train.play.outcome import total_line
from train.play.server import PlayServer
from train.play.session import Session
from train.play.terminal import play_in_terminal
from train.runs.folder import CONFIG
from train.runs.interruption import Stopped
from train.settings.checks import check, evaluation_seed
from train.settings.task import AnyTask, ReacherSettings, TaskSettings


@dataclass(frozen=True)
class PlayCommand:
    """Play a game by hand: any seat of any task, with the optimum from the same start after it.

    Opens a page on this machine, for nobody else; --terminal plays without a browser. Ctrl-C ends
    it. Arrow keys or w, a, s, d move, space stays where there is a stay action, n begins the next
    game; --role says who you are.
    """

    task: AnyTask = field(default_factory=TaskSettings)
    against: str | None = None
    """Who plays the other side: astar (by default), optimal, random, searching, sweeping,
    belief, package.module:Name, or the folder of a run, whose game is played then."""
    beside: str | None = None
    """Who plays the same starts in your seat, to compare: as --against; astar by default, the other
    side of the same run against self-play."""
    seed: int | None = None
    """Of the games; others every time if left out. None is ever trained on, whatever the seed."""
    out: Path | None = None
    """Keep the games that are finished in this folder, as replays: `pursuit view` shows them, and
    `pursuit league` rates whoever played them."""
    name: str = "you"
    """What such games call you."""
    terminal: bool = False
    """Play in this terminal."""
    port: int = 0
    """Of the page; any that is free if left out."""
    no_browser: bool = False
    """Only print the address of the page."""


def play(arguments: Sequence[str]) -> None:
    """`pursuit play`."""
    arguments = taken_allowed(arguments)  # before the run is read, which may name their modules
    task = named_task(arguments)
    against, run = option("against", arguments), None
    if against and (Path(against) / CONFIG).exists() and isinstance(task, TaskSettings):
        from train.play.seats import game_of_run  # torch is slow to import

        run = game_of_run(against)
    given = parse(PlayCommand, arguments, "play", PlayCommand(run or task))
    check(0 <= given.port < 2**16, f"port={given.port}; 0 for any that is free, to 65535")
    task = settings_of(given, bool(option("opponent-epsilon", arguments)))
    session = session_for(given, task)
    if given.terminal:
        check_terminal()
    keeper = None if given.out is None else Keeper(given.out, given.name, task)
    print(session.title())
    if given.terminal:
        in_terminal(session, keeper)
    else:
        on_page(session, given.port, not given.no_browser, keeper)
    if keeper is not None and keeper.added:
        print(f"kept: {keeper.folder}")
    line = total_line(session.outcomes)
    if line:
        print(line)
    if keeper is not None and keeper.added < len(session.outcomes):
        lost = len(session.outcomes) - keeper.added
        fail(
            f"{keeper.folder}: {lost} of {len(session.outcomes)} finished games could not be "
            "written and are lost; make room, or give a folder that can be written",
            1,
        )


def option(name: str, arguments: Sequence[str]) -> str:
    """What an option of this name is given; nothing if it is not."""
    before = ""
    for argument in arguments:
        if before == f"--{name}":
            return argument
        told, _, value = argument.partition("=")
        before = told.replace("_", "-")
        if value and before == f"--{name}":
            return value
    return ""


def settings_of(given: PlayCommand, epsilon_given: bool = False) -> AnyTask:
    """The game, and who plays the other side of it; optimal ones err only where that is asked for.

    Raises:
        ValueError: two opponents for one side, or one of an arm.
    """
    task, against = given.task, given.against
    if against is None:
        return task
    if isinstance(task, ReacherSettings):
        raise ValueError(f"against={against!r}; an arm has no other seats, leave it out")
    check(
        task.opponent is None,
        f"against={against!r} and opponent={task.opponent!r}; both say who plays the other side, "
        "give one",
    )
    if against == "optimal" and not epsilon_given:
        task = replace(task, opponent_epsilon=0.0)
    from train.play.seats import of_side  # torch is slow to import

    return of_side(replace(task, opponent=against))


def session_for(given: PlayCommand, task: AnyTask) -> Session:
    """The games that the command asks for."""
    from train.play.seats import is_self_play, session_of  # torch is slow to import

    beside = given.beside or "astar"
    if given.beside is None and given.against and is_self_play(Path(given.against)):
        beside = given.against
    seed = secrets.randbelow(2**32) if given.seed is None else given.seed
    with heard():
        return session_of(task, beside, evaluation_seed(seed))


def on_page(session: Session, port: int, browser: bool, keeper: Keeper | None) -> None:
    """Serve the page until Ctrl-C."""

    def over(session: Session) -> None:
        print(f"\ngame {session.game + 1}")
        print("\n".join(session.outcomes[-1].lines()), flush=True)
        if keeper is not None:
            keeper.keep(session)

    with PlayServer(session, port, over) as server:
        opened = browser and open_page(server.address)
        print(f"{'opened' if opened else 'open'} {server.address}")
        print("Ctrl-C ends it", flush=True)
        try:
            server.serve()
        except KeyboardInterrupt as stop:
            if isinstance(stop, Stopped) and stop.status != 130:
                raise
            if sys.stderr.isatty():
                print(file=sys.stderr)  # after the terminal's ^C


def check_terminal() -> None:
    """ValueError where this is none."""
    check(
        sys.stdin.isatty() and sys.stdout.isatty(),
        "--terminal needs a terminal: input and output are not redirected; leave it out for a page",
    )


def in_terminal(session: Session, keeper: Keeper | None) -> None:
    """Play here until the person has enough."""
    try:
        play_in_terminal(session, None if keeper is None else keeper.keep)
    except KeyboardInterrupt as stop:
        if isinstance(stop, Stopped) and stop.status != 130:
            raise
    for number, outcome in enumerate(session.outcomes, start=1):
        print(f"\ngame {number} of those that were finished")
        print("\n".join(outcome.lines()))
