"""A league: all chasers against all evaders, with ratings and their doubts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.policy import Policy
from pursuit.task import Task
from scripted_agents.environments import (
    SCRIPTED,
    is_own_policy,
    own_policy,
    own_roles,
    scripted_policy,
)
from train.algorithms.registry import entry as algorithm_entry
from train.evaluation.games import half_width, is_exact
from train.evaluation.matchups import match, play_pair
from train.runs.folder import CONFIG, SELF_PLAY, load_config
from train.runs.opponents import check_fits, load_policy
from train.runs.saved import load_settings
from train.runs.tasks import task_of
from train.self_play.ratings import (
    best_response_cycle,
    elo_ratings,
    nash_average,
    openskill_ratings,
    pairwise_wins,
    preference_cycle,
)
from train.settings.checks import check
from train.settings.self_play import ROLES
from train.settings.task import TaskSettings


@dataclass(frozen=True)
class Entry:
    """Somebody in one role."""

    name: str
    role: str
    policy: Policy


@dataclass(frozen=True, eq=False)
class LeagueTable:
    """What a league found; payoffs are steps until capture, cut at the task's horizon.

    Attributes:
        payoff, ci95: [chasers, evaders] float64; the half width is 0 where the payoff is exact.
        lengths: [chasers, evaders, games] int64, of the games played.
        chasers, evaders: their names.
    """

    chasers: list[str]
    evaders: list[str]
    payoff: NDArray[np.float64]
    ci95: NDArray[np.float64]
    lengths: NDArray[np.int64]


def enter(
    names: Sequence[str], maze: str, opponent_epsilon: float = 0.0, greedy: bool = False
) -> tuple[Task, list[Entry]]:
    """The task of the league, and whoever takes part.

    Args:
        names: folders of runs, and names of scripted agents and of users' own policies.
        maze: where scripted agents play if there is no run.
        opponent_epsilon: share of random moves of astar.
        greedy: learned policies take their most probable action instead of drawing.

    Raises:
        ValueError: an entry that is no run, of another game, given twice, or a role without entry.
    """
    runs: list[tuple[str, Path]] = []
    for name in names:
        check(list(names).count(name) == 1, f"two entries are called {name!r}; give it once")
        if name in SCRIPTED or is_own_policy(name):
            continue
        folder = Path(name)
        check(
            folder.is_dir(),
            f"{name}: no folder of a run, and no scripted agent ({', '.join(SCRIPTED)}, or "
            "package.module:Name)",
        )
        check((folder / CONFIG).exists(), f"{name}: no run here ({CONFIG} is missing)")
        if load_config(folder)[0] == SELF_PLAY:
            inner = [folder / role for role in ROLES if (folder / role / CONFIG).exists()]
            check(bool(inner), f"{name}: self-play that has not saved anything yet")
            runs += [(name, path) for path in inner]
        else:
            runs.append((name, folder))
    task = task_of(TaskSettings(maze=maze))
    if runs:
        task = task_of(load_settings(runs[0][1]).task)
        check(
            bool(task.num_chasers and task.num_evaders),
            f"{runs[0][0]}: learned in task {task.name!r}; a league is between chasers and evaders",
        )
        check(not task.num_runners, f"{runs[0][0]}: learned among runners; a league has none")
    entries = []
    for name, folder in runs:
        settings = load_settings(folder)
        role = settings.task.agent.split("_")[0]
        check(role in ROLES, f"{name}: learned to be {role!r}; a league has chasers and evaders")
        sampled = not greedy and algorithm_entry(settings.algorithm).learns_distribution
        policy: Any = load_policy(folder, greedy=not sampled)
        check_fits(policy, role, task, name)
        entries.append(Entry(name, role, policy))
    for name in names:
        if name in SCRIPTED:
            rest: Any = (opponent_epsilon if name == "astar" else 0.0, task.move_order)
            for role in ROLES:
                entries.append(Entry(name, role, scripted_policy(name, role, *rest)))
        elif is_own_policy(name):
            for role in own_roles(name, task):
                entries.append(Entry(name, role, own_policy(name, task, role)))
    for role in ROLES:
        check(
            any(entry.role == role for entry in entries),
            f"no {role} among the entries; add astar, say, or a run of one",
        )
    return task, entries


def play_league(task: Task, entries: Sequence[Entry], games: int, seed: int) -> LeagueTable:
    """Every chaser against every evader: exact payoffs where they can be had, and games."""
    sides = {role: [entry for entry in entries if entry.role == role] for role in ROLES}
    shape = (len(sides["chaser"]), len(sides["evader"]))
    payoff, ci95 = np.zeros(shape), np.zeros(shape)
    lengths = np.zeros((*shape, games), dtype=np.int64)
    for i, chaser in enumerate(sides["chaser"]):
        for j, evader in enumerate(sides["evader"]):
            lengths[i, j], _ = play_pair(task, chaser.policy, evader.policy, games, seed)
            if is_exact(task, chaser.policy, evader.policy):
                payoff[i, j] = match(task, chaser.policy, evader.policy).steps
            else:
                payoff[i, j] = lengths[i, j].mean()
                ci95[i, j] = half_width(lengths[i, j])
    names = [[entry.name for entry in sides[role]] for role in ROLES]
    return LeagueTable(names[0], names[1], payoff, ci95, lengths)


def rate(table: LeagueTable, seed: int = 0) -> dict[str, Any]:
    """Ratings of both roles, Nash averaging and a cycle of best responses, as plain values."""
    content: dict[str, Any] = {
        "chasers": table.chasers,
        "evaders": table.evaders,
        "payoff": table.payoff.tolist(),
        "ci95": table.ci95.tolist(),
        "games": table.lengths.shape[2],
    }
    average = nash_average(table.payoff)
    content["nash"] = {
        "value": average.value,
        "chaser_mixture": average.chasers.tolist(),
        "evader_mixture": average.evaders.tolist(),
    }
    for role, names, results, nash in (
        ("chaser", table.chasers, -table.lengths, table.payoff @ average.evaders),
        ("evader", table.evaders, table.lengths.swapaxes(0, 1), average.chasers @ table.payoff),
    ):
        wins = pairwise_wins(results)
        elo = elo_ratings(wins, seed)
        skill = openskill_ratings(results, seed)
        content[f"{role}_ratings"] = [
            {
                "name": name,
                "elo": elo[n][0],
                "elo_low": elo[n][1],
                "elo_high": elo[n][2],
                "openskill_mu": skill[n][0],
                "openskill_sigma": skill[n][1],
                "steps_against_nash": float(nash[n]),
            }
            for n, name in enumerate(names)
        ]
        content[f"{role}_cycle"] = [names[n] for n in preference_cycle(wins)]
    cycle = best_response_cycle(table.payoff, table.ci95)
    content["cycle"] = [
        ("chaser " + table.chasers[n]) if role == "chaser" else ("evader " + table.evaders[n])
        for role, n in cycle
    ]
    return content
