"""`pursuit render`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from pursuit.validation import check, passes
from train.commands.parse import options_in, parse
from train.files import check_folder, check_new_files
from train.settings.checks import Settings, Shown
from train.settings.reading import names_of
from train.settings.task import TaskSettings
from train.settings.task_form import AnyTask, default_task


@dataclass(frozen=True)
class RenderCommand(Settings):
    """Render episodes of a run, or of scripted agents on a task, as GIF or MP4."""

    run: Annotated[Path | None, tyro.conf.Positional, passes(check_folder)] = None
    """The folder of the run; by default the scripted agents play."""
    task: AnyTask = field(default_factory=TaskSettings)
    at: str | None = None
    """The policy that was kept at so many frames, or best; as in pursuit evaluate."""
    out: Path = Path("replay.gif")
    """A new .gif or .mp4 file."""
    overwrite: bool = False
    """Replace --out if it exists."""
    episodes: Shown = 3
    """Number of episodes."""
    optimal: bool = False
    """The exactly optimal agent plays instead of the learned or scripted one."""


def render(arguments: Sequence[str]) -> None:
    """`pursuit render`."""
    options = options_in(arguments)
    default = RenderCommand(task=default_task(options))
    given = parse(RenderCommand, arguments, "render", default)
    check_new_files([given.out], given.overwrite)
    check(given.run is not None or given.at is None, "--at is for a run; give its folder")
    if given.run is not None:
        own = names_of(type(given.task))
        named = [f"--{name.replace('_', '-')}" for name in options if name in own]
        check(
            not named,
            f"{', '.join(named)} with {given.run}, but a run is rendered in its training task; "
            "leave out these options or the run",
        )
    from pursuit.rendering.animation import save_animation
    from train.runs.opponents import load_policy  # torch is slow to import
    from train.runs.parts import contest_of
    from train.runs.saved import evaluated_settings, trains_team

    policy: Any  # of the kind of its contest
    if given.run is not None:
        policy, task = load_policy(given.run, at=given.at), evaluated_settings(given.run).task
        contest = contest_of(task, 2, team=trains_team(given.run))
    else:
        given.task.check_used()
        contest = contest_of(given.task, 2)
        policy = contest.scripted()
    if given.optimal:
        policy = contest.best_policy()
    save_animation(given.out, contest.scenes(policy, given.episodes))
    print(f"{given.out}: {given.episodes} episode(s)")
