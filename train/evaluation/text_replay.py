"""Episodes of games that are shown as text, for the viewer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from pursuit.replays.viewer.data import Builder
from pursuit.simulator.batch import Batch
from train.evaluation.games import stepper
from train.files import Plain


def add_text_episodes(
    builder: Builder,
    start: Callable[[int], Batch[Any]],
    policies: Sequence[Any],
    games: Mapping[str, int],
    labels: Sequence[str],
) -> None:
    """Play episodes and add them to a page, with `Batch.text` as the board.

    Args:
        builder: of the page.
        start: (number) -> a batch of this one game of an evaluation at its start.
        policies: of all agents, in their order.
        games: the numbers of the episodes by label.
        labels: the names of the policies.
    """
    world: Plain = {
        "kind": "game",
        "states": [],
        "legend": "Action and reward: of the last step. No exact values are known.",
    }
    for label, number in games.items():
        batch = start(number)
        world["agents"] = [{"name": name} for name in batch.task.agent_names]
        actions = np.zeros((1, batch.task.num_agents), dtype=np.int32)
        step, first = stepper(batch, policies, actions), len(world["states"])
        taken, rewards = list[list[str]](), list[list[float]]()
        world["states"].append(_state(batch))
        while not batch.ended.any():
            step()
            taken.append([str(action) for action in actions[0].tolist()])
            now = np.broadcast_to(batch.rewards[0], batch.task.num_agents).astype(float)
            rewards.append(np.round(now, 5).tolist())
            world["states"].append(_state(batch))
        builder.items.append(
            {
                "name": label,
                "world": len(builder.worlds),
                "length": len(taken),
                "terminated": bool(batch.terminated[0]),
                "truncated": bool(batch.truncated[0]),
                "shows_end": True,
                "rewards": np.transpose(rewards).tolist(),
                "states": [*range(first, len(world["states"]))],
                "actions": taken,
                "players": list(labels),
            }
        )
    builder.worlds.append(world)


def _state(batch: Batch[Any]) -> Plain:
    text = batch.text(0)
    return {"text": text, "drawing": text, "choices": []}
