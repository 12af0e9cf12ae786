"""The report of self-play: exploitability over time, who beats whom, cycles, and replays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pursuit.policy import Policy
from pursuit.recorder import Recorder
from pursuit.replay import Replay
from pursuit.simulator import Simulator
from pursuit.task import Task
from pursuit.viewer.data import Builder, Extras, Side
from scripted_agents import action_values
from train.evaluation.closeups import MOST_OVERLAY_CELLS, called_by_sight
from train.evaluation.games import is_exact, table_in
from train.files import read_json
from train.pages import PLAYER_ROOM, details, pairs, paragraph, picture, section, table, write_page
from train.runs.folder import CONFIG, CURVE, REPLAYS, REPORT
from train.self_play.averages import told_averages
from train.self_play.league import Entry, LeagueTable, cycle_of, play_league
from train.self_play.pictures import draw_league
from train.settings.checks import EVALUATION_SEED
from train.settings.self_play import ROLES

PAYOFF = "payoff.png"
EPISODES = 4
"""Shown of the two sides."""
SNAPSHOTS = 5
"""Of each role that meet each other, from the first to the last."""
GAMES = 20
"""Of each pair of them, which count where the result is not exact."""


def write_self_play_report(
    folder: Path, trainee: Any, title: str, results: Mapping[str, Any], path: Path | None = None
) -> Path:
    """Write `report.html`, `replays.json` and `payoff.png` into the folder of self-play.

    Args:
        folder: of the run.
        trainee: the two sides, as they are now.
        title: of the page.
        results: what `results.json` holds.
        path: of the page, if it is to be elsewhere; then no replays are written.

    Raises:
        OSError: they cannot be written.
    """
    task = trainee.task
    pair = {role: trainee.policy(role) for role in ROLES}
    replay = recorded_pair(task, pair, EPISODES)
    if path is None:
        replay.save(folder / REPLAYS)
    builder = Builder()
    sides = sides_of_pair(task, pair)
    names = [episode.label for episode in replay.episodes]
    builder.add(replay, Extras(names=names, sides=sides))
    league = snapshots_league(trainee, task, pair)
    path = path or folder / REPORT
    payoff = path.with_name(PAYOFF)
    draw_league(payoff, league, "steps until capture: snapshots against each other")
    parts = [
        paragraph(
            f"{folder.name}: {results['algorithm']}, opponents {results['sampling']}", "faint"
        ),
        *told_exploitability(results),
        PLAYER_ROOM,
        section("Exploitability over time", picture(folder / CURVE, "exploitability over time")),
        section("Matches at the end", match_table(results)),
        section(
            "Snapshots against each other",
            picture(payoff, "payoff matrix of snapshots"),
            cycle_in_words(league),
        ),
        section("How it was made", made(folder, results)),
    ]
    write_page(path, title, parts, builder.data(title))
    return path


def recorded_pair(task: Task, pair: Mapping[str, Policy], episodes: int) -> Replay:
    """The first games of the evaluation between two sides."""
    found = []
    actions = np.zeros((1, task.num_agents), dtype=np.int32)
    policies = [pair[role] for role in task.seat_roles]
    for game in range(episodes):
        simulator = Simulator(task, 1, EVALUATION_SEED, first_game=game, auto_restart=False)
        recorder = Recorder(simulator)
        while not simulator.ended[0]:
            simulator.act(policies, actions)
            simulator.step(actions)
        found.append(replace(recorder.stop().episodes[0], label=f"game {game + 1}"))
    players = dict.fromkeys(task.agent_names, "learned")
    return Replay(task, tuple(found), seed=EVALUATION_SEED, players=players)


def sides_of_pair(task: Task, pair: Mapping[str, Policy]) -> list[Side]:
    """The best responses of a duel's sides to each other, beside what they learned."""
    if not is_exact(task, *pair.values()) or task.max_cells > MOST_OVERLAY_CELLS:
        return []
    tables = {role: table_in(task, pair[role]) for role in ROLES}
    sides = []
    for role, other in (ROLES, ROLES[::-1]):
        found = action_values(
            role,  # type: ignore[arg-type]
            task.mazes[0],
            tables[other],
            horizon=task.max_steps,
            stay_action=task.stay_action,
            move_order=task.move_order,  # type: ignore[arg-type]
        )
        seat = task.seat(role)
        name = called_by_sight(task, f"{role}_0")
        sides.append(Side(name, seat, 1 - seat, found.values, tables[role], found.optimal))
    return sides


def snapshots_league(trainee: Any, task: Task, pair: Mapping[str, Policy]) -> LeagueTable:
    """Some snapshots of both sides, from old to new, and the sides as they are."""
    entries = []
    for role in ROLES:
        kept = trainee.pools[role].snapshots if role in trainee.pools else []
        chosen = np.unique(np.linspace(0, len(kept) - 1, min(SNAPSHOTS, len(kept))).astype(int))
        entries += [Entry(kept[n].name, role, kept[n].policy) for n in chosen.tolist()]
        entries.append(Entry("now", role, pair[role]))
    return play_league(task, entries, GAMES, 0)


def told_exploitability(results: Mapping[str, Any]) -> list[str]:
    """NashConv and value in words, where they are exact."""
    found, start = results["evaluation"], results.get("at_start", {})
    told = []
    if "nash_conv" in found:
        before = f" (at the start {start['nash_conv']:.3f})" if "nash_conv" in start else ""
        told.append(
            f"NashConv {found['nash_conv']:.3f} discounted steps{before}; "
            f"{meaning_of_nash_conv(results)}."
        )
    if results.get("averages"):
        told.append(f"{told_averages(results['averages'])}.")
    if results.get("whole_game"):
        told.append(told_whole_game(results["whole_game"]))
    if "game_value" in found and "value" in found:
        sight = " in full sight" if results.get("limited_sight") else ""
        told.append(f"Value {found['value']:.3f}; of the game{sight} {found['game_value']:.3f}.")
    if results.get("independent_team"):
        told.append(f"{told_independent(results['independent_team'])}.".capitalize())
    told.append(f"{results['frames']:,} frames in {results['seconds']:.1f} s.")
    return [paragraph(text) for text in told]


def meaning_of_nash_conv(results: Mapping[str, Any]) -> str:
    """What a NashConv in `results.json` says, in words."""
    if results.get("limited_sight"):
        return (
            "exact for best responses that see everything, so a bound under limited sight, where "
            "an equilibrium need not reach 0"
        )
    return "exact; 0 is an equilibrium"


def told_independent(found: Mapping[str, float]) -> str:
    """What chasers that draw on their own can hold, in words."""
    lower, upper = found["lower"], found["upper"]
    return (
        f"chasers that draw on their own can hold {lower:.3f} to {upper:.3f} at best "
        f"(proven, {100 * (upper / lower - 1):.2f} % wide)"
    )


def told_whole_game(found: Mapping[str, Any]) -> str:
    """NashConv of a game that pays its sides, in words."""
    each = ", ".join(
        f"{role} is paid {paid:.3f} and could gain {found['gains'][role]:.3f}"
        for role, paid in found["returns"].items()
    )
    return (
        f"NashConv of what the sides are paid, discounted: {found['nash_conv']:.3f} ({each}; "
        "exact, each side one player)."
    )


def match_table(results: Mapping[str, Any]) -> str:
    """Everybody against everybody: chasers down, evaders across."""
    matches = results["matches"]
    evaders = list(dict.fromkeys(row["evader"] for row in matches))
    rows = []
    for chaser in dict.fromkeys(row["chaser"] for row in matches):
        steps = [f"{row['steps']:.2f}" for row in matches if row["chaser"] == chaser]
        rows.append((chaser, *steps))
    return table(("chaser \\ evader", *evaders), rows)


def cycle_in_words(league: LeagueTable) -> str:
    """Whether each is the best answer to the one before, in a circle."""
    cycle = cycle_of(league)
    if not cycle:
        return paragraph("No cycle of best responses among these.")
    chain = " -> ".join([*cycle, cycle[0]])
    return paragraph(f"Each is the best answer to the one before, in a circle: {chain}.")


def made(folder: Path, results: Mapping[str, Any]) -> str:
    """Settings, versions, machine and command."""
    config = read_json(folder / CONFIG)
    told = {
        "command": config.pop("command", ""),
        "machine": ", ".join(f"{name} {value}" for name, value in results["machine"].items()),
        "versions": ", ".join(f"{name} {value}" for name, value in results["versions"].items()),
    }
    config.pop("maze_text", None)
    return pairs(told) + details("settings", pairs(config))
