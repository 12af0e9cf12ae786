"""The options of the commands that train, apart from the settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pursuit.validation import check
from train.commands.help import asks_help
from train.commands.parse import options_in


@dataclass(frozen=True, kw_only=True)
class RunCommand:
    """Options of commands that train."""

    out: Path | None = None
    """New folder for the run. None: runs/NAME-TIME."""
    config: Path | None = None
    """TOML file with settings by name, as --print-config writes it; in self-play a table for each
    side. Options on the command line take precedence."""
    print_config: bool = False
    """Print all settings as a file for --config, with comments at defaults, and exit."""
    resume: Path | None = None
    """Resume the run in this folder, with its settings. With --frames or --seconds it goes on with
    this longer budget; otherwise only --episodes, --exact-seconds, --report, --quiet and --allow
    may be given as well."""
    stretch: bool = False
    """With --resume and a longer budget: schedules, as of the learning rate and the curriculum,
    extend over the new budget. By default they keep their end."""
    episodes: int | None = None
    """Episodes of the final evaluation, if it is not exact. None: 1000, down to 100 in long games
    of many agents; with --resume that of the first command."""
    exact_seconds: float | None = None
    """Seconds that exact solutions of games of several agents may take at the end; 0 for none.
    Those that take about a second are always made. None: no limit; with --resume that of the first
    command."""
    quiet: bool = False
    """Print warnings and errors only."""
    report: bool = True
    """Write figures, a replay and a report at the end; --resume adds them after --no-report."""


def check_resumed(arguments: Sequence[str]) -> None:
    """Refuse options beside --resume that a resumed run does not apply; ValueError naming them."""
    given = options_in(arguments)
    if asks_help(arguments):
        return
    if given.get("resume", "None") in ("None", ""):
        check("stretch" not in given, "--stretch is for --resume RUN with a longer budget")
        return
    applied = {"resume", "episodes", "exact_seconds", "report", "no_report", "allow"}
    applied |= {"frames", "seconds", "stretch", "quiet"}
    others = [f"--{name.replace('_', '-')}" for name in given if name not in applied]
    check(
        not others,
        f"--resume {given['resume']} with {', '.join(others)}: a run is resumed with its own "
        "settings; leave these options out, or start a new run from its weights by "
        f"--init-from {given['resume']}",
    )
