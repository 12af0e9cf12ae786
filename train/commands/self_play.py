"""`pursuit self-play`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import tyro

from train.commands.parse import (
    default_budget,
    options_in,
    parse,
    parse_known,
)
from train.commands.progress import (
    ProgressLine,
    RunCommand,
    exit_after_signal,
    finish_run,
    start_or_resume,
)
from train.files import write_text
from train.reports.tables import print_table
from train.runs.folder import CURVE, REPORT, SELF_PLAY
from train.self_play.learners import complete
from train.settings.algorithms import Hyperparameters
from train.settings.self_play import LEARN, SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings


@dataclass(frozen=True)
class Options(SelfPlaySettings):
    """The settings of self-play, without those of other algorithms than PPO (`other_options`)."""

    chaser_hyper: Annotated[Any, tyro.conf.Suppress] = None
    evader_hyper: Annotated[Any, tyro.conf.Suppress] = None


@dataclass(frozen=True)
class _First:
    """The options that determine which other options exist."""

    task: TaskSettings = field(default_factory=TaskSettings)
    chaser: str = LEARN
    evader: str = LEARN
    chaser_algorithm: str = "ppo"
    evader_algorithm: str = "ppo"
    gamma: float = self_play_ppo().gamma
    gamma_end: float | None = None
    recurrent: str | None = None


if TYPE_CHECKING:
    from train.runs.loop import Run


@dataclass(frozen=True)
class SelfPlayCommand(RunCommand):
    """Train chasers and evaders against each other, with exact exploitability at every evaluation.

    Each role plays against the latest policy of the other role, or with another --sampling against
    its snapshots. To compare settings over several seeds: `pursuit sweep self_play_sampling`.
    Options of PPO apply to every role that uses it. Those of other algorithms are prefixed with the
    role: `pursuit self-play --chaser-algorithm dqn --help` shows --chaser-batch-size.
    """

    settings: Options
    others: Any = None


def self_play(arguments: Sequence[str]) -> None:
    """`pursuit self-play`."""
    given, settings = parsed(arguments)
    name = f"self-play-{Path(settings.task.maze).stem}"
    run, final = start_or_resume(SELF_PLAY, settings, given, name)
    from train.self_play.report import (  # torch is slow to import
        draw_self_play,
        write_self_play_report,
    )

    task, sampling = run.trainee.task, run.trainee.settings.sampling
    print(
        f"self-play: {task.name} on maze {task.mazes[0].name}, {task.num_chasers} chaser(s), "
        f"{task.num_evaders} evader(s); opponents: {sampling}"
    )
    run.trainee.tell = ProgressLine()
    content = finish_run(run, final.episodes, "pursuit self-play")
    title = f"Self-play on {task.mazes[0].name} ({sampling})"
    draw_self_play(run.folder / CURVE, run.metrics.rows, title)
    write_self_play_report(run.folder, run.trainee, title, content)
    show(run, content)
    exit_after_signal(run)


def parsed(arguments: Sequence[str]) -> tuple[SelfPlayCommand, SelfPlaySettings]:
    """The command in `arguments`, and its settings with those of every algorithm that learns.

    Raises:
        ValueError: unknown options or invalid values.
    """
    first = vars(parse_known(_First(), arguments))
    same = {name: first.pop(name) for name in ("gamma", "gamma_end", "recurrent")}
    whole = complete(
        SelfPlaySettings(**first, hyper=replace(self_play_ppo(), **same), frames=1)  # any budget
    )
    others = {role: getattr(whole, f"{role}_hyper") for role in whole.other_learners}
    del first["task"]
    if whole.hyper is None:
        first |= {"hyper": None} | {f"{role}_hyper": hyper for role, hyper in others.items()}
    default = SelfPlayCommand(
        Options(**first, **default_budget(options_in(arguments), 120.0)), other_options(others)
    )
    given = parse(SelfPlayCommand, arguments, "self-play", default)
    found = {f.name: getattr(given.settings, f.name) for f in fields(SelfPlaySettings)}
    for role, hyper in others.items():
        own = {f.name: getattr(given.others, f"{role}_{f.name}") for f in fields(hyper)}
        found[f"{role}_hyper"] = type(hyper)(**own)
    return given, SelfPlaySettings(**found)


def other_options(others: Mapping[str, Hyperparameters]) -> Any:
    """An instance of a dataclass with the settings of other algorithms than PPO, by option.

    Args:
        others: the settings by role.
    """
    options = []
    for role, hyper in others.items():
        hints = get_type_hints(type(hyper))
        help_text = tyro.conf.arg(help=f"See `pursuit train --help`; for the {role}s.")
        options += [
            (
                f"{role}_{f.name}",
                Annotated[hints[f.name], help_text],
                field(default=getattr(hyper, f.name)),
            )
            for f in fields(hyper)
        ]
    return make_dataclass("Others", options, frozen=True)()


def show(run: Run, content: dict[str, Any]) -> None:
    """Print the results."""
    from train.experiments.methods import METHODS, methods  # torch is slow to import
    from train.self_play.payoffs import matches_table
    from train.self_play.report import describe_exploitability

    matches = content["matches"]
    table = matches_table(matches)
    table.write(run.folder)
    write_text(run.folder / METHODS, methods([run.folder]))
    exact = not any(row["games"] for row in matches)
    print(
        f"\nsteps until capture, at most {run.trainee.task.max_steps} "
        f"({'exact' if exact else '± is the 95 % interval'}); rows: chasers, columns: evaders; "
        f"astar: epsilon {run.trainee.settings.task.opponent_epsilon:g}"
    )
    print_table(table, 100)
    print("", *describe_exploitability(content), sep="\n")
    print(f"results, curve, table, methods, pool and {REPORT}: {run.folder}")
