"""Adapters between replays and simulators of mazes or arms: settings, start states, and states."""

from __future__ import annotations

import base64
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.rules.arrays import Array
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.options import slip_text
from pursuit.tasks.rewards import rewards_text
from pursuit.tasks.task import Task
from pursuit.tasks.visibility import agent_choice_text, view_radius_text
from pursuit.validation import Plain as Plain
from pursuit.validation import whole

State = dict[str, Array]
POSITIONS = "positions"
DIGITS = "0123456789abcdefghijklmnopqrstuv"
"""The texts of the actions in a maze."""


class TaskAdapter:
    """What the adapters of mazes and arms have in common.

    Attributes:
        name: the name in files.
        task_class, simulator_class: the classes of tasks and simulators.
        action_dtype: the dtype of recorded actions.
    """

    name: str
    task_class: type[Any]
    simulator_class: type[Any]
    action_dtype: type[np.generic]

    def task(self, settings: Plain) -> Any:
        """The task with these settings; ValueError for invalid ones."""
        unknown = set(settings) - {each.name for each in fields(self.task_class)}
        if unknown:
            raise ValueError(f"unknown settings of a task: {', '.join(sorted(unknown))}")
        return self.task_class(**settings)

    def agents(self, task: Any) -> list[str]:
        """The names of the agents, one for each column of the rewards."""
        return list(task.agent_names)

    def simulator(self, task: Any) -> Any:
        """A simulator of one game without automatic restarts."""
        return self.simulator_class(task, auto_restart=False)

    def step(self, simulator: Any, action: Array) -> None:
        """Step the one game of a simulator."""
        simulator.step(action[None])

    def rewards(self, simulator: Any, game: int) -> NDArray[np.float32]:
        """[agents] the rewards of the last step."""
        return np.atleast_1d(simulator.rewards[game]).copy()


OPTIONS = {"slip": "0"} | {
    name: getattr(Task, name)
    for name in ("capture", "n_catch", "capture_check", "exits", "num_exits", "collisions")
}
"""The defaults of the options of the rules, as in the settings of a replay."""


class MazeAdapter(TaskAdapter):
    """Adapter for games in mazes. An action has one integer per agent."""

    name, task_class, simulator_class, action_dtype = "maze", Task, Simulator, np.uint8

    def settings(self, task: Task) -> Plain:
        """The task as plain values, without a reward function (replays store the rewards).

        Settings of partial observability and options of the rules are written only if used, so that
        older versions can read the file.
        """
        own: Plain = {**vars(task), "slip": slip_text(task.slip)}
        seen = ("maze", "rewards", "view_radius", "line_of_sight", "unknown_maze")
        names = [each.name for each in fields(task) if each.name not in seen]
        plain = {name: own[name] for name in names if own[name] != OPTIONS.get(name, ())}
        visibility: Plain = {
            "view_radius": view_radius_text(own["view_radius"]),
            "line_of_sight": agent_choice_text(own["line_of_sight"]),
            "unknown_maze": agent_choice_text(own["unknown_maze"]),
        }
        plain |= {name: text for name, text in visibility.items() if text}
        plain["mazes"] = [{"name": maze.name, "text": maze.to_text()} for maze in task.mazes]
        plain["rewards"] = None if has_reward_function(task) else _rewards_as_text(task)
        return plain

    def task(self, settings: Plain) -> Any:
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
        given |= {} if rewards is None else {"rewards": rewards}
        maze = found[0] if len(found) == 1 else tuple(found)
        return super().task(dict(maze=maze, **given))  # a TypeError if `given` has a maze, too

    def start(self, simulator: Simulator, game: int) -> Plain:
        """The start state of the episode, as plain values."""
        plain: Plain = {
            "positions": simulator.positions[game].tolist(),
            "goals": simulator.goals[game].tolist(),
            "maze": int(simulator.maze_index[game]),
        }
        if simulator.task.num_exits:
            plain["exits"] = simulator.exits[game].tolist()
        if simulator.slip is not None:  # played back with the same random numbers
            plain["slip"] = simulator.slip[game].tolist()
            plain["slip_stream"] = int(simulator.streams[game, -1])
        return plain

    def begin(self, simulator: Simulator, start: Plain) -> None:
        """Start an episode in the game of a simulator; ValueError for an invalid start state."""
        goals, exits = start.get("goals"), start.get("exits")
        if simulator.slip is not None:
            simulator.configure(slip=np.array([start.get("slip")]))
        simulator.place(start.get("positions"), goals or None, start.get("maze", 0), exits=exits)  # type: ignore[arg-type]
        if simulator.slip is not None:
            simulator.streams[0, -1] = whole("slip_stream", start.get("slip_stream"), 0, 2**64 - 1)

    def state(self, simulator: Simulator, game: int, final: bool = False) -> State:
        """Copies of the current state of a game, or of the final state of its last episode.

        The keys are "cells" [agents], -1 after capture, "goals", "events" [agents] and "positions"
        [agents], the cells with those of agents that have left the game.
        """
        games = simulator._outcome.final if final else simulator.games
        cells = np.where(games.active[game] == 0, -1, games.position[game])
        return {
            "cells": cells.astype("<i4"),
            "goals": games.goal[game].astype("<i4"),
            "events": games.event[game].astype("<i4"),
            POSITIONS: games.position[game].copy(),
        }

    def text_of_actions(self, actions: Array) -> list[str]:
        """One string of digits per agent."""
        return ["".join(DIGITS[action] for action in row) for row in actions.T]

    def actions_of_text(self, text: list[str] | str, task: Task) -> Array:
        """See `text_of_actions`."""
        if isinstance(text, str):
            raise ValueError("actions do not fit world 'maze'")
        width = task.num_agents
        if len(text) != width or len({len(row) for row in text}) > 1:
            raise ValueError(f"actions need {width} rows of equal length, one per agent")
        actions = np.array([[int(digit, 32) for digit in row] for row in text], np.uint8).T
        if actions.size and actions.max() >= task.num_actions:
            raise ValueError(f"action {actions.max()}; actions are 0 to {task.num_actions - 1}")
        return actions


class ArmAdapter(TaskAdapter):
    """Adapter for arms. An action has one number per joint."""

    name, task_class, simulator_class = "arm", ReacherTask, ReacherSimulator
    action_dtype = np.float64

    def settings(self, task: ReacherTask) -> Plain:
        """The task as plain values."""
        return {each.name: getattr(task, each.name) for each in fields(task)}

    def start(self, simulator: ReacherSimulator, game: int) -> Plain:
        """The start state of the episode, as plain values."""
        arms = simulator.arms
        return {
            "angles": arms.angles[game].tolist(),
            "target": arms.target[game].tolist(),
            "free_joints": int(arms.free_joints[game]),
            "hold": int(arms.hold[game]),
            "tolerance": float(arms.tolerance[game]),
        }

    def begin(self, simulator: ReacherSimulator, start: Plain) -> None:
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

    def text_of_actions(self, actions: Array) -> str:
        """The bytes of the numbers in base64."""
        return base64.b64encode(np.ascontiguousarray(actions, "<f8").tobytes()).decode("ascii")

    def actions_of_text(self, text: list[str] | str, task: ReacherTask) -> Array:
        """See `text_of_actions`."""
        if not isinstance(text, str):
            raise ValueError("actions do not fit world 'arm'")
        raw, width = base64.b64decode(text, validate=True), task.joints
        if len(raw) % (8 * width):
            raise ValueError(f"actions of {len(raw)} bytes; a step has {width} numbers of 8 bytes")
        actions: Array = np.frombuffer(raw, "<f8").reshape(-1, width)
        if not (np.abs(actions) <= 1.0 + 1e-6).all():
            raise ValueError("an action is outside [-1, 1]")
        return actions


def has_reward_function(task: object) -> bool:
    """Whether the task uses a custom reward function."""
    return isinstance(task, Task) and task.reward_function is not None


def _rewards_as_text(task: Task) -> str:
    if isinstance(task.rewards, str):
        return task.rewards
    by_role = {role: dict(vars(rewards)) for role, rewards in task.role_rewards.items()}
    return rewards_text(by_role)


Adapter = MazeAdapter | ArmAdapter
ADAPTERS: dict[str, Adapter] = {"maze": MazeAdapter(), "arm": ArmAdapter()}


def adapter_for(task: object) -> Adapter:
    """The adapter of a task; ValueError for other objects."""
    for adapter in ADAPTERS.values():
        if isinstance(task, adapter.task_class):
            return adapter
    raise ValueError(f"task={task!r}; give a pursuit.Task or a pursuit.ReacherTask")
