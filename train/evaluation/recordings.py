"""Recorded episodes, and overlays of exact values and optimal moves, for report pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Extras, Side
from scripted_agents import action_values
from scripted_agents.references import is_table_in
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.contests import AnyContest
from train.evaluation.games import duel_role, order_of, table_in
from train.evaluation.scores import label_of
from train.evaluation.small_game_contest import SmallGameContest
from train.evaluation.small_game_replay import add_small_game

MOST_OVERLAY_CELLS = 225
"""Maximum number of cells for overlays, as their size grows quadratically."""
MOST_BOTH_CELLS = 100
"""Maximum number of cells for overlays of both sides of a duel."""


def recorded(contest: AnyContest, policy: Any, games: Mapping[str, int], player: str) -> Replay:
    """Record episodes of a contest as a replay.

    Args:
        contest: the evaluation.
        policy: the evaluated policy.
        games: the numbers of the episodes by label.
        player: the name of the policy in the replay.
    """
    episodes = []
    for label, number in games.items():
        simulator, play = contest.game(policy, number)
        recorder = Recorder(simulator)
        for _ in play:
            pass
        (episode,) = recorder.stop().episodes[:1]
        episodes.append(replace(episode, label=label))
    return Replay(
        contest.task, tuple(episodes), seed=contest.seed, players=players_of(contest, player)
    )


def add_episodes(
    builder: Builder,
    contest: AnyContest,
    policy: Any,
    games: Mapping[str, int],
    player: str,
    **extras: Any,
) -> Replay | None:
    """Add episodes of a contest to a page, with overlays.

    The other arguments are those of `recorded`, and of `Extras`.

    Returns:
        The replay; None in a small game, which has none.
    """
    if isinstance(contest, SmallGameContest):
        policies = {**contest.opponents, contest.agent: policy}
        add_small_game(builder, contest.task, policies, games, 1.0, players_of(contest, player))
        return None
    replay = recorded(contest, policy, games, player)
    builder.add(replay, Extras(names=list(games), sides=sides_of(contest, policy), **extras))
    return replay


def players_of(contest: AnyContest, player: str) -> dict[str, str]:
    """The names of the policies of a contest by agent."""
    if isinstance(contest, ArmContest):
        return {"arm": player}
    if isinstance(contest, SmallGameContest):
        return {**{n: label_of(own) for n, own in contest.opponents.items()}, contest.agent: player}
    task, found = contest.task, {}
    for seat, (name, role) in enumerate(zip(task.agent_names, task.seat_roles, strict=True)):
        policy = contest.opponents.get(name, contest.opponents.get(role))
        found[name] = player if seat in contest.seats or policy is None else label_of(policy)
    return found


def sides_of(contest: AnyContest, policy: Any, most_both: int = MOST_BOTH_CELLS) -> list[Side]:
    """The overlays of a duel: exact values, and learned and optimal moves; the learner's first.

    Both sides are included in mazes of up to `most_both` cells. Values and optimal moves assume a
    full view; labels say so if the view is limited. Empty unless the game is a duel against a
    tabular policy in a small maze.
    """
    if not isinstance(contest, GameContest) or not contest.is_table_duel:
        return []
    task = contest.task
    if task.max_cells > MOST_OVERLAY_CELLS:
        return []
    maze, seat = task.mazes[0], task.seat(contest.agent)
    theirs = contest.opponent_table()
    learned = table_in(task, policy) if is_table_in(task, policy) else None
    rules = (task.max_steps, task.stay_action, order_of(task))
    names, other = task.agent_names, 1 - seat
    found = action_values(duel_role(task.seat_roles[seat]), maze, theirs, *rules)
    called = {name: f"{name} with full view" if task.hides_from(name) else name for name in names}
    sides = [Side(called[names[seat]], seat, other, found.values, learned, found.optimal)]
    if learned is not None and maze.num_cells <= most_both:
        found = action_values(duel_role(task.seat_roles[other]), maze, learned, *rules)
        sides.append(Side(called[names[other]], other, seat, found.values, theirs, found.optimal))
    return sides
