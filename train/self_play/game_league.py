"""Leagues of a small game: all policies of the first player against all of the second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check
from scripted_agents.environments import is_custom_policy
from scripted_agents.games.agents import AGENTS, EQUILIBRIUM
from scripted_agents.games.enumeration import names_of_players
from scripted_agents.games.episodes import play_of
from scripted_agents.games.named import game_named
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from train.evaluation.games import stepper
from train.evaluation.scores import Measure
from train.runs.opponents import policy_of
from train.runs.saved import load_settings
from train.self_play.league import Entry, LeagueTable, folders_of
from train.self_play.names import entry_names
from train.settings.checks import evaluation_seed
from train.settings.task import SmallGameSettings


def enter_game(
    names: Sequence[str], game: str, greedy: bool = False, called: Sequence[str] = ()
) -> tuple[GameTask, list[Entry]]:
    """The game and the entries of a league.

    Args:
        names: folders of runs (of self-play: of both players); uniform, equilibrium, or
            package.module:Name of a function of a state, each for every player that it can play.
        game: by name, as for `load_game`; the time limit is that of the first run, or the default.
        greedy: whether learned policies take their most probable action.
        called: names in tables, one per entry; by default those of `entry_names`.

    Raises:
        ValueError: more than two players, an entry that is not a policy of this game or given
            twice, or a player without entries.
    """
    named = game_named(game)  # not yet enumerated
    players = names_of_players(named)
    check(
        len(players) == 2,
        f"game={game!r} has {len(players)} players; a league needs two: use pursuit evaluate",
    )
    check(
        EQUILIBRIUM not in names or getattr(named, "zero_sum", True),
        f"game={game!r} is a general-sum game, whose equilibrium is not computed; leave "
        f"{EQUILIBRIUM} out",
    )
    given = SmallGameSettings(game=game)
    task = given.build()
    title = dict(zip(names, entry_names(names, _is_named, called), strict=True))
    first = next((name for name in names if not _is_named(name)), None)
    entries: list[Entry] = []
    for name in names:
        if _is_named(name):
            entries += _named_entries(name, title[name], task, given)
            continue
        for path in folders_of(name, players, AGENTS):
            own = load_settings(path).task
            if not isinstance(own, SmallGameSettings):
                raise ValueError(f"{name}: a run of task {own.task!r}; give a run of game {game}")
            if name == first:
                task = replace(task, max_steps=own.max_steps)
            player = own.agent_in(own.build())
            how = (0.0, "greedy" if greedy else "sampled")
            policy = policy_of(own, str(path), task, player, *how)
            entries.append(Entry(title[name], player, policy))
    for player in players:
        check(
            any(entry.role == player for entry in entries),
            f"no policy of {player} among the entries; add uniform, or a run of {player}",
        )
    return task, entries


def _is_named(name: str) -> bool:
    return name in AGENTS or is_custom_policy(name)


def _named_entries(name: str, title: str, task: GameTask, given: SmallGameSettings) -> list[Entry]:
    """A named policy for every player that it can play; ValueError if there is none."""
    found, refused = list[Entry](), ValueError()
    for player in task.agent_names:
        try:
            found.append(Entry(title, player, policy_of(given, name, task, player)))
        except ValueError as error:
            refused = error
    if not found:
        raise refused
    return found


def play_game_league(
    task: GameTask, entries: Sequence[Entry], games: int, seed: int
) -> LeagueTable:
    """Every policy of the first player against every one of the second.

    Payoffs are exact returns within the time limit; in a zero-sum game there are also sampled
    games, from the same starts for all pairs, for ratings. `seed` is an evaluation seed.
    """
    first, second = task.agent_names
    sides = [[e for e in entries if e.role == role] for role in (first, second)]
    shape = (len(sides[0]), len(sides[1]))
    exact = np.zeros((2, *shape))
    sampled = np.zeros((*shape, games if task.game.zero_sum else 0))
    for i, j in np.ndindex(shape):
        one, two = sides[0][i].policy, sides[1][j].policy
        tables = {first: one.table(task), second: two.table(task)}
        exact[:, i, j] = play_of(task.game, tables, task.max_steps).returns
        if task.game.zero_sum:
            sampled[i, j] = sampled_returns(task, (one, two), games, evaluation_seed(seed))
    names = [[entry.name for entry in side] for side in sides]
    own = None if task.game.zero_sum else exact[0]
    measure = Measure("mean_return", f"return of {second}")
    return LeagueTable(
        names[0], names[1], exact[1], np.zeros(shape), sampled, None, measure, (first, second), own
    )


def sampled_returns(
    task: GameTask, pair: tuple[StatePolicy, StatePolicy], games: int, seed: int
) -> NDArray[np.float64]:
    """[games] the returns of the second player in sampled games, rounded so that equal ones are."""
    played = GameSimulator(task, games, seed, auto_restart=False)
    step = stepper(played, pair)
    while not played.ended.all():
        step()
    return played.returns[:, 1].round(9)
