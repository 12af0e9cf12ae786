"""The command `pursuit`."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import pursuit
from pursuit.parts import look_in
from train.commands.parse import fail
from train.runs.interruption import Diverged, Signals, Stopped

# A table of our own rather than tyro's subcommands: those want every form at hand, and so every
# module, with torch, before `pursuit maze --help` can answer.
COMMANDS = {
    "train": "train an agent, and compare it with the exact optimum",
    "evaluate": "evaluate a trained run again, on as many episodes as you like",
    "sweep": "all runs of a sweep file, on this machine or on a Ray cluster",
    "report": "figures and tables of a sweep",
    "ablate": "curricula against each other: equal budgets, the same final difficulty",
    "levels": "the levels that a replaying curriculum kept",
    "self-play": "both sides learn against each other; exact exploitability",
    "league": "runs and scripted agents against each other: payoffs, ratings, cycles",
    "solve": "the exact game of a maze: value, mixed states, cop number, pictures",
    "baseline": "random, scripted and optimal agents on a task",
    "maze": "show, check or generate a maze",
    "view": "a page that plays episodes of runs and replays, with the exact optimum laid over",
    "render": "a replay of a run, or of the scripted agents, as GIF or MP4",
    "bench": "how fast this machine plays and learns",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a subcommand; errors are one line on stderr and exit status 2.

    Other statuses: 1 where training diverged or runs of a sweep failed, 130 after Ctrl-C, 143 after
    SIGTERM, and 141 where whoever read the output has seen enough.
    """
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


def obey(given: list[str]) -> None:
    """Run the subcommand that the arguments name, or tell what there is."""
    if not given or given[0] in ("-h", "--help"):
        print(usage())
        return
    if given[0] == "--version":
        print(f"pursuit {pursuit.__version__}")
        return
    name, rest = given[0], given[1:]
    if name not in COMMANDS:
        fail(f"unknown command {name!r}; one of {', '.join(COMMANDS)}")
    look_in(Path.cwd())  # where users keep parts of their own
    command(name)(rest)


def in_words(error: Exception) -> str:
    """What to say of an error; one of the system without its number."""
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def usage() -> str:
    """What `pursuit --help` prints."""
    lines = [f"  {name:<10}{text}" for name, text in COMMANDS.items()]
    return "\n".join(
        [
            "usage: pursuit COMMAND [options]        (pursuit COMMAND --help tells the options)",
            "",
            "Pursuit in mazes with reinforcement learning, beside the exact optimum.",
            "",
            *lines,
            "",
            "Try: pursuit train --task chase --role chaser --maze 5x5 --seconds 30",
        ]
    )


def command(name: str) -> Callable[[Sequence[str]], None]:
    """The function of a subcommand: that of its name, in the file of its name.

    Imported only when it is called: torch takes seconds.
    """
    module = name.replace("-", "_")
    function: Any = getattr(import_module(f"train.commands.{module}"), module)
    return function


if __name__ == "__main__":
    main()
