"""The data of the viewer page: played-back replays as plain values."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.observations.observations import PLANES
from pursuit.rendering.marks import outcome_text
from pursuit.replays.adapters import POSITIONS, Plain, State
from pursuit.replays.viewer.page import page
from pursuit.rules.arrays import Array
from pursuit.rules.layout import CAPTURED, COLLECTED, ESCAPED
from pursuit.rules.visibility import EXITS, IN_VIEW

MOVING = PLANES.index("walkable")
"""Planes before this one (of the encoding "planes") show agents and goals, the others the maze."""
MOST_NUMBERS = 400
"""Observations with more numbers are not shown as numbers."""
MOST_SEEN_STEPS = 2000
"""Longer episodes are shown without observations."""


@dataclass(frozen=True)
class Overlay:
    """Values and policies of one agent of a duel, shown as an overlay of the board.

    Attributes:
        name: name of the agent.
        seat, other: indices of the agent and of its opponent.
        values: [own cell, opponent cell] float, exact expected steps until capture.
        learned: [own cell, opponent cell, action] float, probabilities of the learned policy.
        optimal: [own cell, opponent cell, action] bool, the optimal actions.
    """

    name: str
    seat: int
    other: int
    values: NDArray[np.float64] | None = None
    learned: NDArray[np.float64] | None = None
    optimal: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Extras:
    """Additional data for the episodes of a replay.

    Attributes:
        names: names of the episodes, in order; default: their labels.
        overlays: overlays of the board, for duels in one maze.
        seat: name of the agent with visible observations; None for no observations.
        encoding: encoding of the observations.
    """

    names: Sequence[str] = ()
    overlays: Sequence[Overlay] = ()
    seat: str | None = None
    encoding: str | None = None


@dataclass
class Builder:
    """Collects the data of a page.

    Attributes:
        items: one dict per episode; see `player.js`.
        worlds: the distinct mazes and arms.
        overlays: one dict per `Overlay`; see `overlay_data`.
        warnings: messages on episodes that differ from their recordings.
    """

    items: list[Plain] = field(default_factory=list)
    worlds: list[Plain] = field(default_factory=list)
    overlays: list[Plain] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add(self, replay: Any, extras: Extras = Extras()) -> None:
        """Add every episode of a `pursuit.replays.replay.Replay`."""
        first = len(self.overlays)
        self.overlays += [overlay_data(overlay) for overlay in extras.overlays]
        numbers = list(range(first, len(self.overlays)))
        for number, episode in enumerate(replay.episodes):
            played = replay.play(number)
            rewards = played.rewards
            if replay.own_rewards:  # known only from the recording
                rewards = episode.rewards[: len(played.rewards)]
            title = " ".join(filter(None, (replay.title, episode.label)))
            name = extras.names[number] if number < len(extras.names) else title
            item = {
                "name": name or f"episode {len(self.items) + 1}",
                "note": "",
                "length": len(played.states) - 1,
                "terminated": episode.terminated,
                "truncated": episode.truncated,
                "players": [replay.players.get(agent, "") for agent in replay.agents],
                "rewards": [_plain(column) for column in rewards.T],
                "overlays": numbers,
            }
            if played.differences:
                differences = "; ".join(played.differences)
                then = replay.versions.get("pursuit", "unknown")
                item["note"] = (
                    f"The playback differs from the recording (pursuit {then}): {differences}."
                )
                self.warnings.append(f"{item['name']}: {item['note']}")
            fill = self._arm if replay.world.name == "arm" else self._maze
            fill(item, replay, episode, played.states, extras)
            self.items.append(item)

    def data(self, title: str) -> Plain:
        """The data for `player.js`."""
        return {
            "title": title,
            "items": self.items,
            "worlds": self.worlds,
            "overlays": self.overlays,
        }

    def _world(self, world: Plain) -> int:
        if world not in self.worlds:
            self.worlds.append(world)
        return self.worlds.index(world)

    def _maze(
        self, item: Plain, replay: Any, episode: Any, states: list[State], extras: Extras
    ) -> None:
        task = replay.task
        number = int(episode.start.get("maze") or 0)
        maze, exits = task.mazes[number], task.fixed_exits[number]
        exits = [int(cell) for cell in episode.start.get("exits") or exits]
        item["world"] = self._world(maze_data(maze, task.agent_names, task.num_goals, exits))
        cells = np.stack([state["cells"] for state in states])
        positions = np.stack([state[POSITIONS] for state in states])
        goals = np.stack([state["goals"] for state in states]).reshape(len(states), -1)
        events = np.stack([state["events"] for state in states])
        item["gone"] = [_first(cells[:, agent] < 0) for agent in range(cells.shape[1])]
        item["cells"] = [positions[:, agent].tolist() for agent in range(cells.shape[1])]
        item["goals"] = [
            [int(goals[0, goal]), _first(goals[:, goal] < 0)] for goal in range(goals.shape[1])
        ]
        evaders = slice(task.num_chasers, task.num_chasers + task.num_evaders)
        left = np.zeros(task.num_agents, dtype=bool)
        left[evaders] = np.any(events[:, evaders] & ESCAPED, axis=0)
        item["escaped"] = left.tolist()
        fates = [
            "free" if gone is None else "escaped" if escaped else "captured"
            for gone, escaped in zip(item["gone"][evaders], item["escaped"][evaders], strict=True)
        ]
        taken = [gone for _, gone in item["goals"] if gone != 0]  # others are not in this game
        item["outcome"] = outcome_text(fates, taken.count(None), len(taken))
        item["events"] = [
            [int(step), int(agent), kind]
            for kind, bit in (("collected", COLLECTED), ("captured", CAPTURED))
            for step, agent in np.argwhere(events & bit)
        ]
        if extras.seat is not None and len(states) <= MOST_SEEN_STEPS:
            self._observed(item, replay, episode, extras)

    def _observed(self, item: Plain, replay: Any, episode: Any, extras: Extras) -> None:
        task, simulator = replay.task, replay.world.simulator(replay.task)
        seat, encoding = task.seat(extras.seat), extras.encoding
        replay.world.begin(simulator, episode.start)
        marks, numbers = [], []
        maze = task.mazes[int(episode.start.get("maze") or 0)]
        for step in range(item["length"] + 1):
            if maze.is_grid:
                planes = simulator.observe("planes", seat)[0]
                planes = np.concatenate([planes[:MOVING], planes[len(PLANES) :]])  # visible cells
                marks.append(
                    [[int(p), int(maze.cell_numbers[r, c])] for p, r, c in np.argwhere(planes)]
                )
            if encoding is not None and encoding != "planes":
                numbers.append(simulator.observe(encoding, seat)[0].ravel())
            if step < item["length"]:
                replay.world.step(simulator, episode.actions[step])
        item["seen"] = {
            "agent": task.agent_names[seat],
            "names": list(PLANES[:MOVING])
            + [IN_VIEW] * task.sight.limited
            + [EXITS] * bool(task.most_exits),
            "steps": marks,
        }
        if numbers and len(numbers[0]) <= MOST_NUMBERS:
            rows = [_plain(row) for row in numbers]
            item["observed"] = {"encoding": encoding, "steps": rows}

    def _arm(
        self, item: Plain, replay: Any, episode: Any, states: list[State], extras: Extras
    ) -> None:
        task = replay.task
        tolerance = float(episode.start.get("tolerance") or task.tolerance)
        item["world"] = self._world({"kind": "arm", "joints": task.joints, "tolerance": tolerance})
        item["angles"] = [np.round(state["angles"], 4).tolist() for state in states]
        item["target"] = np.round(states[0]["target"], 4).tolist()
        item["events"] = []


def maze_data(
    maze: Maze, agents: Sequence[str], num_goals: int, exits: Sequence[int] = ()
) -> Plain:
    """The world of `maze_board.js`."""
    height, width = maze.picture_size
    more: Plain = {"exits": list(exits)} if exits else {}
    if not maze.is_grid:
        more |= {"neighbors": maze.neighbors.tolist(), "names": list(maze.cell_names)}
    return more | {
        "kind": "maze",
        "name": maze.name,
        "height": _plain_number(height),
        "width": _plain_number(width),
        "walls": maze.to_text() if maze.is_grid else "",
        "cells": [[_plain_number(n) for n in place] for place in maze.picture.tolist()],
        "agents": [{"name": name, "role": name.split("_")[0]} for name in agents],
        "num_goals": num_goals,
    }


def overlay_data(overlay: Overlay) -> Plain:
    """An overlay of `player.js`: values in float32, probabilities in 1/255, actions as bits."""
    given = next(a for a in (overlay.values, overlay.learned, overlay.optimal) if a is not None)
    actions = [a.shape[2] for a in (overlay.learned, overlay.optimal) if a is not None]
    found: Plain = {
        "name": overlay.name,
        "seat": overlay.seat,
        "other": overlay.other,
        "cells": len(given),
        "actions": actions[0] if actions else 0,
    }
    if overlay.values is not None:
        found["values"] = _bytes(overlay.values.astype("<f4"))
    if overlay.learned is not None:
        found["learned"] = _bytes(np.round(255.0 * overlay.learned).astype(np.uint8))
    if overlay.optimal is not None:
        bits = (overlay.optimal << np.arange(overlay.optimal.shape[2])).sum(axis=2)
        found["optimal"] = _bytes(bits.astype("<u4"))
    return found


def replay_page(replays: Mapping[str, Any] | Sequence[Any], title: str = "") -> str:
    """A page with a viewer of several replays.

    Args:
        replays: objects of `pursuit.replays.replay.Replay`; a mapping also gives their names.
        title: plain text.

    Raises:
        ValueError: no episodes, or an invalid start state.
    """
    builder = Builder()
    named = replays.items() if isinstance(replays, Mapping) else [("", each) for each in replays]
    for name, replay in named:
        labels = [each.label or f"episode {n + 1}" for n, each in enumerate(replay.episodes)]
        names = [" ".join(filter(None, (name or replay.title, label))) for label in labels]
        builder.add(replay, Extras(names=names))
    if not builder.items:
        raise ValueError("no episode to show; play one to its end first")
    return page(title or "pursuit replay", builder.data(title))


def _plain(numbers: Array) -> list[float]:
    if not np.isfinite(numbers).all():
        raise ValueError("a reward or observation is not finite; viewers show finite numbers")
    return [_plain_number(n) for n in numbers.tolist()]


def _plain_number(number: float) -> float:
    """A number with at most five decimals, an int if it is one."""
    return int(number) if number == int(number) else round(float(number), 5)


def _first(found: NDArray[np.bool_]) -> int | None:
    return int(np.argmax(found)) if found.any() else None


def _bytes(array: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
