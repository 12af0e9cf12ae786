"""Games by hand in a terminal, driven through a pseudo-terminal."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import sys
import time
from pathlib import Path

import pytest

from pursuit.replay import Replay
from train.play.kept import load_games
from train.play.seats import session_of
from train.play.terminal import action_of, lines_below
from train.settings.task import ReacherSettings, TaskSettings

ROOT = Path(__file__).parents[1]
UP, DOWN, RIGHT, LEFT = "\x1bOA", "\x1bOB", "\x1bOC", "\x1bOD"
"""What the arrow keys of an xterm send to whoever has asked for its keypad."""


class Terminal:
    """Python in a terminal of its own."""

    def __init__(self, *arguments: str) -> None:
        self.process, self.line = pty.fork()
        if self.process == 0:
            # Whoever runs the suite in the background ignores interrupts, and so would this one.
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.environ |= {"TERM": "xterm", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
            os.execv(sys.executable, [sys.executable, *arguments])
        self.seen = ""

    def wait_for(self, words: str, seconds: float = 60.0) -> None:
        """Read until it says so; the screen is redrawn in parts, so only new text is found."""
        until = time.monotonic() + seconds
        while words not in self.seen and time.monotonic() < until:
            if not self.read():
                break
        assert words in self.seen, self.seen

    def read(self) -> bool:
        """Some more of what it says; False where it has ended."""
        if select.select([self.line], [], [], 0.2)[0]:
            try:
                said = os.read(self.line, 65536)
            except OSError:  # so Linux says that the other end is closed
                return False
            self.seen += said.decode(errors="replace")
            return bool(said)
        return True

    def press(self, *keys: str) -> None:
        os.write(self.line, "".join(keys).encode())

    def end(self) -> int:
        """Its exit status, once it has ended by itself."""
        until = time.monotonic() + 60
        while self.read() and time.monotonic() < until:
            pass
        if time.monotonic() >= until:
            os.kill(self.process, signal.SIGKILL)
        status = os.waitpid(self.process, 0)[1]
        os.close(self.line)
        return os.waitstatus_to_exitcode(status)


KEYS = (UP, "s", "n", DOWN, RIGHT, "\x1b", "a", LEFT, "?", "W", "d", " ", UP, DOWN)
"""Two moves, the next game, nine moves with two keys between them that mean nothing."""
MOVES = [1, 2, 3, 3, 0, 2, 4, 0, 1]
GAME = """
from pursuit.task import make_task
from scripted_agents.environments import default_policies
from train.evaluation.contest import GameContest
from train.play.session import MazeSession
from train.play.terminal import play_in_terminal

task = make_task("race", maze="9x9", stay_action=True, max_steps=9)
policies = default_policies(task, 0.2)
session = MazeSession(GameContest(task, "runner", policies), "A*", policies["runner"], 1)
try:
    play_in_terminal(session)
except KeyboardInterrupt:
    print("stopped")
print("moves", [moves[0] for moves in session.actions], "of game", session.game)
"""


def played(terminal: Terminal, ending: str) -> str:
    """What stands in the terminal after a game that was played by `KEYS`, and the end of it."""
    terminal.wait_for("next game")
    terminal.press(*KEYS)
    terminal.wait_for("optimum")
    terminal.press(UP, ending)
    assert terminal.end() == 0, terminal.seen
    screen, _, after = terminal.seen.rpartition("\x1b[?1049l")
    assert "you" in screen and "not known" in screen and "Traceback" not in after
    return after


@pytest.mark.parametrize("ending", ["\x03", pytest.param("x", marks=pytest.mark.slow)])
def test_a_game_in_a_terminal_is_played_by_arrow_keys_and_letters(ending: str) -> None:
    after = played(Terminal("-c", GAME), ending)
    assert f"moves {MOVES} of game 1" in after and ("stopped" in after) == (ending == "\x03")


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["x", "\x03"])
def test_the_command_plays_in_a_terminal_and_keeps_the_game(ending: str, tmp_path: Path) -> None:
    terminal = Terminal(
        *("-m", "train.commands.main", "play", "--terminal", "--task", "race", "--maze", "9x9"),
        *("--stay-action", "--seed", "1", "--max-steps", "9", "--out", str(tmp_path / "hand")),
    )
    after = played(terminal, ending)
    assert re.search(r"you +9 steps", after) and "not known" in after
    (kept,) = load_games(tmp_path / "hand")
    assert kept.game == 1 and kept.name == "you"  # the first one was given up
    replay = Replay.load(tmp_path / "hand" / kept.file)
    assert replay.check() == []
    assert replay.episodes[0].actions[:, 0].tolist() == MOVES


def test_keys_that_a_game_does_not_have_do_nothing() -> None:
    session = session_of(TaskSettings(), "astar", 0)
    assert [action_of(session, ord(key)) for key in "wsda"] == [0, 1, 2, 3]
    assert [action_of(session, key) for key in (ord(" "), ord("q"), -1, 0, 410, 10**6)] == [
        None
    ] * 6
    arm = session_of(ReacherSettings(joints=2), "astar", 0)
    assert [action_of(arm, ord(key)) for key in "12qw "] == [
        [1, 0],
        [0, 1],
        [-1, 0],
        [0, -1],
        [0, 0],
    ]
    assert action_of(arm, ord("3")) is None and action_of(arm, ord("n")) is None
    assert lines_below(arm, "warning: full")[0] == "warning: full"
