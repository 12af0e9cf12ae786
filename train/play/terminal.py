"""A game by hand in a terminal: arrow keys, letters, and the pictures that are text."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from train.play.arm_session import ArmSession
from train.play.outcome import total_line
from train.play.session import MazeSession, Session

try:
    import curses
except ImportError:  # Python for Windows comes without it
    curses = None  # type: ignore[assignment]

LETTERS = "wsda "
"""Keys in the order of the actions."""
FORTH, BACK = "123456789", "qwertyuio"
"""Keys that turn a joint of an arm to the left, and to the right: those of every joint are one
below the other."""


def play_in_terminal(session: Session, after: Callable[[Session], None] | None = None) -> None:
    """Play until the person presses `x`, or Ctrl-C.

    Args:
        session: what is played.
        after: called whenever a game is over; a ValueError or OSError of it is told, and the game
            goes on.

    Raises:
        ValueError: the terminal can do nothing but print, or Python has no curses.
    """
    if curses is None:
        raise ValueError("--terminal needs curses: pip install windows-curses, or leave it out")
    try:
        curses.wrapper(_play, session, after)
    except curses.error as error:
        raise ValueError(
            f"this terminal cannot show a game ({error}); set TERM=xterm, say"
        ) from None


def action_of(session: Session, key: int) -> Any:
    """The action that a key means in this game; None for none."""
    if isinstance(session, MazeSession):
        arrows = (curses.KEY_UP, curses.KEY_DOWN, curses.KEY_RIGHT, curses.KEY_LEFT)
        letter = LETTERS.find(chr(key)) if 0 < key < 128 else -1
        action = arrows.index(key) if key in arrows else letter
        return action if 0 <= action < session.task.num_actions else None
    assert isinstance(session, ArmSession)
    joints = session.task.joints
    turns = [0.0] * joints
    for keys, sign in ((FORTH, 1.0), (BACK, -1.0)):
        joint = keys[:joints].find(chr(key)) if 0 < key < 128 else -1
        if joint >= 0:
            turns[joint] = sign
            return turns
    return turns if key == ord(" ") else None


def help_of(session: Session) -> str:
    """The keys, in a line."""
    if isinstance(session, MazeSession):
        stays = "space stays" if session.task.stay_action else "a move into a wall waits"
        return f"arrow keys or w a s d; {stays}; n: next game; x: end"
    assert isinstance(session, ArmSession)
    joints = session.task.joints
    return (
        f"{' '.join(FORTH[:joints])}: turn a joint left; {' '.join(BACK[:joints])}: right; "
        "space waits; n: next game; x: end"
    )


def lines_below(session: Session, told: str) -> list[str]:
    """What stands below the picture: the result of a game that is over, and the keys."""
    lines = []
    if session.over:
        lines = [*session.outcomes[-1].lines(), total_line(session.outcomes)]
    return [line for line in (*lines, told, help_of(session)) if line]


def _play(screen: Any, session: Session, after: Callable[[Session], None] | None) -> None:
    if curses.has_colors():
        curses.use_default_colors()
    with contextlib.suppress(curses.error):  # of a terminal that always shows it
        curses.curs_set(0)
    told = ""
    while True:
        _show(screen, session, lines_below(session, told))
        key = screen.getch()
        if key in (ord("x"), ord("X"), -1):  # the last where the terminal is gone
            return
        lower = key + 32 if ord("A") <= key <= ord("Z") else key
        if lower == ord("n"):
            session.next_game()
        action = action_of(session, lower)
        if action is None or session.over:
            continue
        session.move(action)
        if session.over and after is not None:
            try:
                after(session)
                told = ""
            except (ValueError, OSError) as error:
                told = f"warning: {error}"


def _show(screen: Any, session: Session, below: list[str]) -> None:
    """Draw what fits: of a picture that is too large the part around the person's agent."""
    height, width = screen.getmaxyx()
    above = [session.title()] if height > len(below) + 6 else []
    room = max(height - len(above) - len(below), 1)
    picture, own, top, left = session.text().splitlines(), _own_place(session), 0, 0
    if own is not None and len(picture) > room:
        top = min(max(own[0] - room // 2, 0), len(picture) - room)
    if own is not None and max(map(len, picture)) > width:
        left = max(own[1] - width // 2, 0)
    lines = [*above, *(line[left:] for line in picture[top : top + room]), *below]
    screen.erase()
    for number, line in enumerate(lines[:height]):
        screen.insnstr(number, 0, line, width)  # which, unlike adding, may fill the last place
    if own is not None:
        row, column = own[0] - top + len(above), own[1] - left
        if row < height and column < width:
            screen.chgat(row, column, 1, curses.A_REVERSE | curses.A_BOLD)
    screen.refresh()


def _own_place(session: Session) -> tuple[int, int] | None:
    """The line and the column of the person's agent in the picture; None where there is none."""
    if not isinstance(session, MazeSession):
        return None
    maze = session.task.mazes[int(session.simulator.maze_index[0])]
    cell = int(session.simulator.positions[0, session.seat])
    return 2 * int(maze.rows[cell]) + 1, 2 * int(maze.columns[cell]) + 1
