"""Leagues: all policies of one side against all of the other, with ratings and their intervals."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check, need, shortened
from scripted_agents.exact.limits import MAX_FINAL_WORK
from scripted_agents.names import agent_name
from train.evaluation.ratings import (
    best_response_cycle,
    elo_ratings,
    nash_average,
    pairwise_wins,
    preference_cycle,
)
from train.evaluation.scores import BY_OUTCOME, UNTIL_CAPTURE, Measure
from train.evaluation.sides import PairResult, Sides
from train.families import family_of
from train.families.policies import NamedPolicies, loaded_policy
from train.files import Plain
from train.runs.folder import CONFIG
from train.runs.opponents import is_self_play, saved_at
from train.runs.saved import load_settings
from train.runs.stable_baselines import description_of
from train.self_play.names import entry_names
from train.self_play.parts import game_of_all
from train.settings.checks import evaluation_seed
from train.settings.self_play import OPPOSING_ROLES
from train.settings.task_form import default_task, with_values


@dataclass(frozen=True)
class Entry:
    """A policy of one side."""

    name: str
    role: str
    policy: Any


@dataclass(frozen=True, eq=False)
class LeagueTable:
    """The results of a league; payoffs are steps until capture, truncated at the horizon.

    With exits they are escapes minus captures, and shown with the other sign; in other games
    returns of the second player.

    Attributes:
        payoff, ci95: [chasers, evaders] float64; the half width is 0 for exact payoffs.
        lengths: [chasers, evaders, games] int64, the payoffs of the sampled games; in other games
            float64.
        chasers, evaders: their names; in other games those of the first and the second player.
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
    roles: tuple[str, str] = OPPOSING_ROLES
    first: NDArray[np.float64] | None = None

    @property
    def counts_captures(self) -> bool:
        """Whether payoffs count captures or the steps to them, so that some may never happen."""
        return self.measure in (UNTIL_CAPTURE, BY_OUTCOME)

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
    maze: str | None = None,
    opponent_epsilon: float = 0.0,
    greedy: bool = False,
    called: Sequence[str] = (),
    model_roles: Sequence[str] = (),
    model_observations: Sequence[str] = (),
    game: str | None = None,
    at: Sequence[str] = (),
) -> tuple[Sides, list[Entry]]:
    """The game and the entries of a league.

    Args:
        names: folders of runs, of self-play those of all sides; models (.onnx, .zip); names of
            built-in and of user-defined policies, each for every side that it can play.
        maze: the maze, if there is no run among the entries; None for 5x5.
        opponent_epsilon: probability of random moves of astar.
        greedy: learned policies take their most probable action instead of sampling.
        called: names in tables, one per entry; by default those of `entry_names`.
        model_roles, model_observations: of the models without a description file: one for all, or
            one for each in the order of `names`.
        game: a small game by name; the time limit is that of the first run, or the default. None
            for the game of the first run, or without one a chase in the maze.
        at: the times of training of which the policies of runs play, as of `load_policy`, each as
            an entry of its own; none for the last.

    Raises:
        ValueError: an entry that is not a run, is of another game or given twice, a side without
            entries, or more than two sides.
    """
    names = [agent_name(name) for name in names]
    check(all(names), "'': give the folder of a run, a model, or a policy by name")
    given = default_task({} if game is None else {"game": game})
    first = next((name for name in names if os.path.isdir(name)), None)
    if game is None and first is not None:
        given = load_settings(learned_in(first)[0]).task
    policies = need(family_of(given).policies)
    title = dict(zip(names, entry_names(names, policies.is_named, called), strict=True))
    models = [name for name in names if is_model(name, policies)]
    runs = [name for name in names if not policies.is_named(name) and name not in models]
    try:
        given.check_league([name for name in names if policies.is_named(name)])
    except ValueError as error:
        raise ValueError(f"{first}: {error}" if first else str(error)) from None
    roles = given.sides
    check(
        len(roles) == 2,
        f"{given.game_label} has {len(roles)} players; a league needs two: use pursuit evaluate",
    )
    paths = [(name, path) for name in runs for path in folders_of(name, roles, policies.names)]
    if paths:
        own = load_settings(paths[0][1]).task
        check(
            type(own) is type(given),
            f"{paths[0][0]}: a run of task {own.task!r}; give a run of {given.game_label}",
        )
        check(maze is None, f"maze={maze!r}, but {first} has its own maze; leave maze out")
        given = with_values(given, str(first), max_steps=own.max_steps) if game else own
    elif maze is not None:
        given = with_values(given, f"maze={maze}", maze=maze)
    given.check_league(())
    sides = game_of_all(given)
    task = sides.task
    bare = [n for n in models if n.endswith(".zip") and not description_of(n).is_file()]
    model_sides = _one_each("model_roles", model_roles, bare)
    observations = _one_each("model_observations", model_observations, bare)
    agents = []
    for name in filter(policies.is_named, names):  # first, as they are refused quickly
        epsilon = opponent_epsilon if name == "astar" else 0.0
        shown = title[name] + (f" (epsilon {epsilon:g})" if epsilon and not called else "")
        for role in policies.agents(name, task):
            agents.append(Entry(shown, role, policies.named(name, task, role, epsilon)))
    trained: Plain = {
        name: {"agent": role, "observation": observation}
        for name, role, observation in zip(bare, model_sides, observations, strict=False)
    }
    for role in model_sides:
        check(role in roles, f"model_roles: {role!r}; give {' or '.join(roles)}")
    entries = []
    entered = [(name, path, time) for name, path in paths for time in (at or (None,))]
    for name, path, time in [*entered, *((name, Path(name), None) for name in models)]:
        played = "greedy" if greedy else "sampled"
        own = trained.get(name, {})
        policy = loaded_policy(policies, saved_at(time), path, played, task=task, **own)
        role = policies.agent_of(policy)
        check(
            role in roles,
            f"{name}: trained as {role!r}; a league needs policies of {roles[0]} and {roles[1]}",
        )
        shown = title[name] if time is None else f"{title[name]} at {time}"
        entries.append(Entry(shown, role, policies.placed(policy, task, role, name, 0.0)))
    entries += agents
    for role in roles:
        check(
            any(entry.role == role for entry in entries),
            f"no policy of {role} among the entries; add {policies.names[0]}, or a run of {role}",
        )
    return sides, entries


def learned_in(name: str) -> list[Path]:
    """The folder of a run, or the folders of all learned sides of self-play; ValueError if there is
    no run."""
    folder = Path(name)
    check((folder / CONFIG).exists(), f"{name}: no run here ({CONFIG} is missing); give a run")
    if not is_self_play(folder):
        return [folder]
    learned = [path.parent for path in sorted(folder.glob(f"*/{CONFIG}"))]
    check(bool(learned), f"{name}: self-play without a checkpoint yet; resume it first")
    return learned


def folders_of(name: str, roles: Sequence[str], agents: Sequence[str]) -> list[Path]:
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
    learned = learned_in(name)
    if learned == [folder]:
        return learned
    inner = [path for role in roles for path in learned if path.name == role]
    check(
        bool(inner),
        f"{name}: self-play of {', '.join(path.name for path in learned)}, but the league is of "
        f"{' and '.join(roles)}; give --game with the game of the runs, or leave it out for mazes",
    )
    return inner


def _one_each(what: str, given: Sequence[str], models: Sequence[str]) -> list[str]:
    """One value for each model; a single value is for all."""
    check(
        len(given) in (0, min(1, len(models)), len(models)),
        f"{what}: {len(given)} for {len(models)} models without a description; give one for all, "
        "or one for each in the order of the entries; none without such models",
    )
    return [*given] * len(models) if len(given) == 1 else [*given]


def is_model(name: str, policies: NamedPolicies) -> bool:
    """Whether an entry is the file of a model."""
    return not policies.is_named(name) and Path(name).suffix in policies.models


def play_league(
    game: Sides,
    entries: Sequence[Entry],
    games: int,
    seed: int,
    most: int = MAX_FINAL_WORK,
    report: Callable[[float], object] = lambda share: None,
) -> LeagueTable:
    """Every policy of the first side against every one of the second: exact payoffs where possible,
    and sampled games.

    `seed` is an evaluation seed, which training never uses; `most` as of `Sides.pair`; `report` is
    called with the share of pairs that have played.
    """
    starts, (first, second) = evaluation_seed(seed), game.roles
    sides = [[entry for entry in entries if entry.role == role] for role in game.roles]
    pairs = list[list[PairResult]]()
    for one in sides[0]:
        pairs.append([])
        for two in sides[1]:
            pairs[-1].append(game.pair(one.policy, two.policy, games, starts, most))
            report((len(pairs) - 1 + len(pairs[-1]) / len(sides[1])) / len(sides[0]))
    payoff, ci95 = (np.array([[pair[at] for pair in row] for row in pairs]) for at in (0, 1))
    own = None
    if pairs[0][0].first is not None:
        own = np.array([[pair.first for pair in row] for row in pairs], dtype=np.float64)
    names = [[entry.name for entry in side] for side in sides]
    lengths = np.array([[pair.sampled for pair in row] for row in pairs])
    how = (game.horizon, game.league_measure, (first, second), own)
    return LeagueTable(names[0], names[1], payoff, ci95, lengths, *how)


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


def entries_name(role: str) -> str:
    """The name of the entries in a role, in files."""
    return f"{role}s" if role in OPPOSING_ROLES else f"{role}_policies"


def rate(table: LeagueTable, seed: int = 0) -> Plain:
    """Ratings of both roles, Nash averaging and a cycle of best responses, as plain values.

    Of a general-sum game only the payoffs of both players.
    """
    first, second = table.roles
    if table.first is not None:
        payoffs = {first: table.first.tolist(), second: table.payoff.tolist()}
        called = {entries_name(first): table.chasers, entries_name(second): table.evaders}
        return {**called, "payoffs": payoffs}
    content: Plain = {
        entries_name(first): table.chasers,
        entries_name(second): table.evaders,
        "payoff": table.shown.tolist(),
        "ci95": table.ci95.tolist(),
        "games": table.lengths.shape[2],
        **(survival(table) if table.counts_captures else {}),
        "unit": table.measure.unit,
    }
    average = nash_average(table.payoff)
    content["nash"] = {
        "value": table.sign * average.value,
        f"{first}_mixture": average.column.tolist(),
        f"{second}_mixture": average.row.tolist(),
    }
    against = "steps" if table.counts_captures else "payoff"
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
    called = dict(zip(OPPOSING_ROLES, table.roles, strict=True))
    cycle = best_response_cycle(table.payoff, table.ci95)
    return [f"{called[role]} {names[role][n]}" for role, n in cycle]
