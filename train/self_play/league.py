"""Leagues: all policies of one role against all of another, with ratings and their intervals.

The roles are chasers and evaders, or the players of a small game (`train.self_play.game_league`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.tasks.task import Task
from pursuit.validation import check, shortened
from scripted_agents.environments import AGENTS, agent_name, is_agent, named_policy, roles_of_agent
from scripted_agents.limits import MAX_EVALUATED_WORK, MAX_FINAL_WORK
from train.evaluation.games import half_width, other_role
from train.evaluation.matchups import can_solve, match, pair_payoffs
from train.evaluation.scores import OUTCOMES, UNTIL_CAPTURE, Measure
from train.evaluation.team_contest import TeamContest
from train.families.maze import POLICIES, check_fits, role_of
from train.families.policies import loaded
from train.files import Plain
from train.reports.tables import Row
from train.runs.folder import CONFIG
from train.runs.opponents import SAVED, is_self_play
from train.runs.saved import load_settings
from train.runs.stable_baselines import description_of
from train.self_play.names import entry_names
from train.self_play.ratings import (
    best_response_cycle,
    elo_ratings,
    nash_average,
    pairwise_wins,
    preference_cycle,
)
from train.settings.checks import evaluation_seed
from train.settings.self_play import ROLES
from train.settings.task import SmallGameSettings, TaskSettings
from train.settings.task_form import with_values


@dataclass(frozen=True)
class Entry:
    """A policy in one role: a `Policy`, or in a small game a `TableAgent`."""

    name: str
    role: str
    policy: Any


@dataclass(frozen=True, eq=False)
class LeagueTable:
    """The results of a league; payoffs are steps until capture, truncated at the horizon.

    With exits they are escapes minus captures, and shown with the other sign; in a small game
    returns of the second player.

    Attributes:
        payoff, ci95: [chasers, evaders] float64; the half width is 0 for exact payoffs.
        lengths: [chasers, evaders, games] int64, the payoffs of the sampled games; in a small game
            float64.
        chasers, evaders: their names; in a small game those of the first and the second player.
        horizon: steps after which a game is truncated; None for no limit, and with exits.
        measure: of the payoffs that are shown, with the direction of the first role.
        roles: those of the rows and of the columns.
        first: [chasers, evaders] float64, the payoffs of the first role where they are not the
            opposite of those of the second: a general-sum game; None otherwise.
    """

    chasers: list[str]
    evaders: list[str]
    payoff: NDArray[np.float64]
    ci95: NDArray[np.float64]
    lengths: NDArray[np.int64] | NDArray[np.float64]
    horizon: int | None = None
    measure: Measure = UNTIL_CAPTURE
    roles: tuple[str, str] = ROLES
    first: NDArray[np.float64] | None = None

    @property
    def sign(self) -> float:
        """The factor of payoffs, which the columns maximise, where they are shown."""
        return 1.0 if self.measure.less_is_better else -1.0

    @property
    def shown(self) -> NDArray[np.float64]:
        """The payoffs in `measure`."""
        return self.sign * self.payoff


def enter(
    names: Sequence[str],
    maze: str | None,
    opponent_epsilon: float = 0.0,
    greedy: bool = False,
    called: Sequence[str] = (),
    model_roles: Sequence[str] = (),
    model_observations: Sequence[str] = (),
) -> tuple[Task, list[Entry]]:
    """The task and the entries of a league.

    Args:
        names: folders of runs, saved Stable-Baselines3 models (.zip), and names of scripted agents
            and of user-defined policies.
        maze: the maze, if there is no run among the entries; None for 5x5.
        opponent_epsilon: probability of random moves of astar.
        greedy: learned policies take their most probable action instead of sampling.
        called: names in tables, one per entry; by default those of `entry_names`.
        model_roles, model_observations: of the models without a description file: one for all, or
            one for each in the order of `names`.

    Raises:
        ValueError: an entry that is not a run, is of another game or given twice, or a role without
            entries.
    """
    names = [agent_name(name) for name in names]
    title = dict(zip(names, entry_names(names, is_agent, called), strict=True))
    models = [name for name in names if is_model(name)]
    runs = [name for name in names if not is_agent(name) and name not in models]
    paths = [(name, path) for name in runs for path in folders_of(name)]
    task = _task_of(paths, maze)
    bare = [name for name in models if not description_of(name).is_file()]
    roles = _one_each("model_roles", model_roles, bare)
    observations = _one_each("model_observations", model_observations, bare)
    agents = []
    for name in filter(is_agent, names):  # first, as they are refused quickly
        epsilon = opponent_epsilon if name == "astar" else 0.0
        shown = title[name] + (f" (epsilon {epsilon:g})" if epsilon and not called else "")
        for role in roles_of_agent(name, task):
            agents.append(Entry(shown, role, named_policy(name, task, role, epsilon)))
    given: Plain = {
        name: {"agent": role, "observation": observation}
        for name, role, observation in zip(bare, roles, observations, strict=False)
    }
    for role in roles:
        check(role in ROLES, f"model_roles: {role!r}; give chaser or evader")
    entries = []
    for name, path in [*paths, *((name, Path(name)) for name in models)]:
        played = "greedy" if greedy else "sampled"
        policy = loaded(POLICIES, SAVED, path, played, task=task, **given.get(name, {}))
        role = role_of(policy)
        check(role in ROLES, f"{name}: trained as {role!r}; a league needs chasers and evaders")
        check_fits(policy, role, task, name)
        entries.append(Entry(title[name], role, policy))
    entries += agents
    for role in ROLES:
        check(
            any(entry.role == role for entry in entries),
            f"no {role} among the entries; add astar or a run of a {role}",
        )
    return task, entries


def folders_of(
    name: str, roles: Sequence[str] = ROLES, agents: Sequence[str] = AGENTS
) -> list[Path]:
    """The folder of a run, or the folders of all learned sides of self-play.

    Args:
        name: of the folder.
        roles: of the game.
        agents: the named policies of the game, for the message.

    Raises:
        ValueError: no run there.
    """
    folder = Path(name)
    check(
        os.path.isdir(folder),
        f"{shortened(name)}: neither a folder of a run nor a scripted agent ({', '.join(agents)}, "
        "or package.module:Name)",
    )
    check((folder / CONFIG).exists(), f"{name}: no run here ({CONFIG} is missing); give a run")
    if not is_self_play(folder):
        return [folder]
    learned = [path.parent for path in sorted(folder.glob(f"*/{CONFIG}"))]
    check(bool(learned), f"{name}: self-play without a checkpoint yet; resume it first")
    inner = [folder / role for role in roles if folder / role in learned]
    check(
        bool(inner),
        f"{name}: self-play of {', '.join(path.name for path in learned)}, but the league is of "
        f"{' and '.join(roles)}; give --game with the game of the runs, or leave it out for mazes",
    )
    return inner


def _task_of(runs: Sequence[tuple[str, Path]], maze: str | None) -> Task:
    """The task of the first run; without runs, a chase in this maze (None: 5x5)."""
    if not runs:
        return TaskSettings(maze="5x5" if maze is None else maze).build()
    name, folder = runs[0]
    settings = load_settings(folder).task
    if isinstance(settings, SmallGameSettings):
        raise ValueError(f"{name}: a run of a small game; give --game {settings.game!r}")
    check(maze is None, f"maze={maze!r}, but {name} has its own maze; leave maze out")
    task = with_values(settings, name, maze=settings.maze).build()
    check(
        bool(task.num_chasers and task.num_evaders),
        f"{name}: trained in task {task.name!r}; a league needs chasers and evaders",
    )
    check(not task.num_runners, f"{name}: trained in a task with runners; a league has none")
    return task


def _one_each(what: str, given: Sequence[str], models: Sequence[str]) -> list[str]:
    """One value for each model; a single value is for all."""
    check(
        len(given) in (0, 1, len(models)),
        f"{what}: {len(given)} for {len(models)} models without a description; give one for all, "
        "or one for each in the order of the entries",
    )
    return [*given] * len(models) if len(given) == 1 else [*given]


def is_model(name: str) -> bool:
    """Whether an entry is a saved Stable-Baselines3 model."""
    return not is_agent(name) and Path(name).suffix == ".zip"


def play_league(
    task: Task, entries: Sequence[Entry], games: int, seed: int, most: int = MAX_FINAL_WORK
) -> LeagueTable:
    """Every chaser against every evader: exact payoffs where possible, and sampled games.

    `seed` is an evaluation seed, which training never uses; `most` as in `match`.
    """
    starts = evaluation_seed(seed)
    sides = {role: [entry for entry in entries if entry.role == role] for role in ROLES}
    shape = (len(sides["chaser"]), len(sides["evader"]))
    payoff, ci95 = np.zeros(shape), np.zeros(shape)
    lengths = np.zeros((*shape, games), dtype=np.int64)
    for i, chaser in enumerate(sides["chaser"]):
        for j, evader in enumerate(sides["evader"]):
            lengths[i, j] = pair_payoffs(task, chaser.policy, evader.policy, games, starts)
            if can_solve(task, chaser.policy, evader.policy, most):
                payoff[i, j] = match(task, chaser.policy, evader.policy, most=most).payoff
            else:
                payoff[i, j] = lengths[i, j].mean()
                ci95[i, j] = half_width(lengths[i, j])
    names = [[entry.name for entry in sides[role]] for role in ROLES]
    how = (None, OUTCOMES) if task.most_exits else (task.max_steps, UNTIL_CAPTURE)
    return LeagueTable(names[0], names[1], payoff, ci95, lengths, *how)


def team_rows(task: Task, entries: Sequence[Entry], table: LeagueTable) -> list[Row]:
    """Every team of several agents against every policy of the other role, with its best response.

    Returns:
        Rows with "role", "team", "against"; "payoff" and "ci95" of the table; "best_response" of
        the team as one player (with full view), in the unit of the table and over all starts, and
        "gap" (`Measure.gap`); or None and the "reason".
    """
    rows: list[Row] = []
    for role in [role for role in ROLES if task.count(role) > 1]:
        for other in [entry for entry in entries if entry.role == other_role(role)]:
            how: Plain = {"most_work": MAX_EVALUATED_WORK}
            contest = TeamContest(task, role, {other.role: other.policy}, **how)
            best = contest.best
            for entry in [entry for entry in entries if entry.role == role]:
                at = (entry.name, other.name) if role == ROLES[0] else (other.name, entry.name)
                place = table.chasers.index(at[0]), table.evaders.index(at[1])
                payoff = float(table.shown[place])
                gap = None if best is None else contest.measure.gap(payoff, best)
                rows.append(
                    {
                        "role": role,
                        "team": entry.name,
                        "against": other.name,
                        "payoff": payoff,
                        "ci95": float(table.ci95[place]),
                        "best_response": best,
                        "gap": gap,
                        "full_view": contest.is_limited,
                        "reason": contest.full.exact_reference.reason,
                    }
                )
    return rows


def survival(table: LeagueTable) -> Plain:
    """Evaders that are never caught, and the ratings that are meaningless because of them.

    Returns:
        "out_of_time": [chasers][evaders], share of truncated games.
        "never": [chasers][evaders], whether all games are truncated (from all starts if exact).
        "never_caught": evaders that no chaser ever catches; the lengths of their games only show
            the time limit.
        "never_catches": chasers that never catch an evader.
        "ranks_mean_nothing": roles with meaningless ratings: "chaser" if some evader is never
            caught, as all chasers are equal against it; "evader" if two or more are never caught.
    """
    horizon = np.inf if table.horizon is None else table.horizon
    late = (table.lengths >= horizon).mean(axis=2)
    # Exact payoffs cover all starts, not only the sampled ones.
    never = (late >= 1.0) & (table.payoff >= horizon - 1e-9)
    evaders = [n for n, alive in zip(table.evaders, never.all(axis=0), strict=True) if alive]
    chasers = [n for n, empty in zip(table.chasers, never.all(axis=1), strict=True) if empty]
    several = (len(table.chasers) > 1, len(evaders) > 1)
    roles = [role for role, more in zip(table.roles, several, strict=True) if evaders and more]
    return {
        "out_of_time": late.tolist(),
        "never": never.tolist(),
        "never_caught": evaders,
        "never_catches": chasers,
        "ranks_mean_nothing": roles,
    }


def policies_of(role: str) -> str:
    """The name of the entries in a role, in files."""
    return f"{role}s" if role in ROLES else f"{role}_policies"


def rate(table: LeagueTable, seed: int = 0) -> Plain:
    """Ratings of both roles, Nash averaging and a cycle of best responses, as plain values.

    Of a general-sum game only the payoffs of both players.
    """
    first, second = table.roles
    if table.first is not None:
        payoffs = {first: table.first.tolist(), second: table.payoff.tolist()}
        called = {policies_of(first): table.chasers, policies_of(second): table.evaders}
        return {**called, "payoffs": payoffs}
    content: Plain = {
        policies_of(first): table.chasers,
        policies_of(second): table.evaders,
        "payoff": table.shown.tolist(),
        "ci95": table.ci95.tolist(),
        "games": table.lengths.shape[2],
        **(survival(table) if table.roles == ROLES else {}),
        "unit": table.measure.unit,
    }
    average = nash_average(table.payoff)
    content["nash"] = {
        "value": table.sign * average.value,
        f"{first}_mixture": average.column.tolist(),
        f"{second}_mixture": average.row.tolist(),
    }
    against = "steps" if table.roles == ROLES else "payoff"
    for role, names, results, nash in (
        (first, table.chasers, -table.lengths, table.payoff @ average.row),
        (second, table.evaders, table.lengths.swapaxes(0, 1), average.column @ table.payoff),
    ):
        wins = pairwise_wins(results)
        elo = elo_ratings(wins, seed)
        content[f"{role}_ratings"] = [
            {
                "name": name,
                "elo": elo[n][0],
                "elo_low": elo[n][1],
                "elo_high": elo[n][2],
                f"{against}_against_nash": table.sign * float(nash[n]),
            }
            for n, name in enumerate(names)
        ]
        content[f"{role}_cycle"] = [names[n] for n in preference_cycle(wins)]
    content["cycle"] = cycle_of(table)
    return content


def cycle_of(table: LeagueTable) -> list[str]:
    """A cycle in which each is the best response to the previous one; empty if there is none."""
    names = {"chaser": table.chasers, "evader": table.evaders}
    called = dict(zip(ROLES, table.roles, strict=True))
    cycle = best_response_cycle(table.payoff, table.ci95)
    return [f"{called[role]} {names[role][n]}" for role, n in cycle]
