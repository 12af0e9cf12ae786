"""Leagues of a small game: all policies of the first player against all of the second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pursuit.validation import check
from scripted_agents.environments import is_custom_policy
from scripted_agents.games.agents import AGENTS
from scripted_agents.games.episodes import play_of
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from train.runs.opponents import player_policy
from train.runs.saved import load_settings
from train.runs.tasks import game_of, player_in
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
    task = game_of(SmallGameSettings(game=game))
    players = task.agent_names
    check(
        len(players) == 2,
        f"game={game!r} has {len(players)} players; a league needs two: use pursuit evaluate",
    )
    title = dict(zip(names, entry_names(names, _is_named, called), strict=True))
    first = next((name for name in names if not _is_named(name)), None)
    found: list[tuple[str, str, str]] = []  # title, player, policy
    for name in names:
        if _is_named(name):
            found += [(title[name], player, name) for player in _players_of(name, task)]
            continue
        for path in folders_of(name, players, AGENTS):
            own = load_settings(path).task
            if not isinstance(own, SmallGameSettings):
                raise ValueError(f"{name}: a run of task {own.task!r}; give a run of game {game}")
            if name == first:
                task = replace(task, max_steps=own.max_steps)
            found.append((title[name], player_in(own, game_of(own)), str(path)))
    for player in players:
        check(
            any(own == player for _, own, _ in found),
            f"no policy of {player} among the entries; add uniform, or a run of {player}",
        )
    policies = (player_policy(name, task, player, 0.0, greedy) for _, player, name in found)
    return task, [Entry(*own[:2], policy) for own, policy in zip(found, policies, strict=True)]


def _is_named(name: str) -> bool:
    return name in AGENTS or is_custom_policy(name)


def _players_of(name: str, task: GameTask) -> list[str]:
    """The players that a named policy can play; ValueError if there is none."""
    found, refused = list[str](), ValueError()
    for player in task.agent_names:
        try:
            player_policy(name, task, player)
            found.append(player)
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
    for i, one in enumerate(sides[0]):
        for j, two in enumerate(sides[1]):
            pair = one.policy, two.policy
            tables = {e.role: e.policy.table(task) for e in (one, two)}
            exact[:, i, j] = play_of(task.game, tables, task.max_steps).returns
            if task.game.zero_sum:
                sampled[i, j] = sampled_returns(task, pair, games, evaluation_seed(seed))
    names = [[entry.name for entry in side] for side in sides]
    own = None if task.game.zero_sum else exact[0]
    how = (None, f"return of {second}", (first, second), own)
    return LeagueTable(names[0], names[1], exact[1], np.zeros(shape), sampled, *how)


def sampled_returns(
    task: GameTask, pair: tuple[StatePolicy, StatePolicy], games: int, seed: int
) -> NDArray[np.float64]:
    """[games] the returns of the second player in sampled games, rounded so that equal ones are."""
    played = GameSimulator(task, games, seed, auto_restart=False)
    actions = np.zeros((games, 2), dtype=np.int32)
    while not played.ended.all():
        played.act(pair, actions)
        played.step(actions)
    return played.returns[:, 1].round(9)
