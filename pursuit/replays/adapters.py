"""What a replay must know of a world: how an episode begins, and what a state is."""

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
    """Games in mazes. Actions are one a seat."""

    name = "maze"

    def settings(self, task: Task) -> dict[str, Any]:
        """The task as plain values; a function that pays is not kept, as its rewards are.

        What limits sight stands there only where something does, so that older versions read it.
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
        """The task again; ValueError for settings of none."""
        given = dict(settings)
        mazes = given.pop("mazes", None)
        if not isinstance(mazes, list) or not mazes or not all(isinstance(m, dict) for m in mazes):
            raise ValueError(f"mazes={mazes!r}; a list of mazes with name and text is needed")
        found = []
        for maze in mazes:
            text, name = maze.get("text"), maze.get("name")
            if not isinstance(text, str) or not isinstance(name, str):
                raise ValueError(f"maze {maze!r}; it has a name and a text")
            found.append(Maze.from_text(text, name))
        rewards = given.pop("rewards", None)
        if rewards is not None and ":" in str(rewards):
            raise ValueError(f"rewards={rewards!r}; a replay names no code")
        unknown = set(given) - {each.name for each in fields(Task)}
        if unknown:
            raise ValueError(f"unknown settings of a task: {', '.join(sorted(unknown))}")
        paid = {} if rewards is None else {"rewards": rewards}
        return Task(maze=found[0] if len(found) == 1 else tuple(found), **given, **paid)

    def agents(self, task: Task) -> list[str]:
        """Who acts: a column of the rewards each."""
        return list(task.agent_names)

    def simulator(self, task: Task) -> Simulator:
        """One game, which stays as it ended."""
        return Simulator(task, auto_restart=False)

    def start(self, simulator: Simulator, game: int) -> dict[str, Any]:
        """Where a game stands at the beginning of its episode, as plain values."""
        return {
            "positions": simulator.positions[game].tolist(),
            "goals": simulator.goals[game].tolist(),
            "maze": int(simulator.maze_index[game]),
        }

    def begin(self, simulator: Simulator, start: dict[str, Any]) -> None:
        """Put the one game of a simulator there; ValueError for what is no start."""
        goals = start.get("goals")
        simulator.place(start.get("positions"), goals or None, start.get("maze", 0))  # type: ignore[arg-type]

    def state(self, simulator: Simulator, game: int, final: bool = False) -> State:
        """Copies of what can be seen of a game now, or as its last episode ended.

        They are "cells" [agents], -1 once captured, "goals", and "events" [agents].
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
        """[agents], of the last step."""
        return simulator.rewards[game].copy()

    def width(self, task: Task) -> int:
        """Numbers of an action of all agents together."""
        return task.num_agents


class ArmAdapter:
    """Arms. An action has a number for every joint."""

    name = "arm"

    def settings(self, task: ReacherTask) -> dict[str, Any]:
        """The task as plain values."""
        return {each.name: getattr(task, each.name) for each in fields(task)}

    def task(self, settings: dict[str, Any]) -> ReacherTask:
        """The task again; ValueError for settings of none."""
        unknown = set(settings) - {each.name for each in fields(ReacherTask)}
        if unknown:
            raise ValueError(f"unknown settings of an arm: {', '.join(sorted(unknown))}")
        return ReacherTask(**settings)

    def agents(self, task: ReacherTask) -> list[str]:
        """Who acts: a column of the rewards each."""
        return ["arm"]

    def simulator(self, task: ReacherTask) -> ReacherSimulator:
        """One game, which stays as it ended."""
        return ReacherSimulator(task, auto_restart=False)

    def start(self, simulator: ReacherSimulator, game: int) -> dict[str, Any]:
        """Where a game stands at the beginning of its episode, as plain values."""
        arms = simulator.arms
        return {
            "angles": arms.angles[game].tolist(),
            "target": arms.target[game].tolist(),
            "free_joints": int(arms.free_joints[game]),
            "hold": int(arms.hold[game]),
            "tolerance": float(arms.tolerance[game]),
        }

    def begin(self, simulator: ReacherSimulator, start: dict[str, Any]) -> None:
        """Put the one game of a simulator there; ValueError for what is no start."""
        kept = {name: start.get(name) for name in ("free_joints", "hold", "tolerance")}
        simulator.configure(**kept)
        simulator.place(start.get("angles", ()), start.get("target", ()))

    def state(self, simulator: ReacherSimulator, game: int, final: bool = False) -> State:
        """Copies of an arm now, or as its last episode ended: "angles" [joints], "target" [2]."""
        arms = simulator.final if final else simulator.arms
        return {
            "angles": arms.angles[game].astype("<f8"),
            "target": arms.target[game].astype("<f8"),
        }

    def step(self, simulator: ReacherSimulator, action: NDArray[Any]) -> None:
        """Step the one game of a simulator."""
        simulator.step(action[None])

    def rewards(self, simulator: ReacherSimulator, game: int) -> NDArray[np.float32]:
        """[agents], of the last step."""
        return simulator.rewards[game : game + 1].copy()

    def width(self, task: ReacherTask) -> int:
        """Numbers of an action of all agents together."""
        return task.joints


VISIBILITY_SETTINGS = ("view_radius", "line_of_sight", "unknown_maze")


def visibility_settings(task: Task) -> dict[str, Any]:
    """What limits sight, as text, without what limits nothing."""
    radius: Any = task.view_radius
    chosen: Any = {name: getattr(task, name) for name in VISIBILITY_SETTINGS[1:]}
    texts = {name: agent_choice_text(who) for name, who in chosen.items()}
    return {
        n: t for n, t in {VISIBILITY_SETTINGS[0]: view_radius_text(radius), **texts}.items() if t
    }


def has_reward_function(task: Any) -> bool:
    """Whether a function of a user's pays in this task."""
    return isinstance(task, Task) and task.reward_function is not None


def _rewards_as_text(task: Task) -> str:
    if isinstance(task.rewards, str):
        return task.rewards
    by_role = {role: dict(vars(paid)) for role, paid in task.role_rewards.items()}
    return rewards_text(by_role)


Adapter = MazeAdapter | ArmAdapter
ADAPTERS: dict[str, Any] = {"maze": MazeAdapter(), "arm": ArmAdapter()}


def adapter_for(task: Any) -> Any:
    """The world of a task; ValueError for what is none."""
    if isinstance(task, Task):
        return ADAPTERS["maze"]
    if isinstance(task, ReacherTask):
        return ADAPTERS["arm"]
    raise ValueError(f"task={task!r}; replays are of a pursuit.Task or a pursuit.ReacherTask")
