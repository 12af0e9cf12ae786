"""`pursuit self-play`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import strftime
from typing import TYPE_CHECKING, Any

from train.commands.parse import Formats, budget_of, heard, parse
from train.commands.progress import Alive, carry_out, leave
from train.commands.tables import print_table
from train.figures import Look
from train.files import write_text
from train.runs.folder import CURVE, REPORT, SELF_PLAY, check_new
from train.self_play.averages import told_averages
from train.settings.checks import check
from train.settings.self_play import SelfPlaySettings

if TYPE_CHECKING:
    from train.runs.loop import Run


@dataclass(frozen=True)
class SelfPlayCommand:
    """Chasers and evaders learn against each other; every evaluation has the exact exploitability.

    Each role meets opponents from a pool of the other role's snapshots, another one in every game.
    To compare settings over several seeds: `pursuit sweep self_play_sampling`.
    """

    settings: SelfPlaySettings = field(default_factory=lambda: SelfPlaySettings(seconds=120.0))
    out: Path | None = None
    """A new folder; runs/self-play-MAZE-TIME if left out."""
    resume: Path | None = None
    """Go on with the self-play in this folder instead; all other options are taken from there."""
    episodes: int = 1000
    """Episodes of the final evaluation, where it is not exact."""
    format: Formats = ()
    """pdf, svg, or both: the curve is saved so, too, beside its .png."""


def self_play(arguments: Sequence[str]) -> None:
    """`pursuit self-play`."""
    default = SelfPlayCommand(SelfPlaySettings(**budget_of(arguments, 120.0)))
    given = parse(SelfPlayCommand, arguments, "self-play", default)
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    look = Look(given.format)
    name = f"self-play-{Path(given.settings.task.maze).stem}-{strftime('%Y%m%d-%H%M%S')}"
    out = given.out or Path("runs") / name
    if given.resume is None:
        check_new(out)
    else:
        check(given.resume.is_dir(), f"{given.resume}: no such folder")
    from train.experiments.kinds import resume, start  # torch is slow to import
    from train.self_play.pictures import draw_self_play
    from train.self_play.report import write_self_play_report

    with heard():
        if given.resume is None:
            run = start(SELF_PLAY, given.settings, out)
        else:
            run = resume(given.resume, SELF_PLAY)
    task, sampling = run.trainee.task, run.trainee.settings.sampling
    print(
        f"self-play: {task.name} on maze {task.mazes[0].name}, {task.num_chasers} chaser(s), "
        f"{task.num_evaders} evader(s); opponents: {sampling}"
    )
    run.trainee.tell = Alive()
    content = carry_out(run, given.episodes, "pursuit self-play")
    title = f"Self-play on {task.mazes[0].name} ({sampling})"
    draw_self_play(run.folder / CURVE, run.metrics.rows, title, look)
    write_self_play_report(run.folder, run.trainee, title, content)
    show(run, content)
    leave(run)


def show(run: Run, content: dict[str, Any]) -> None:
    """Print what was found."""
    from train.experiments.methods import METHODS, methods  # torch is slow to import
    from train.experiments.sweep_report import reduction
    from train.self_play.payoffs import matches_table
    from train.self_play.report import meaning_of_nash_conv, told_independent, told_whole_game

    found, matches = content["evaluation"], content["matches"]
    table = matches_table(matches)
    table.write(run.folder)
    write_text(run.folder / METHODS, methods([run.folder]))
    exact = not any(row["games"] for row in matches)
    print(
        f"\nsteps until capture, at most {run.trainee.task.max_steps} "
        f"({'exact' if exact else '± is the 95 % interval'}); chasers down, evaders across"
    )
    print_table(table, 100)
    start, end = content.get("at_start", {}).get("nash_conv"), found.get("nash_conv")
    if start is not None and end is not None:
        less = f"{reduction(start, end):.1f} % less"
        print(
            f"\nNashConv {start:.3f} -> {end:.3f} discounted steps, {less} "
            f"({meaning_of_nash_conv(content)})"
        )
    if content.get("averages"):
        print(told_averages(content["averages"]))
    if "game_value" in found and "value" in found:
        sight = " in full sight" if content.get("limited_sight") else ""
        print(f"value {found['value']:.3f}, of the game{sight} {found['game_value']:.3f}")
    if content.get("independent_team"):
        print(told_independent(content["independent_team"]))
    if content.get("whole_game"):
        print(told_whole_game(content["whole_game"]))
    for kind in ("exact", "approximate"):
        for name, steps in content.get(f"{kind}_best_response", {}).items():
            full = " of full sight" if kind == "exact" and content.get("limited_sight") else ""
            print(f"{kind} best response{full} {name.replace('_', ' the ')}: {steps:.2f} steps")
    print(f"results, curve, table, methods, pool and {REPORT}: {run.folder}")
