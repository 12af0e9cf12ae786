"""How much the exact equilibrium of a game mixes, where it is known before training."""

from __future__ import annotations

from dataclasses import replace

from pursuit.tasks.task import Task
from scripted_agents.games import game_of_sides
from scripted_agents.games.mixing import mixed_share
from scripted_agents.games.simulator import GameTask
from train.self_play.mixtures import solved

MOST_SOLVED = 100_000
"""Joint actions of a zero-sum game up to which its equilibrium is computed: seconds."""
MOST_STATES = 2_500
"""States of a game in a maze up to which it is solved before training: about a second."""


def known_mixed_share(task: Task | GameTask, discount: float) -> float | None:
    """The `mixed_share` of a zero-sum game of two sides with this discount; None where it is not
    computed: in large games, with limited views, goals or exits, with other rewards, and with more
    players."""
    if isinstance(task, GameTask):
        if not task.game.zero_sum or len(task.game.choices) > MOST_SOLVED:
            return None
        return mixed_share(task.game, discount, task.horizon(discount), solved(task, discount))
    limited = any(task.hides_from(agent) for agent in task.agent_names)
    if task.rewards != "zero_sum" or limited or task.num_goals or task.most_exits:
        return None
    if task.options.turns:
        return 0.0  # each side sees the other's move, so that pure play is optimal
    try:
        game = game_of_sides(replace(task, max_steps=1), MOST_STATES)
    except ValueError:
        return None
    return mixed_share(game, discount)


def describe_mixing(share: float | None) -> list[str]:
    """A mixed share in sentences; none for None."""
    if share is None:
        return []
    if share == 0.0:
        return ["equilibrium: pure play is optimal in every state that it visits"]
    return [f"equilibrium: optimal play is random in {100.0 * share:.3g} % of its visits"]
