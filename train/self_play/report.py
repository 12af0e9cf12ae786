"""The report of self-play: exploitability over time, payoff matrix, cycles, and replays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pursuit.replays.viewer.data import Builder
from scripted_agents.exact.limits import MAX_EXACT_WORK
from train.evaluation.diversity import spread
from train.files import Plain, read_json
from train.reports.curves import draw_panels
from train.reports.pages import (
    PLAYER_ELEMENT,
    details,
    embedded_picture,
    pairs,
    section,
    write_page,
)
from train.reports.tables import in_markdown
from train.runs.folder import CONFIG, CURVE, REPLAYS, REPORT
from train.runs.report import made_with
from train.self_play.league import Entry, LeagueTable, cycle_of, play_league
from train.self_play.payoffs import draw_league
from train.self_play.trainee import SelfPlay

PAYOFF = "payoff.png"
EPISODES = 4
"""Number of episodes in the replay."""
SNAPSHOTS = 5
"""Number of snapshots per role in the payoff matrix, from the first to the last."""
GAMES = 20
"""Games per pair of snapshots, for results that are not exact."""


def title_of(results: Plain) -> str:
    """Of the figure and of the page."""
    where = f"in {results['game']}" if "game" in results else f"on {results['maze']}"
    return f"Self-play {where} ({results['sampling']})"


def draw_self_play(
    path: Path, trainee: SelfPlay, rows: Sequence[Mapping[str, float]], title: str
) -> None:
    """Draw the evaluations over training time, in the unit of the budget, frames or seconds."""
    unit = trainee.settings.budget_unit
    panels = trainee.game.panels(rows, unit)
    draw_panels(path, [[panel] for panel in panels], unit, title)


def write_self_play_report(
    folder: Path, trainee: SelfPlay, results: Plain, path: Path | None = None
) -> Path:
    """Write `report.html`, and for two sides `payoff.png`, into the folder of self-play; in mazes
    also `replays.json`.

    Args:
        folder: of the run.
        trainee: all sides.
        results: the contents of `results.json`.
        path: of the page, if not in the folder; then nothing else is written.

    Raises:
        ValueError: a game that draws its states failed to.
        OSError: they cannot be written.
    """
    game, policies, builder = trainee.game, trainee.policies, Builder()
    sides = trainee.settings.sides
    labels = {role: own if isinstance(own, str) else own.algorithm for role, own in sides.items()}
    games = {f"game {number + 1}": number for number in range(EPISODES)}
    replay = game.add_episodes(builder, policies, games, labels)
    if replay is not None and path is None:
        replay.save(folder / REPLAYS)
    title = title_of(results)
    who = ", ".join(f"{role} {label}" for role, label in labels.items())
    shown = []
    for each in game.tables(results):
        shown += section(each.title, each.table.markdown(), each.unit, each.legend)
    if len(game.roles) == 2:
        league = snapshots_league(trainee, policies)
        with TemporaryDirectory() as beside:  # the page embeds the picture
            payoff = (folder if path is None else Path(beside)) / PAYOFF
            draw_league(payoff, league, f"{league.measure.unit}: snapshots against each other")
            matrix = embedded_picture(payoff, "payoff matrix of snapshots")
        shown += section("Snapshots against each other", matrix, cycle_in_words(league))
    parts = [
        in_markdown(f"Run {folder.name}: {who}, opponents {results['sampling']}."),
        *game.describe(results),
        PLAYER_ELEMENT,
        *section(
            "Evaluations over time", embedded_picture(folder / CURVE, "evaluations over time")
        ),
        *shown,
        *section("Settings and command", *settings_and_command(folder, results)),
    ]
    path = path or folder / REPORT
    write_page(path, title, parts, builder.data(title))
    return path


def snapshots_league(trainee: SelfPlay, policies: Mapping[str, Any]) -> LeagueTable:
    """A league of snapshots of both sides, from old to new, and of the current policies."""
    entries = []
    for role in trainee.game.roles:
        kept = spread(trainee.pools[role].snapshots, SNAPSHOTS)
        entries += [Entry(one.name, role, one.policy) for one in kept]
        entries.append(Entry("now", role, policies[role]))
    return play_league(trainee.game, entries, GAMES, 0, MAX_EXACT_WORK)  # many pairs


def cycle_in_words(league: LeagueTable) -> str:
    """The cycle of best responses as a sentence."""
    cycle = cycle_of(league)
    if not cycle:
        return "No cycle of best responses among these."
    chain = in_markdown(" -> ".join([*cycle, cycle[0]]))
    return f"Cycle in which each is the best response to the previous one: {chain}."


def settings_and_command(folder: Path, results: Plain) -> list[str]:
    """The section on settings, versions, machine and command."""
    config = read_json(folder / CONFIG)
    config.pop("maze_text", None)
    command = config.pop("command", "")
    return [made_with(command, results), details("settings", pairs(config))]
