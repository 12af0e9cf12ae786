"""The command `pursuit`."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

Form = TypeVar("Form")

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
    "render": "a replay of a run, or of the scripted agents, as GIF or MP4",
    "bench": "how fast this machine plays and learns",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a subcommand; errors are one line on stderr and exit status 2."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or given[0] in ("-h", "--help"):
        print(usage())
        return
    if given[0] == "--version":
        import pursuit

        print(f"pursuit {pursuit.__version__}")
        return
    name, rest = given[0], given[1:]
    if name not in COMMANDS:
        fail(f"unknown command {name!r}; one of {', '.join(COMMANDS)}")
    try:
        command(name)(rest)
    except BrokenPipeError:  # whoever read the output, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except (ValueError, OSError, ImportError) as error:
        fail(str(error))
    except KeyboardInterrupt:
        print(file=sys.stderr)
        sys.exit(130)


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


def fail(message: str) -> None:
    """One line on stderr, exit status 2."""
    print(f"pursuit: error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def command(name: str) -> Callable[[Sequence[str]], None]:
    """The function of a subcommand, imported only when it is called: torch takes seconds."""
    if name in ("train", "evaluate", "render", "levels"):
        from train.commands import train as training_commands

        return {
            "train": training_commands.train,
            "evaluate": training_commands.evaluate,
            "render": training_commands.render,
            "levels": training_commands.levels,
        }[name]
    if name == "ablate":
        from train.experiments import ablation

        return ablation.ablate
    if name in ("sweep", "report"):
        from train.commands import sweep as sweep_commands

        return {"sweep": sweep_commands.sweep, "report": sweep_commands.report}[name]
    if name == "solve":
        from train.commands.solve import solve

        return solve
    if name == "self-play":
        from train.commands.self_play import self_play

        return self_play
    if name == "league":
        from train.self_play.league import league

        return league
    if name == "bench":
        from train.commands.bench import bench

        return bench
    from train.commands import world as world_commands

    return {"baseline": world_commands.baseline, "maze": world_commands.maze}[name]


def parse(
    form: type[Form], arguments: Sequence[str], prog: str, default: Form | None = None
) -> Form:
    """`arguments` as the dataclass `form`, by tyro; its error boxes are folded into one line.

    Raises:
        ValueError: arguments that the form does not have, or values that it does not allow.
    """
    import tyro

    boxed = io.StringIO()
    extra: Any = {} if default is None else {"default": default}
    try:
        with contextlib.redirect_stderr(boxed), warnings.catch_warnings(record=True) as noted:
            warnings.simplefilter("always", UserWarning)
            parsed = tyro.cli(
                form,
                args=list(arguments),
                prog=f"pursuit {prog}",
                config=(
                    tyro.conf.OmitArgPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.HelptextFromCommentsOff,
                ),
                **extra,
            )
        for said in dict.fromkeys(str(warning.message) for warning in noted):
            print(f"pursuit: warning: {said}", file=sys.stderr)
        return parsed
    except SystemExit as exit_:
        if not exit_.code:
            raise
        text = re.sub(r"\x1b\[[0-9;]*m|[─╭╮╰╯│]+|-{5,}", " ", boxed.getvalue())
        text = " ".join(text.split("For full helptext")[0].split())
        text = re.sub(
            r"^(Value error|Parsing error|Unrecognized options|Required options)\s*", "", text
        )
        text = re.sub(r"Error parsing \S+: ", "", text)
        raise ValueError(f"{text} (see pursuit {prog} --help)") from None


if __name__ == "__main__":
    main()
