"""The command `pursuit`."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import re
import shutil
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path

import pursuit
from pursuit.plugins import Registry, look_in, reading
from train.commands.parse import fail, warnings_in_lines
from train.files import check_utf8
from train.runs.interruption import Diverged, Signals, Stopped

# Our own text rather than tyro's subcommands, which would import the modules of all commands before
# `pursuit --help` can answer. To add a command, add an entry here.
USAGE = """usage: pursuit COMMAND [options]        (pursuit COMMAND --help lists the options)

Pursuit in mazes with reinforcement learning and exact optima.

New here? These commands take a minute:
  pursuit demo
  pursuit baseline --maze 5x5
  pursuit train --maze 5x5 --seconds 30

Train and evaluate an agent:
  train     train an agent, and compare it with the exact optimum
              pursuit train --task chase --role chaser --maze 5x5 --seconds 30 --out runs/first
  evaluate  evaluate a trained run again, on any number of episodes
              pursuit evaluate runs/first --episodes 10000
  baseline  random, scripted and optimal agents on a task
              pursuit baseline --task maze --maze 5x5 --num-goals 3
  play      play a game by hand as any agent, compared with the optimum
              pursuit play --maze 9x9 --role evader
  demo      a page with exact values of scripted agents at play, without training
              pursuit demo
  view      an HTML page that plays episodes with exact values; reports of runs
              pursuit view runs/first
  render    a replay of a run or of scripted agents as GIF or MP4
              pursuit render runs/first --out first.gif
  export    the policy of a run as ONNX or as a program of torch.export
              pursuit export runs/first --out first.onnx
  warm-up   compile what the first training compiles, for images and clusters
              pursuit warm-up

Self-play:
  self-play train both roles against each other, with exact exploitability
              pursuit self-play --maze 5x5-tree --seconds 60 --out runs/pair
  league    runs and scripted agents against each other: payoffs, ratings, cycles
              pursuit league runs/pair astar random --names pair A-star random

Studies with several seeds and confidence intervals:
  reproduce repeat the experiments of the thesis, with a verdict for each claim
              pursuit reproduce all --dry-run
  sweep     all runs of a sweep file, on this machine or on a Ray cluster
              pursuit sweep maze_by_size --dry-run
  ablate    compare curricula at equal budgets and equal final difficulty
              pursuit ablate opponent-epsilon --dry-run
  compare   compare PPO of several libraries, each with tuned settings
              pursuit compare ppo --dry-run
  report    figures and tables of a sweep; learning curves of several runs
              pursuit report runs/first runs/second --x seconds --log

Mazes and exact solutions:
  maze      show, check or generate a maze
              pursuit maze --generate prim --height 9 --loops 0.1
  solve     the exact game of a maze, or of a small game (--game): value, mixed states
              pursuit solve --maze 5x5-tree
"""


COMMANDS: dict[str, str] = dict(
    re.findall(r"^  (\S+) +\S.*\n {14}pursuit \S+ ?(.*)$", USAGE, re.MULTILINE)
)
"""The arguments of the example of each subcommand, as listed in `USAGE`."""

COMMAND_PARTS: Registry[Callable[[Sequence[str]], None]] = Registry(
    "command", "a function that takes the arguments after its name", callable, ours=tuple(COMMANDS)
)
"""User-defined commands: from entry points, or as `pursuit package.module:Name`."""

NARROWEST = 40
"""Least number of columns of help texts: tyro does not terminate in very narrow terminals."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a subcommand; errors are one line on stderr and exit status 2.

    Other statuses: 1 if training diverged or runs of a sweep failed, 130 after Ctrl-C, 143 after
    SIGTERM, and 141 if the reader of the output closed the pipe.
    """
    # Imports make a million objects that are never freed: do not search them for cycles so often.
    gc.set_threshold(1_000_000)
    open_streams()
    if shutil.get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    given = list(sys.argv[1:] if arguments is None else arguments)
    with Signals() as signals, warnings_in_lines():
        try:
            try:
                run_command(given)
            finally:
                sys.stdout.flush()  # raises BrokenPipeError here instead of at exit
        except BrokenPipeError:  # for example `head`
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(141)
        except Diverged as error:
            fail(str(error), 1)
        except (ValueError, OSError, ImportError) as error:
            fail(message_of(error))
        except MemoryError:
            fail("not enough memory on this machine; use smaller settings")
        except KeyboardInterrupt as stop:
            if sys.stderr.isatty():
                print(file=sys.stderr)  # after the terminal's ^C
            sys.exit(stop.status if isinstance(stop, Stopped) else signals.status or 130)


def open_streams() -> None:
    """Replace closed standard streams (`>&-`), and write characters that the encoding of stdout
    does not have as escapes."""
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif name == "stdout" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def run_command(given: list[str]) -> None:
    """Run the subcommand in the arguments, or print the usage."""
    for argument in given:
        check_utf8(argument)
    if not given or given[0] in ("-h", "--help"):
        print(USAGE, end="")
        return
    if given[0] == "--version":
        print(f"pursuit {pursuit.__version__}")
        return
    name, rest = given[0], given[1:]
    look_in(Path.cwd())  # for user-defined parts
    if name not in COMMANDS:  # of the user, whose code may name what it likes
        command(name)(rest)
        return
    with reading("a file", given):
        command(name)(rest)


OPTIONAL = {
    "pygame": "render",
    "onnx": "export",
    "onnxruntime": "export",
    "onnxscript": "export",
    "minari": "export",
}
"""The extras with packages that are imported by others, which do not name them."""


def message_of(error: Exception) -> str:
    """The message of an error; of system errors without their number."""
    if isinstance(error, ModuleNotFoundError) and error.name in OPTIONAL:
        return f"{error.name} is not installed; pip install 'pursuit[{OPTIONAL[error.name]}]'"
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def command(name: str) -> Callable[[Sequence[str]], None]:
    """The function of a subcommand, built-in or user-defined.

    It is imported on demand, as some imports are slow. Subcommands import torch only after they
    have accepted their options.
    """
    if name == "race":
        raise ValueError("command 'race' was renamed; use `pursuit compare`")
    if name not in COMMANDS:
        return COMMAND_PARTS.get(name)
    own = name.replace("-", "_")
    module = "studies" if name in ("sweep", "ablate", "compare", "reproduce") else own
    return getattr(import_module(f"{__package__}.{module}"), own)


if __name__ == "__main__":
    main()
