"""The report of self-play: exploitability over time, payoff matrix, cycles, and replays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pursuit.replays.viewer.data import Builder, Extras
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents.limits import MAX_EXACT_WORK
from train.evaluation.contest import GameContest
from train.evaluation.recordings import MOST_OVERLAY_CELLS, recorded
from train.evaluation.scores import OUTCOME, OUTCOMES, UNTIL_CAPTURE
from train.evaluation.team_contest import describe_team
from train.files import Plain, read_json
from train.reports.curves import Panel, Series, draw_panels
from train.reports.figures import BLACK, BLUE, ORANGE, time_scale
from train.reports.pages import PLAYER_ELEMENT, details, pairs, picture, section, write_page
from train.reports.tables import in_markdown
from train.runs.folder import CONFIG, CURVE, REPLAYS, REPORT
from train.runs.report import made_with
from train.self_play.diversity import describe_diversity, spread
from train.self_play.league import Entry, LeagueTable, cycle_of, play_league
from train.self_play.payoffs import draw_league, legend_of, matches_table
from train.self_play.trainee import SelfPlay
from train.settings.self_play import ROLES

PAYOFF = "payoff.png"
EPISODES = 4
"""Number of episodes in the replay."""
SNAPSHOTS = 5
"""Number of snapshots per role in the payoff matrix, from the first to the last."""
GAMES = 20
"""Games per pair of snapshots, for results that are not exact."""


EXPLOITABILITY = {
    "nash_conv": Series((), "NashConv", BLACK, "-", 2.2),
    "chaser_exploitability": Series((), "of the chaser", ORANGE, "--", 1.3),
    "evader_exploitability": Series((), "of the evader", BLUE, "--", 1.3),
}
SCRIPTED = {"astar": ("A*", "-"), "random": ("random", ":"), "equilibrium": ("equilibrium", "--")}
AGAINST_SCRIPTED = {
    f"{role}_vs_{name}": Series((), f"{role} against {called}", color, style)
    for role, color in (("chaser", ORANGE), ("evader", BLUE))
    for name, (called, style) in SCRIPTED.items()
}


def draw_self_play(
    path: Path, rows: list[dict[str, float]], title: str, unit: str = "seconds"
) -> None:
    """Draw exploitability over training time, and below it both sides against the scripted agents.

    The axis has the `unit` of the budget, frames or seconds.
    """
    exits = "outcome" in rows[0]
    label, scale = (OUTCOME, "linear") if exits else ("steps until capture (log)", "log")
    panels = [Panel(known(rows, unit, AGAINST_SCRIPTED), label, scale=scale)]
    if exploitability := known(rows, unit, EXPLOITABILITY):
        unit_of = OUTCOME if exits else "discounted steps"
        label = f"exploitability, exact: lost to a\nbest response ({unit_of})"
        panels.insert(0, Panel(exploitability, label, scale="from 0"))
    draw_panels(path, [[panel] for panel in panels], unit, title)


def known(
    rows: Sequence[Mapping[str, float]], unit: str, lines: Mapping[str, Series]
) -> list[Series]:
    """The lines whose columns are in these rows, over training time, with their curves."""
    times = np.array([row[unit] for row in rows]) * time_scale(unit)
    return [
        replace(line, curves=[(times, np.array([row[name] for row in rows]))])
        for name, line in lines.items()
        if name in rows[0]
    ]


def title_of(results: Plain) -> str:
    """Of the figure and of the page."""
    where = f"in {results['game']}" if "game" in results else f"on {results['maze']}"
    return f"Self-play {where} ({results['sampling']})"


def write_self_play_report(
    folder: Path, trainee: SelfPlay, results: Plain, path: Path | None = None
) -> Path:
    """Write `report.html`, `replays.json` and `payoff.png` into the folder of self-play.

    Args:
        folder: of the run.
        trainee: the two sides.
        results: the contents of `results.json`.
        path: of the page, if not in the folder; then no replays are written.

    Raises:
        OSError: they cannot be written.
    """
    task = trainee.task
    pair = {role: trainee.policy(role) for role in ROLES}
    contest = GameContest(task, "chaser", pair)
    games = {f"game {number + 1}": number for number in range(EPISODES)}
    replay = recorded(contest, pair["chaser"], games, "learned")
    replay = replace(replay, players=dict.fromkeys(task.agent_names, "learned"))
    if path is None:
        replay.save(folder / REPLAYS)
    builder = Builder()
    sides = contest.sides(pair["chaser"], MOST_OVERLAY_CELLS)
    builder.add(replay, Extras(names=list(games), sides=sides))
    league = snapshots_league(trainee, task, pair)
    path = path or folder / REPORT
    payoff = path.with_name(PAYOFF)
    draw_league(payoff, league, f"{league.measure.unit}: snapshots against each other")
    players = {row[role] for row in results["matches"] for role in ROLES}
    legend = legend_of(players, trainee.settings.task.opponent_epsilon)
    unit = f"Mean {(OUTCOMES if task.most_exits else UNTIL_CAPTURE).unit}."
    title = title_of(results)
    about = f"Run {folder.name}: {results['algorithm']}, opponents {results['sampling']}."
    parts = [
        in_markdown(about),
        *describe_exploitability(results),
        PLAYER_ELEMENT,
        *section("Exploitability over time", picture(folder / CURVE, "exploitability over time")),
        *section("Matches at the end", matches_table(results["matches"]).markdown(), unit, legend),
        *section(
            "Snapshots against each other",
            picture(payoff, "payoff matrix of snapshots"),
            cycle_in_words(league),
        ),
        *section("Settings and command", *settings_and_command(folder, results)),
    ]
    write_page(path, title, parts, builder.data(title))
    return path


def snapshots_league(trainee: SelfPlay, task: Task, pair: Mapping[str, Policy]) -> LeagueTable:
    """A league of snapshots of both sides, from old to new, and of the current policies."""
    entries = []
    for role in ROLES:
        kept = trainee.pools[role].snapshots if role in trainee.pools else []
        entries += [Entry(one.name, role, one.policy) for one in spread(kept, SNAPSHOTS)]
        entries.append(Entry("now", role, pair[role]))
    return play_league(task, entries, GAMES, 0, MAX_EXACT_WORK)  # many pairs


def describe_exploitability(results: Plain) -> list[str]:
    """The results as sentences: exact NashConv and value, and best responses."""
    found, start = results["evaluation"], results.get("at_start", {})
    limited = bool(results.get("limited_view"))
    met = results.get("matches", ())
    fixed = [each for each in ROLES if any(row[each] == "frozen" for row in met)]
    meaning = "exact; 0 is an equilibrium"
    if fixed:
        part = found.get(f"{fixed[0]}_exploitability")
        shown = "" if part is None else f" {part:z.3f}"
        lost = f"exploitability{shown}, lost to a best response,"
        meaning = f"exact; {fixed[0]} fixed: its {lost} cannot fall"
    if limited:
        meaning = (
            "exact for best responses with full view, so an upper bound with a limited view, where "
            "equilibria can be above 0"
        )
    lines = []
    if "nash_conv" in found:
        before = f" (at the start {start['nash_conv']:.3f})" if "nash_conv" in start else ""
        unit = "discounted steps"
        if "outcome" in found:
            unit = f"{OUTCOME}, of best responses that may depend on time,"
        lines.append(f"NashConv {found['nash_conv']:z.3f} {unit}{before}; {meaning}.")
    for name, bounds in results.get("limited_best_responses", {}).items():
        what = f"Best response with the view of its role {name.replace('_', ' the ')}"
        what = "NashConv with these views" if name == "nash_conv" else what
        lines.append(f"{what}: {bounds[0]:.3f} to {bounds[1]:.3f} discounted steps, proven.")
    lines += describe_snapshots(results)
    if results.get("whole_game"):
        unit = OUTCOME if "outcome" in found else "discounted returns"
        lines.append(describe_whole_game(results["whole_game"], unit))
    if "game_value" in found and "value" in found:
        sight = " with full view" if limited else ""
        lines.append(
            f"Value of this pair of policies: {found['value']:.3f} discounted steps; of the game "
            f"at equilibrium{sight}: {found['game_value']:.3f}."
        )
        if found["game_value"] * (1.0 - results.get("discount", 1.0)) > 1.0 - 1e-9:
            lines.append(
                "The evader escapes from every start at equilibrium, so every chaser has "
                "exploitability 0."
            )
    for kind in ("exact", "approximate"):
        for name, steps in results.get(f"{kind}_best_response", {}).items():
            full = " with full view" if kind == "exact" and limited else ""
            against = name.replace("_", " the ")
            unit = OUTCOME if "outcome" in found else "steps"
            lines.append(f"{kind} best response{full} {against}: {steps:.2f} {unit}.".capitalize())
    for team in results.get("team", {}).values():
        lines += [f"{line[0].upper()}{line[1:]}." for line in describe_team(team)]
    lines.append(f"{results['frames']:,} frames in {results['seconds']:.1f} s.")
    return lines


def describe_snapshots(results: Plain) -> list[str]:
    """NashConv of the mixture of snapshots, and their diversity, as sentences."""
    lines = []
    if "mixture_nash_conv" in results:
        bounds = "{:.3f} to {:.3f}".format(*results["mixture_nash_conv"])
        which = "all snapshots" if results["sampling"] == "uniform" else "the Nash mixture"
        lines.append(f"NashConv of drawing from {which} in each game: {bounds}, proven.")
    if results.get("diversity"):
        lines.append(f"{describe_diversity(results['diversity'])}.")
    return lines


def describe_whole_game(found: Plain, unit: str = "discounted returns") -> str:
    """NashConv in returns of this unit as a sentence."""
    each = ", ".join(
        f"return of the {role} {value:.3f}, a best response gains {found['gains'][role]:.3f}"
        for role, value in found["returns"].items()
    )
    return f"NashConv in {unit}: {found['nash_conv']:.3f} ({each}; exact, each side one player)."


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
