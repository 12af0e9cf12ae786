"""Recorded episodes, and overlays of exact values and optimal moves, for report pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Extras, Overlay
from pursuit.rules.arrays import Reals
from pursuit.tasks.task import Task
from scripted_agents import action_values
from train.evaluation.games import duel_role, order_of
from train.evaluation.scores import Contest

MOST_OVERLAY_CELLS = 225
"""Maximum number of cells for overlays, as their size grows quadratically."""
MOST_BOTH_CELLS = 100
"""Maximum number of cells for overlays of both sides of a duel."""


def recorded(
    contest: Contest[Any, Any], policy: Any, games: Mapping[str, int], policy_name: str
) -> Replay:
    """Record episodes of a contest as a replay.

    Args:
        contest: the evaluation.
        policy: the evaluated policy.
        games: the numbers of the episodes by label.
        policy_name: the name of the policy in the replay.
    """
    episodes = []
    for label, number in games.items():
        simulator, play = contest.game(policy, number)
        recorder = Recorder(simulator)
        for _ in play:
            pass
        (episode,) = recorder.stop().episodes[:1]
        episodes.append(replace(episode, label=label))
    players = contest.players(policy_name)
    return Replay(contest.task, tuple(episodes), seed=contest.seed, players=players)


def add_recorded(
    builder: Builder,
    contest: Contest[Any, Any],
    policy: Any,
    games: Mapping[str, int],
    policy_name: str,
    **extras: Any,
) -> Replay:
    """Add recorded episodes to a page; the other arguments are those of `recorded`, and of
    `Extras`."""
    replay = recorded(contest, policy, games, policy_name)
    builder.add(replay, Extras(names=list(games), **extras))
    return replay


def duel_overlays(
    task: Task, seat: int, theirs: Reals, learned: Reals | None, most_both: int = MOST_BOTH_CELLS
) -> list[Overlay]:
    """The overlays of a duel: exact values, and learned and optimal moves; the learner's first.

    Both sides are included in mazes of up to `most_both` cells. Values and optimal moves assume a
    full view; labels say so if the view is limited.

    Args:
        task: the duel.
        seat: the index of the learner.
        theirs: the table of its opponent.
        learned: the table of the learner; None if it has none.
        most_both: see above.
    """
    maze, names, other = task.mazes[0], task.agent_names, 1 - seat
    rules = (task.max_steps, task.stay_action, order_of(task))
    found = action_values(duel_role(task.seat_roles[seat]), maze, theirs, *rules)
    called = {name: f"{name} with full view" if task.hides_from(name) else name for name in names}
    overlays = [Overlay(called[names[seat]], seat, other, found.values, learned, found.optimal)]
    if learned is not None and maze.num_cells <= most_both:
        found = action_values(duel_role(task.seat_roles[other]), maze, learned, *rules)
        overlays.append(
            Overlay(called[names[other]], other, seat, found.values, theirs, found.optimal)
        )
    return overlays
