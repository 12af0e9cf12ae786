"""The command `pursuit`."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import pursuit
from pursuit.plugins import Registry, look_in
from train.commands.parse import fail
from train.files import check_utf8
from train.runs.interruption import Diverged, Signals, Stopped

# A text of our own rather than tyro's subcommands: those import the forms of all commands, and what
# these import, before `pursuit --help` can answer. A new command is an entry here.
USAGE = """usage: pursuit COMMAND [options]        (pursuit COMMAND --help tells the options)

Pursuit in mazes with reinforcement learning, beside the exact optimum.

New here? These three show what it is about, in a minute:
  pursuit maze 5x5
  pursuit baseline --maze 5x5
  pursuit train --maze 5x5 --seconds 30

Train an agent, and see how far it is from the exact optimum:
  train     train an agent, and compare it with the exact optimum
              pursuit train --task chase --role chaser --maze 5x5 --seconds 30 --out runs/first
  evaluate  evaluate a trained run again, on as many episodes as you like
              pursuit evaluate runs/first --episodes 10000
  baseline  random, scripted and optimal agents on a task: what can be reached
              pursuit baseline --task maze --maze 5x5 --num-goals 3
  play      play a game by hand: any seat, the optimum beside your steps
              pursuit play --maze 9x9 --role evader
  view      a page that plays episodes, with the exact optimum laid over; reports
              pursuit view runs/first
  render    a replay of a run, or of the scripted agents, as GIF or MP4
              pursuit render runs/first --out first.gif

Let agents learn from each other:
  self-play both sides learn against each other; exact exploitability
              pursuit self-play --maze 5x5 --seconds 60 --out runs/pair
  league    runs and scripted agents against each other: payoffs, ratings, cycles
              pursuit league runs/pair runs/first astar random --names pair first A-star chance

Compare, with seeds and intervals:
  reproduce the thesis' experiments again, claim by claim, with verdicts
              pursuit reproduce all --dry-run
  sweep     all runs of a sweep file, on this machine or on a Ray cluster
              pursuit sweep maze_by_size --dry-run
  ablate    curricula against each other: equal budgets, the same final difficulty
              pursuit ablate opponent-epsilon --dry-run
  compare   PPO of several libraries against each other, settings searched alike
              pursuit compare ppo --dry-run
  report    figures and tables of a sweep; curves of runs laid over each other
              pursuit report runs/first runs/second --x seconds --log

Look at the game itself:
  maze      show, check or generate a maze
              pursuit maze --generate prim --height 9 --loops 0.1
  solve     the exact game of a maze: value, mixed states, cop number, pictures
              pursuit solve --maze 5x5-tree
"""


@dataclass(frozen=True)
class Command:
    """A subcommand, as `USAGE` has it.

    Attributes:
        does: what it does, in a line.
        example: of its options, to be typed after its name.
    """

    does: str
    example: str


COMMANDS = {
    name: Command(does, example)
    for name, does, example in re.findall(
        r"^  (\S+) +(\S.*)\n {14}pursuit \S+ ?(.*)$", USAGE, re.MULTILINE
    )
}

COMMAND_PARTS: Registry[Callable[[Sequence[str]], None]] = Registry(
    "command", "a function that takes the arguments after its name", callable, ours=tuple(COMMANDS)
)
"""Commands of users' own: by entry points, or as `pursuit package.module:Name`."""

NARROWEST = 40
"""Columns that help is laid out for at least: tyro does not end in terminals of a few."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a subcommand; errors are one line on stderr and exit status 2.

    Other statuses: 1 where training diverged or runs of a sweep failed, 130 after Ctrl-C, 143 after
    SIGTERM, and 141 where whoever read the output has seen enough.
    """
    open_streams()
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    given = list(sys.argv[1:] if arguments is None else arguments)
    with Signals() as signals:
        try:
            try:
                obey(given)
            finally:
                sys.stdout.flush()  # a pipe that is closed shows here, not at Python's end
        except BrokenPipeError:  # `head`, say
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(141)
        except Diverged as error:
            fail(str(error), 1)
        except (ValueError, OSError, ImportError) as error:
            fail(in_words(error))
        except MemoryError:
            fail("this machine has not enough memory for that; take less of it")
        except KeyboardInterrupt as stop:
            if sys.stderr.isatty():
                print(file=sys.stderr)  # after the terminal's ^C
            sys.exit(stop.status if isinstance(stop, Stopped) else signals.status or 130)


def open_streams() -> None:
    """Have standard streams that are closed (`>&-`) take anything, and those that are open write
    what their encoding has not as escapes."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif name == "stdout" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def obey(given: list[str]) -> None:
    """Run the subcommand that the arguments name, or tell what there is."""
    for argument in given:
        check_utf8(argument)
    if not given or given[0] in ("-h", "--help"):
        print(USAGE, end="")
        return
    if given[0] == "--version":
        print(f"pursuit {pursuit.__version__}")
        return
    name, rest = given[0], given[1:]
    look_in(Path.cwd())  # where users keep parts of their own
    command(name)(rest)


def in_words(error: Exception) -> str:
    """What to say of an error; one of the system without its number."""
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def command(name: str) -> Callable[[Sequence[str]], None]:
    """The function of a subcommand: that of its name in the file of its name, or a user's own.

    Imported only when it is called, as some of what they need is slow to import. What imports torch
    is imported by the subcommand itself, once its options are accepted.
    """
    if name == "race":
        raise ValueError("unknown command 'race' (a race is a task); it is `pursuit compare` now")
    if name not in COMMANDS:
        return COMMAND_PARTS.get(name)
    module = name.replace("-", "_")
    function: Any = getattr(import_module(f"train.commands.{module}"), module)
    return function


if __name__ == "__main__":
    main()
