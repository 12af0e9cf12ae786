"""Tables, sentences, figures and the report of self-play in a small game."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pursuit.replays.viewer.data import Builder
from train.evaluation.small_game_replay import add_small_game
from train.files import Plain
from train.reports.curves import Panel, Series, draw_panels
from train.reports.figures import PALETTE
from train.reports.pages import PLAYER_ELEMENT, picture, section, write_page
from train.reports.tables import ResultTable, Row, in_markdown, numeric, words
from train.runs.folder import CURVE, REPORT
from train.self_play.report import (
    EPISODES,
    EXPLOITABILITY,
    describe_snapshots,
    known,
    settings_and_command,
    title_of,
)
from train.self_play.small_games import SmallGamePlay


def returns_table(results: Plain) -> ResultTable:
    """The returns of every player: a row for each of its policies, a column for each of those of
    all others."""
    rows: dict[tuple[str, str], Row] = {}
    for entry in results["returns"]:
        key = (entry["player"], entry["policy"])
        row = rows.setdefault(key, {"player": key[0], "policy": key[1]})
        row[f"against {entry['against']}"] = entry["return"]
    against = list(dict.fromkeys(entry["against"] for entry in results["returns"]))
    columns = [numeric(f"against {name}", f"against {name}", "z.4f") for name in against]
    return ResultTable([*rows.values()], [words("player"), words("policy"), *columns])


def describe_small_game(results: Plain) -> list[str]:
    """The results as sentences: exact NashConv, gains of best responses, and the game's value."""
    found, start = results["evaluation"], results.get("at_start", {})
    discount, players = results["discount"], results["players"]
    how = "undiscounted" if discount == 1.0 else f"discounted by {discount:g} per step"
    before = f" (at the start {start['nash_conv']:z.4f})" if "nash_conv" in start else ""
    zero = (
        "0 is an equilibrium" if results["zero_sum"] else "at 0 no player gains by another policy"
    )
    gains = ", ".join(f"{name} {found[f'{name}_gain']:z.4f}" for name in players)
    lines = [
        f"NashConv {found['nash_conv']:z.4f}{before}, exact, in returns {how}; {zero}.",
        f"Gain, by which a best response of the player beats its policy: {gains}.",
    ]
    if "game_value" in found:
        each = ", ".join(f"{name} {found[f'{name}_exploitability']:z.4f}" for name in players)
        lines.append(
            f"Return of {players[0]}: {found[f'{players[0]}_return']:z.4f}; value of the game: "
            f"{found['game_value']:z.4f}. Exploitability, lost to a best response: "
            f"{each}."
        )
    lines += describe_snapshots(results)
    if "frames" in results:
        lines.append(f"{results['frames']:,} frames in {results['seconds']:.1f} s.")
    return lines


def draw_curve(path: Path, rows: Sequence[Row], results: Plain, unit: str) -> None:
    """Draw NashConv, and the gain of every player's best response, over training time."""
    players, lines = results["players"], {"nash_conv": EXPLOITABILITY["nash_conv"]}
    for name, color in zip(players, PALETTE[:6] * len(players), strict=False):
        lines[f"{name}_gain"] = Series((), f"gain of a best response of {name}", color, "--", 1.3)
    panel = Panel(known(rows, unit, lines), "return, exact", scale="from 0")
    draw_panels(path, [[panel]], unit, title_of(results))


def write_small_game_report(
    folder: Path, trainee: SmallGamePlay, results: Plain, path: Path | None = None
) -> Path:
    """Write the report of self-play in a small game.

    Args:
        folder: of the run.
        trainee: the players.
        results: the contents of `results.json`.
        path: of the page; by default `report.html` in the folder.

    Raises:
        ValueError: the game's `draw` failed.
        OSError: it cannot be written.
    """
    builder, sides = Builder(), trainee.settings.sides
    policies: dict[str, Any] = {role: trainee.policy(role) for role in sides}
    labels = {role: own if isinstance(own, str) else own.algorithm for role, own in sides.items()}
    games = {f"game {number + 1}": number for number in range(EPISODES)}
    add_small_game(builder, trainee.task, policies, games, trainee.parts.discount, labels)
    who = ", ".join(f"{role} {label}" for role, label in labels.items())
    about = f"Run {folder.name}: {who}, opponents {results['sampling']}."
    parts = [
        in_markdown(about),
        *describe_small_game(results),
        PLAYER_ELEMENT,
        *section("NashConv over time", picture(folder / CURVE, "NashConv over time")),
        *section("Returns at the end", returns_table(results).markdown()),
        *section("Settings and command", *settings_and_command(folder, results)),
    ]
    path, title = path or folder / REPORT, title_of(results)
    write_page(path, title, parts, builder.data(title))
    return path
