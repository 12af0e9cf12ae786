"""Recorded episodes, and overlays of exact values and optimal moves, for report pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Extras, Overlay
from pursuit.rules.arrays import Reals
from pursuit.tasks.task import Task
from pursuit.validation import check
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


def add_compared(
    builder: Builder,
    contest: Contest[Any, Any],
    policy: Any,
    games: Mapping[str, int],
    policy_name: str,
    encoding: str | None = None,
    is_solved: bool = True,
) -> Replay | None:
    """Add episodes to a page as `Contest.add_episodes`, each with that of the optimal policy.

    Both start in the same state, with the same random numbers. In items "by" names the policy,
    "beside" is the other episode, "lost" the difference of their lengths in steps, above 0 where
    the optimal policy is better (in measures other than steps it is left out), and "map" that of
    `Contest.lost_by_start` where it is known. Without an optimal policy "alone" is the reason.

    Args:
        is_solved: whether the optimum was solved; else it is not solved again here.
    """
    first = len(builder.items)
    replay = contest.add_episodes(builder, policy, games, policy_name, encoding)
    items = builder.items[first:]
    try:
        check(is_solved, contest.why_no_optimum or "the optimal policy is not known")
        best = contest.best_policy()
    except ValueError as error:
        for item in items:
            item["alone"] = str(error).partition(";")[0]
        return replay
    other = Builder(worlds=builder.worlds)
    contest.add_episodes(other, best, games, contest.best_name)
    sign, lost = 1 if contest.measure.less_is_better else -1, contest.lost_by_start(policy)
    for item, beside in zip(items, other.items, strict=True):
        item |= {"by": policy_name, "beside": beside}
        beside |= {"by": contest.best_name, "overlays": item.get("overlays", [])}
        if contest.measure.by_steps:
            item["lost"] = sign * (item["length"] - beside["length"])
        if lost is not None:
            item["map"] = [None if np.isnan(steps) else round(steps, 3) for steps in lost.tolist()]
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
