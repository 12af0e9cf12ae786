"""The picture at the top of docs/results/index.md: effects that are ratios, from the rows of their
studies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from train.experiments.analysis import module_at
from train.experiments.statistics import ratio_with_interval
from train.experiments.variants import against_control
from train.reports.figures import (
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    PlottedEstimate,
    draw_intervals,
)
from train.reports.tables import plain_table

COLORS = {"curricula": BLUE, "imitation": GREEN, "teams": PINK, "self_play_mixing": ORANGE}
SHOWN = 0.01
"""Smaller ratios are in the table, not in the picture: imitation against none."""


class Effect(NamedTuple):
    """The ratio of two distances to the optimum or equilibrium.

    Attributes:
        study: the name of its page.
        what: what is compared with what.
        units: the number and kind of the random units.
        ratio: geometric mean and ends of its 95 % interval.
    """

    study: str
    what: str
    units: str
    ratio: list[float]


def effects(data: Path) -> Iterator[Effect]:
    """The effects with which the pages of studies begin."""

    def of(study: str) -> Any:
        return module_at(data / study / "analysis.py")

    studies = of("curricula").studies_in(data / "curricula")
    for name, variant, what in (
        ("adaptive", "linear", "goals near the start first / none, 4 M frames"),
        ("order", "linear", "the same in other mazes"),
        ("goal-spread-start", "linear", "the same, 12 M frames"),
        ("opponent-epsilon", "n = 500", "falling epsilon of the opponent / none"),
    ):
        (row,) = [each for each in against_control(studies[name]) if each["variant"] == variant]
        ends = [row[f"ratio{end}"] for end in ("", "_low", "_high")]
        yield Effect("curricula", what, f"{row['mazes']} mazes", ends)
    imitation = of("imitation")
    gaps = imitation.gaps_in(data / "imitation")
    for one, two, what in (
        ("optimal", "none", "imitating the optimum / no imitation"),
        ("optimal", "astar", "imitating the optimum / A*"),
    ):
        logs = imitation.logs_of(gaps, one, two)
        yield Effect("imitation", what, f"{len(logs)} mazes", ratio_with_interval(logs))
    teams = of("teams")
    for budget, units in teams.cells_in(data / "teams").items():
        logs = [teams.mappo_against_ippo(unit) for unit in units]
        what = f"MAPPO / IPPO, equal {budget}"
        yield Effect("teams", what, f"{len(logs)} mazes", ratio_with_interval(logs))
    mixing = of("self_play_mixing")
    rows = mixing.judged(data / "self_play_mixing")
    share = mixing.shares(rows)
    apart = mixing.ratios(mixing.logs_of(rows, "ppo"), mixing.logs_of(rows, "mmd"))
    for name, _ in mixing.STRATA:
        logs = [value for game, value in apart.items() if mixing.stratum(share[game]) == name]
        what = f"PPO / MMD in self-play, mixed share {name}"
        yield Effect("self_play_mixing", what, f"{len(logs)} games", ratio_with_interval(logs))


def tables(data: Path) -> dict[str, str]:
    """The effects as numbers."""
    rows = [
        {
            "comparison": each.what,
            "ratio [95 %]": "{:.3g} [{:.3g}, {:.3g}]".format(*each.ratio),
            "units": each.units,
            "page": each.study,
        }
        for each in effects(data.parent)
    ]
    return {"effects": plain_table(rows).markdown()}


def figures(data: Path, out: Path) -> None:
    """A forest plot of the effects."""
    found = [
        PlottedEstimate(f"{each.what} ({each.units})", *each.ratio, (), COLORS[each.study])
        for each in effects(data.parent)
        if each.ratio[0] > SHOWN
    ]
    label = "ratio of gaps or NashConv;\nbelow 1: the first is nearer"
    draw_intervals(out / "effects.png", {label: ("ratio", found)}, "", also="png")
