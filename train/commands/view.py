"""`pursuit view`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pursuit.validation import check
from train.commands.parse import parse, warn
from train.commands.progress import ProgressLine
from train.files import check_new_files
from train.play.browser import open_page
from train.reports.pages import PLAYER_ELEMENT, write_page
from train.reports.tables import in_markdown
from train.settings.checks import Settings, Shown

if TYPE_CHECKING:
    from pursuit.replays.viewer.data import Builder


@dataclass(frozen=True)
class ViewCommand(Settings):
    """Write a page that plays episodes, and open it in the browser if there is one.

    For one run, also of self-play, the page is its report. For several runs or replays, the page
    plays their episodes one by one or side by side; episodes of runs of one task have the same
    starts. The page is one file without network requests.
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of runs, and replays (.json)."""
    at: str | None = None
    """Play policies that were kept at so many frames, or best; as in pursuit evaluate."""
    out: Path | None = None
    """The output page; by default report.html of a run, otherwise replay.html."""
    episodes: Shown = 4
    """Episodes of each run, if several runs or replays are shown."""
    overwrite: bool = False
    """Replace --out if it exists."""
    open: bool = True
    """Open the page in a browser, or only write it."""


def view(arguments: Sequence[str]) -> None:
    """`pursuit view`."""
    given = parse(ViewCommand, arguments, "view")
    check(bool(given.paths), "nothing to view; give the folder of a run, or a replay (.json)")
    for path in given.paths:
        check(path.exists(), f"{path}: no such file or folder; give a run, or a replay (.json)")
    check_new_files([given.out], given.overwrite, given.paths)
    runs = any(path.is_dir() for path in given.paths)
    check(runs or given.at is None, "--at is for runs, but only replays are given; leave it out")
    from train.runs.folder import KEPT, SIDE, read_config

    alone = len(given.paths) == 1 and given.paths[0].is_dir() and given.at is None
    alone = alone and read_config(given.paths[0])[0] not in (SIDE, KEPT)
    page = report_again(given.paths[0], given.out) if alone else together(given)
    print(f"page: {page}")
    if given.open:
        open_page(page.resolve().as_uri())


def report_again(folder: Path, out: Path | None) -> Path:
    """Write the report of a run again, from the files in its folder."""
    from train.kinds import evaluate_runs, open_run, read_settings  # torch is slow to import
    from train.runs.folder import SELF_PLAY, load_results
    from train.runs.opponents import load_policy
    from train.runs.parts import contest_of
    from train.runs.report import write_report
    from train.runs.saved import load_settings, trains_team
    from train.self_play.report import write_self_play_report

    kind, _ = read_settings(folder)
    with closing(ProgressLine()) as tell:
        evaluate_runs([folder], tell)
    if kind == SELF_PLAY:
        trainee: Any = open_run(folder).trainee
        return write_self_play_report(folder, trainee, load_results(folder), out)
    settings, results = load_settings(folder), load_results(folder)
    policy = load_policy(folder, greedy=settings.evaluate == "greedy")
    episodes = results["evaluation"]["episodes"]
    contest = contest_of(settings.task, episodes, team=trains_team(folder))
    return write_report(folder, settings, contest, policy, results, out)


def together(given: ViewCommand) -> Path:
    """One page for several runs and replays."""
    from pursuit.replays.viewer.data import Builder

    page = given.out or Path("replay.html")
    check_new_files([page], given.overwrite)
    builder = Builder()
    for path in given.paths:
        add_run(builder, path, given) if path.is_dir() else add_replay(builder, path)
    check(bool(builder.items), "these replays contain no episodes; give others")
    title = ", ".join(path.name for path in given.paths)
    for warning in builder.warnings:
        warn(warning)
    text = [f"Warning: {in_markdown(warning)}" for warning in builder.warnings]
    write_page(page, title, [*text, PLAYER_ELEMENT], builder.data(title))
    return page


def add_run(builder: Builder, folder: Path, given: ViewCommand) -> None:
    """The first episodes of the evaluation of a run."""
    from train.runs.opponents import load_policy  # torch is slow to import
    from train.runs.parts import contest_of
    from train.runs.saved import evaluated_settings, trains_team

    settings, episodes = evaluated_settings(folder), given.episodes
    policy = load_policy(folder, settings.evaluate == "greedy", given.at)
    contest = contest_of(settings.task, max(episodes, 2), team=trains_team(folder))
    name = folder.name if given.at is None else f"{folder.name} at {given.at}"
    games = {f"{name}, episode {number + 1}": number for number in range(episodes)}
    contest.add_episodes(builder, policy, games, settings.algorithm)


def add_replay(builder: Builder, path: Path) -> None:
    """The episodes of a file."""
    from pursuit.replays.replay import Replay
    from pursuit.replays.viewer.data import Extras

    replay = Replay.load(path)
    labels = [each.label or f"episode {n + 1}" for n, each in enumerate(replay.episodes)]
    try:
        builder.add(replay, Extras(names=[f"{path.stem}, {label}" for label in labels]))
    except ValueError as error:  # an invalid start
        raise ValueError(f"{path}: {error}") from None
