"""Adapters between replays and simulators of mazes or arms: settings, start states, and states."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.rewards import rewards_text
from pursuit.tasks.task import Task
from pursuit.tasks.visibility import agent_choice_text, view_radius_text

State = dict[str, NDArray[Any]]


class MazeAdapter:
    """Adapter for games in mazes. An action has one integer per agent."""

    name = "maze"

    def settings(self, task: Task) -> dict[str, Any]:
        """The task as plain values, without a reward function (replays store the rewards).

        Settings of partial observability are written only if used, so that older versions can read
        the file.
        """
        plain = {
            each.name: getattr(task, each.name)
            for each in fields(task)
            if each.name not in ("maze", "rewards", *VISIBILITY_SETTINGS)
        }
        plain |= visibility_settings(task)
        plain["mazes"] = [{"name": maze.name, "text": maze.to_text()} for maze in task.mazes]
        plain["rewards"] = None if has_reward_function(task) else _rewards_as_text(task)
        return plain

    def task(self, settings: dict[str, Any]) -> Task:
        """The task with these settings; ValueError for invalid ones."""
        given = dict(settings)
        mazes = given.pop("mazes", None)
        if not isinstance(mazes, list) or not mazes or not all(isinstance(m, dict) for m in mazes):
            raise ValueError(f"mazes={mazes!r}; give a list of mazes with name and text")
        found = []
        for maze in mazes:
            text, name = maze.get("text"), maze.get("name")
            if not isinstance(text, str) or not isinstance(name, str):
                raise ValueError(f"maze {maze!r}; give a name and a text")
            found.append(Maze.from_text(text, name))
        rewards = given.pop("rewards", None)
        if rewards is not None and ":" in str(rewards):
            raise ValueError(f"rewards={rewards!r}; a replay cannot name a function")
        unknown = set(given) - {each.name for each in fields(Task)}
        if unknown:
            raise ValueError(f"unknown settings of a task: {', '.join(sorted(unknown))}")
        scheme = {} if rewards is None else {"rewards": rewards}
        return Task(maze=found[0] if len(found) == 1 else tuple(found), **given, **scheme)

    def agents(self, task: Task) -> list[str]:
        """The names of the agents, one for each column of the rewards."""
        return list(task.agent_names)

    def simulator(self, task: Task) -> Simulator:
        """A simulator of one game without automatic restarts."""
        return Simulator(task, auto_restart=False)

    def start(self, simulator: Simulator, game: int) -> dict[str, Any]:
        """The start state of the episode, as plain values."""
        return {
            "positions": simulator.positions[game].tolist(),
            "goals": simulator.goals[game].tolist(),
            "maze": int(simulator.maze_index[game]),
        }

    def begin(self, simulator: Simulator, start: dict[str, Any]) -> None:
        """Start an episode in the game of a simulator; ValueError for an invalid start state."""
        goals = start.get("goals")
        simulator.place(start.get("positions"), goals or None, start.get("maze", 0))  # type: ignore[arg-type]

    def state(self, simulator: Simulator, game: int, final: bool = False) -> State:
        """Copies of the current state of a game, or of the final state of its last episode.

        The keys are "cells" [agents], -1 after capture, "goals", and "events" [agents].
        """
        games = simulator._outcome.final if final else simulator.games
        cells = np.where(games.active[game] == 0, -1, games.position[game])
        return {
            "cells": cells.astype("<i4"),
            "goals": games.goal[game].astype("<i4"),
            "events": games.event[game].astype("<i4"),
        }

    def step(self, simulator: Simulator, action: NDArray[Any]) -> None:
        """Step the one game of a simulator."""
        simulator.step(action[None].astype(np.int32))

    def rewards(self, simulator: Simulator, game: int) -> NDArray[np.float32]:
        """[agents] the rewards of the last step."""
        return simulator.rewards[game].copy()

    def width(self, task: Task) -> int:
        """The number of values of the actions of one step."""
        return task.num_agents


class ArmAdapter:
    """Adapter for arms. An action has one number per joint."""

    name = "arm"

    def settings(self, task: ReacherTask) -> dict[str, Any]:
        """The task as plain values."""
        return {each.name: getattr(task, each.name) for each in fields(task)}

    def task(self, settings: dict[str, Any]) -> ReacherTask:
        """The task with these settings; ValueError for invalid ones."""
        unknown = set(settings) - {each.name for each in fields(ReacherTask)}
        if unknown:
            raise ValueError(f"unknown settings of an arm: {', '.join(sorted(unknown))}")
        return ReacherTask(**settings)

    def agents(self, task: ReacherTask) -> list[str]:
        """The names of the agents, one for each column of the rewards."""
        return ["arm"]

    def simulator(self, task: ReacherTask) -> ReacherSimulator:
        """A simulator of one game without automatic restarts."""
        return ReacherSimulator(task, auto_restart=False)

    def start(self, simulator: ReacherSimulator, game: int) -> dict[str, Any]:
        """The start state of the episode, as plain values."""
        arms = simulator.arms
        return {
            "angles": arms.angles[game].tolist(),
            "target": arms.target[game].tolist(),
            "free_joints": int(arms.free_joints[game]),
            "hold": int(arms.hold[game]),
            "tolerance": float(arms.tolerance[game]),
        }

    def begin(self, simulator: ReacherSimulator, start: dict[str, Any]) -> None:
        """Start an episode in the game of a simulator; ValueError for an invalid start state."""
        kept = {name: start.get(name) for name in ("free_joints", "hold", "tolerance")}
        simulator.configure(**kept)
        simulator.place(start.get("angles", ()), start.get("target", ()))

    def state(self, simulator: ReacherSimulator, game: int, final: bool = False) -> State:
        """Copies of the current state of an arm, or of the final state of its last episode.

        The keys are "angles" [joints] and "target" [2]."""
        arms = simulator.final if final else simulator.arms
        return {
            "angles": arms.angles[game].astype("<f8"),
            "target": arms.target[game].astype("<f8"),
        }

    def step(self, simulator: ReacherSimulator, action: NDArray[Any]) -> None:
        """Step the one game of a simulator."""
        simulator.step(action[None])

    def rewards(self, simulator: ReacherSimulator, game: int) -> NDArray[np.float32]:
        """[agents] the rewards of the last step."""
        return simulator.rewards[game : game + 1].copy()

    def width(self, task: ReacherTask) -> int:
        """The number of values of the actions of one step."""
        return task.joints


VISIBILITY_SETTINGS = ("view_radius", "line_of_sight", "unknown_maze")


def visibility_settings(task: Task) -> dict[str, Any]:
    """The settings of partial observability that are in use, as text."""
    radius: Any = task.view_radius
    chosen: Any = {name: getattr(task, name) for name in VISIBILITY_SETTINGS[1:]}
    texts = {name: agent_choice_text(agents) for name, agents in chosen.items()}
    return {
        n: t for n, t in {VISIBILITY_SETTINGS[0]: view_radius_text(radius), **texts}.items() if t
    }


def has_reward_function(task: Any) -> bool:
    """Whether the task uses a custom reward function."""
    return isinstance(task, Task) and task.reward_function is not None


def _rewards_as_text(task: Task) -> str:
    if isinstance(task.rewards, str):
        return task.rewards
    by_role = {role: dict(vars(rewards)) for role, rewards in task.role_rewards.items()}
    return rewards_text(by_role)


Adapter = MazeAdapter | ArmAdapter
ADAPTERS: dict[str, Any] = {"maze": MazeAdapter(), "arm": ArmAdapter()}


def adapter_for(task: Any) -> Any:
    """The adapter of a task; ValueError for other objects."""
    if isinstance(task, Task):
        return ADAPTERS["maze"]
    if isinstance(task, ReacherTask):
        return ADAPTERS["arm"]
    raise ValueError(f"task={task!r}; give a pursuit.Task or a pursuit.ReacherTask")
