"""A closer look at a policy: where it loses steps, and replays of its episodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Side
from pursuit.tasks.task import Task
from scripted_agents import action_values
from train.evaluation.contest import GameContest
from train.evaluation.games import is_exact, table_in
from train.evaluation.scores import label_of
from train.evaluation.suite_contest import SuiteContest

MOST_OVERLAY_CELLS = 225
"""Tables of larger mazes would make a page heavy: they grow with the square."""
MOST_BOTH_CELLS = 100
"""Up to here both sides of a duel are laid over the board."""


def recorded(contest: Any, policy: Any, games: Mapping[str, int], player: str) -> Replay:
    """Episodes of a contest as a replay.

    Args:
        contest: a `Contest`.
        policy: whose contest it is.
        games: the numbers of the episodes by their labels.
        player: what `policy` is called.
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


def players_of(contest: Any, player: str) -> dict[str, str]:
    """Who acts in a contest, in words, by agent."""
    if not isinstance(contest, (GameContest, SuiteContest)):
        return {"arm": player}
    task, own = contest.task, contest.task.agent_names[contest.task.seat(contest.agent)]
    found = {}
    for name, role in zip(task.agent_names, task.seat_roles, strict=True):
        policy = contest.opponents.get(name, contest.opponents.get(role))
        found[name] = player if name == own or policy is None else label_of(policy)
    return found


def sides_of(contest: Any, policy: Any, most_both: int = MOST_BOTH_CELLS) -> list[Side]:
    """The exact values, and learned and optimal moves, of a duel; of its learner first.

    Up to `most_both` cells those of both sides.

    What is optimal is so with full sight, and called that where the task limits it. None where it
    is no duel of tables, or in too large a maze.
    """
    if not isinstance(contest, GameContest) or not contest.is_exact:
        return []
    task = contest.task
    if task.max_cells > MOST_OVERLAY_CELLS:
        return []
    maze, seat = task.mazes[0], task.seat(contest.agent)
    theirs = contest.opponent_table()
    tabular = is_exact(task, policy)
    learned = table_in(task, policy) if tabular else None
    rules: dict[str, Any] = {
        "horizon": task.max_steps,
        "stay_action": task.stay_action,
        "move_order": task.move_order,
    }
    names, other = task.agent_names, 1 - seat
    own: Any = task.seat_roles[seat]
    found = action_values(own, maze, theirs, **rules)
    called = {agent: called_by_sight(task, agent) for agent in names}
    sides = [Side(called[names[seat]], seat, other, found.values, learned, found.optimal)]
    if learned is not None and maze.num_cells <= most_both:
        role: Any = task.seat_roles[other]
        found = action_values(role, maze, learned, **rules)
        sides.append(Side(called[names[other]], other, seat, found.values, theirs, found.optimal))
    return sides


def called_by_sight(task: Task, agent: str) -> str:
    """What the side of an agent is called whose exact values are those of full sight."""
    return f"{agent} with full sight" if task.hides_from(agent) else agent
