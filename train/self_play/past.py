"""The past of a run of self-play: how its snapshots are ordered by Elo and by exploitability.

Elo asks who does better against the others, exploitability what a perfect opponent gains. Where all
are tables both are exact: no game is played.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import kendalltau, rankdata

from pursuit.task import Task
from scripted_agents import best_response, duel_wins, mean_over_starts, solve_chase
from train.evaluation.games import is_exact, table_in
from train.runs.folder import (
    MISFITS,
    RESULTS,
    SELF_PLAY,
    load_config,
    load_results,
    read_metrics,
)
from train.self_play.parts import self_play_from_plain, self_play_parts
from train.self_play.ratings import elo_of
from train.self_play.side import SideParts
from train.self_play.standing import other_role
from train.settings.checks import check
from train.settings.self_play import ROLES, SelfPlaySettings
from train.tensors import read_tensors

Column = NDArray[np.float64]
REMEDY = "this is of self-play of a duel in one maze with full sight, where both sides learned"
GAMES = 200
"""Of each two snapshots, as many as `pursuit league` plays by default. Each wins exactly its
expected share of them; `elo_of` adds half a win each way."""
APART = (1, 2, 4, 8, 16)
"""Snapshots between two of them: where each group of pairs begins."""


@dataclass(frozen=True, eq=False)
class Past:
    """The snapshots of both sides.

    Attributes:
        settings, task, discount: of the run; the discount is that of the exact game.
        names: by role, of the snapshots, the oldest first.
        frames: by role, [snapshots] float64, when they were taken.
        tables: by role, [own cell, other cell, action] of each.
        mixtures: by role, the shares of the last Nash mixture of double oracle, by names; {}
            without one, and before there are results.
    """

    settings: SelfPlaySettings
    task: Task
    discount: float
    names: dict[str, list[str]]
    frames: dict[str, Column]
    tables: dict[str, list[Column]]
    mixtures: dict[str, dict[str, float]]


@dataclass(frozen=True, eq=False)
class Standings:
    """How the snapshots of one side stand, the oldest first.

    Attributes:
        role, names: of whom.
        frames: [snapshots] float64, when they were taken.
        elo: [snapshots] float64, mean 1500, of `GAMES` games of each two: who does better from the
            same start against the same snapshot of the other side.
        exploitability: [snapshots] float64 >= 0, in discounted steps.
        steps: [snapshots, snapshots of the other side] float64, expected steps until capture, cut
            at the task's horizon.
    """

    role: str
    names: list[str]
    frames: Column
    elo: Column
    exploitability: Column
    steps: Column


def read_past(folder: Path) -> Past:
    """The snapshots that a run of self-play has kept.

    Raises:
        ValueError: no such run, one that has no tables or fewer than 4 snapshots of a side, or a
            damaged snapshot.
    """
    check(folder.is_dir(), f"{folder}: no such folder")
    kind, plain = load_config(folder)
    check(kind == SELF_PLAY, f"{folder}: a run of kind {kind!r}; {REMEDY}")
    settings = self_play_from_plain(plain, str(folder))
    check(
        settings.learning == ROLES, f"{folder}: only the {settings.learning[0]} learned; {REMEDY}"
    )
    parts = self_play_parts(settings)
    names: dict[str, list[str]] = {}
    tables: dict[str, list[Column]] = {}
    for role in ROLES:
        files = sorted((folder / "pool" / role).glob("*.pt"))
        told = f"{folder}: {len(files)} snapshots of the {role}"
        check(len(files) >= 4, f"{told}; at least 4 are needed to order them")
        names[role] = [path.stem for path in files]
        tables[role] = [_table(path, parts.task, parts.sides[role]) for path in files]
    frames = {role: _frames(folder, settings, names[role]) for role in ROLES}
    mixtures = load_results(folder).get("mixtures", {}) if (folder / RESULTS).exists() else {}
    return Past(settings, parts.task, parts.discount, names, frames, tables, mixtures)


def _table(path: Path, task: Task, side: SideParts) -> Column:
    greedy = not side.algorithm.learns_distribution
    try:
        policy = side.algorithm.load(side.hyper, side.seat, read_tensors(path), greedy)
    except MISFITS as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ValueError(f"{path}: damaged, or of another run ({reason}); remove it") from None
    check(is_exact(task, policy), f"{path}: no table (it remembers, or the game is none); {REMEDY}")
    return table_in(task, policy)


def _frames(folder: Path, settings: SelfPlaySettings, names: list[str]) -> Column:
    """[snapshots] when each was taken: its number is its share of the budget."""
    shares = np.array([int(name) for name in names]) / settings.snapshots
    if settings.frames is not None:
        return np.asarray(shares * settings.frames)
    rows = read_metrics(folder)
    seconds, frames = ([row[unit] for row in rows] for unit in ("seconds", "frames"))
    return np.asarray(np.interp(shares * float(settings.seconds or 1.0), seconds, frames))


def standings(past: Past) -> dict[str, Standings]:
    """Elo and exploitability of all snapshots, by role."""
    task, found = past.task, {}
    for role in ROLES:
        how: Any = (task.max_steps, task.move_order, task.min_start_distance)
        wins, steps = duel_wins(
            role,  # type: ignore[arg-type]
            task.mazes[0],
            past.tables[role],
            past.tables[other_role(role)],
            *how,
        )
        found[role] = Standings(
            role,
            past.names[role],
            past.frames[role],
            elo_of(wins, GAMES),
            exploitabilities(task, role, past.tables[role], past.discount),
            steps,
        )
    return found


def exploitabilities(task: Task, role: str, tables: list[Column], discount: float) -> Column:
    """[tables] float64: what the best response to each gains over the value of the game.

    That is in discounted steps, mean over all starts in distinct cells, as
    `train.evaluation.exploitability` has it of a pair.
    """
    maze, responder = task.mazes[0], other_role(role)
    sign = 1.0 if role == "chaser" else -1.0
    rest: Any = (None, discount, task.stay_action, task.move_order)
    game = solve_chase(maze, discount, task.stay_action, None, rest[-1]).values
    best = [best_response(responder, maze, table, *rest).values for table in tables]  # type: ignore[arg-type]
    return np.array([mean_over_starts(sign * (values - game), maze) for values in best])


# -- how far the two orders agree ------------------------------------------------------------------


def agreement(one: Standings) -> dict[str, float]:
    """Kendall's tau between Elo and minus exploitability, with its p (of independent snapshots).

    Of all snapshots and of the later half; and of each with the frames: "elo_time" is 1 where Elo
    never falls, "exploitability_time" is 1 where exploitability never rises.
    """
    half = len(one.elo) // 2
    pairs = {
        "whole": (one.elo, -one.exploitability),
        "second_half": (one.elo[half:], -one.exploitability[half:]),
        "elo_time": (one.elo, one.frames),
        "elo_time_second_half": (one.elo[half:], one.frames[half:]),
        "exploitability_time": (-one.exploitability, one.frames),
        "exploitability_time_second_half": (-one.exploitability[half:], one.frames[half:]),
    }
    found = {}
    for name, (first, second) in pairs.items():
        tau = kendalltau(first, second)
        found[name], found[f"{name}_p"] = float(tau.statistic), float(tau.pvalue)
    return found


def parted(one: Standings) -> NDArray[np.bool_]:
    """[snapshots, snapshots] whether Elo orders two one way and exploitability the other."""
    by_elo = np.sign(one.elo[:, None] - one.elo[None])
    by_gain = np.sign(one.exploitability[:, None] - one.exploitability[None])
    return np.asarray(by_elo * by_gain > 0.0)


def parted_by_distance(one: Standings) -> list[dict[str, Any]]:
    """The share of pairs that are ordered differently, by how many snapshots lie between them."""
    apart = np.subtract.outer(np.arange(len(one.elo)), np.arange(len(one.elo)))
    differ, rows = parted(one), []
    for low, high in zip(APART, [*APART[1:], len(one.elo)], strict=True):
        here = (apart >= low) & (apart < high)
        if here.any():
            row = {"role": one.role, "least": low, "most": min(high, len(one.elo)) - 1}
            rows.append(row | {"pairs": int(here.sum()), "parted": float(differ[here].mean())})
    return rows


def widest(one: Standings, count: int = 3) -> list[tuple[int, int]]:
    """The pairs that part most: (better by Elo, better by exploitability), at most `count`.

    That is by ranks, where the two orders disagree by the more in the one that disagrees less.
    """
    elo, gain = rankdata(-one.elo), rankdata(one.exploitability)
    width = np.minimum(elo[None] - elo[:, None], gain[:, None] - gain[None])
    order = np.argsort(-width, axis=None, kind="stable")[:count]
    pairs = [divmod(int(place), len(elo)) for place in order]
    return [(first, second) for first, second in pairs if width[first, second] > 0.0]


def rows_of(one: Standings) -> list[dict[str, Any]]:
    """A row for each snapshot: frames, Elo, exploitability, and its rank by either."""
    ranks = rankdata(-one.elo, "min"), rankdata(one.exploitability, "min")
    columns: Mapping[str, Any] = {
        "snapshot": one.names,
        "frames": one.frames.tolist(),
        "elo": one.elo.tolist(),
        "exploitability": one.exploitability.tolist(),
        "rank_by_elo": ranks[0].astype(int).tolist(),
        "rank_by_exploitability": ranks[1].astype(int).tolist(),
    }
    values = zip(*columns.values(), strict=True)
    return [{"role": one.role} | dict(zip(columns, row, strict=True)) for row in values]
