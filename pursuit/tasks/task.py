"""Task: one frozen, validated description of a game, and the named tasks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.suites import load_mazes
from pursuit.rules import layout
from pursuit.tasks.placements import StartConstraint, check_placeable
from pursuit.tasks.rewards import REWARD_SCHEMES as REWARD_SCHEMES
from pursuit.tasks.rewards import ROLES as ROLES
from pursuit.tasks.rewards import RewardFunction, check_rewards, coefficients_of, function_of
from pursuit.tasks.rewards import Rewards as Rewards
from pursuit.tasks.visibility import (
    AgentChoice,
    Limit,
    ViewRadius,
    Visibility,
    check_agent_choice,
    check_view_radius,
    check_visible,
    limits_of,
    visibility_of,
)
from pursuit.validation import (
    FrozenDict,
    check_fields,
    choice,
    count,
    declared,
    flag,
    is_int,
    named_settings,
    one_of,
    whole,
)

MOVE_ORDERS = ("simultaneous", "chasers_first")
STARTS = ("random", "marks")


def _kept_mazes(name: str, given: Any) -> Any:
    """One maze as it is; several as a tuple, so that a caller's list does not stay inside."""
    if isinstance(given, (str, Path, Maze)):
        return given
    mazes = tuple(given) if isinstance(given, Iterable) else (given,)
    if not all(isinstance(maze, (str, Path, Maze)) for maze in mazes):
        raise ValueError(
            f"{name}={given!r}; give the name of a maze, a path, a Maze, or several of them"
        )
    if not mazes:
        raise ValueError(f"{name}: an empty list; give at least one maze")
    return mazes


def _kept_name(name: str, given: Any) -> Any:
    """A name as it is."""
    if not isinstance(given, str):
        raise ValueError(f"{name}={given!r}; it is a text")
    return given


@dataclass(frozen=True)
class Task:
    """Rules and settings of one game: never changes, hashes, and is checked at birth.

    Args:
        maze: the name of a shipped maze, a path, a `Maze`, a frozen suite ("suite:7x7-train"; see
            `pursuit.load_suite`), or several of them; with several, each game draws its own at
            every restart.
        num_chasers, num_evaders, num_runners: agents of each role.
        num_goals: goals, collected by runners and evaders.
        max_steps: an episode of this many steps is truncated.
        stay_action: whether action 4, stay, exists.
        move_order: "simultaneous", or "chasers_first": the chasers move, captures are resolved,
            then everybody else moves and captures are resolved again.
        start: "random": every agent and goal gets its own uniformly random cell; "marks": the
            first agent starts on `S`, the goals (or the evaders, where there are no goals) on the
            `G` marks in order, whoever has no mark at random.
        min_start_distance: path steps between every chaser and every evader at the start, at least.
            Cells that no path joins are infinitely far apart: every minimum holds for them.
        rewards: a named scheme ("goal", "completion", "distance", "zero_sum"); `Rewards` by role,
            or their text ("chaser.step=-0.1,evader.capture=-2"; without a role for all), where
            roles left out are paid as in "goal"; or a function of your own, itself or as
            "package.module:Name" (see `pursuit.tasks.rewards.RewardFunction`).
        view_radius: path steps up to which agents see: None for everything, a number, numbers by
            role or agent ({"chaser": 2, "evader_0": None}; an agent's own goes first), or their
            text ("2", "chaser=2,evader_0=3"). Who is not seen is absent from the observation.
        line_of_sight: who sees straight along rows and columns only, until a wall, and with a
            radius so far only: True for everybody, roles or agents, or their text ("chaser").
        unknown_maze: who knows of the maze only what is within view; likewise.
        name: what results call this task.

    Raises:
        ValueError: naming the value, the rule and the remedy.
    """

    maze: str | Path | Maze | Sequence[str | Path | Maze] = declared(_kept_mazes, default="5x5")
    num_chasers: int = count(0, default=0)
    num_evaders: int = count(0, default=0)
    num_runners: int = count(0, default=0)
    num_goals: int = count(0, default=0)
    max_steps: int = count(1, default=200)
    stay_action: bool = flag(False)
    move_order: str = choice(MOVE_ORDERS, default="simultaneous")
    start: str = choice(STARTS, default="random")
    min_start_distance: int = count(1, default=1)
    rewards: str | Mapping[str, Rewards] | RewardFunction = declared(check_rewards, default="goal")
    view_radius: ViewRadius | Mapping[str, int | None] | str = declared(
        check_view_radius, default=None
    )
    line_of_sight: AgentChoice | Sequence[str] | str = declared(check_agent_choice, default=False)
    unknown_maze: AgentChoice | Sequence[str] | str = declared(check_agent_choice, default=False)
    name: str = declared(_kept_name, default="custom")

    def __post_init__(self) -> None:
        check_fields(self)
        self._check_that_it_can_end()
        self._check_collectors()
        for number, maze in enumerate(self.mazes):
            self._check_maze(maze)
            check_placeable(self.apart(number, -1, self.min_start_distance, -1))
        self._check_visibility()

    def _check_that_it_can_end(self) -> None:
        if self.num_agents == 0:
            raise ValueError("a task without agents; give num_chasers, num_evaders or num_runners")
        for role, other in (("chaser", "evader"), ("evader", "chaser")):
            if self.count(role) and not self.count(other) and not self.num_goals:
                raise ValueError(
                    f"num_{role}s={self.count(role)}, num_{other}s=0 and no goals: nothing can end "
                    f"this game; give num_{other}s or num_goals"
                )

    def _check_collectors(self) -> None:
        if self.num_runners and not self.num_goals:
            raise ValueError(
                f"num_runners={self.num_runners} and num_goals=0; runners collect goals: give "
                "num_goals of at least 1"
            )
        if self.num_goals and not (self.num_runners or self.num_evaders):
            raise ValueError(
                f"num_goals={self.num_goals}, but only runners and evaders collect goals; give "
                "num_runners or num_evaders"
            )

    def _check_maze(self, maze: Maze) -> None:
        needed = self.num_agents + self.num_goals
        if needed > maze.num_cells:
            raise ValueError(
                f"{self.num_agents} agents and {self.num_goals} goals need {needed} cells of their "
                f"own; maze {maze.name} has {maze.num_cells}. Take fewer, or a larger maze"
            )
        if self.num_goals and not maze.is_connected:
            raise ValueError(
                f"maze {maze.name} falls into {maze.num_components} parts, so a goal could be out "
                "of reach; open a wall, or block the smaller parts with '#'"
            )

    def _check_visibility(self) -> None:
        if not all(limit.sees_all for limit in self._limits):
            for maze in self.mazes:
                check_visible(maze)

    def apart(self, maze: int, num_goals: int, least: int, most: int) -> StartConstraint:
        """How chasers and evaders are placed in the maze of that number.

        Of `num_goals` -1 is all, of `most` (and `least`, path steps) no limit.
        """
        teams, marked = self.teams, self.start == "marks"
        goals = teams.goals if num_goals < 0 else min(teams.goals, num_goals)
        return StartConstraint(self.mazes[maze], teams, marked, goals if marked else 0, least, most)

    @cached_property
    def mazes(self) -> tuple[Maze, ...]:
        """The mazes of this task."""
        return load_mazes(self.maze)

    @cached_property
    def role_rewards(self) -> dict[str, Rewards]:
        """The `Rewards` of every role; never changes. Those of "goal" where a function pays."""
        return FrozenDict(coefficients_of(self.rewards))

    @cached_property
    def reward_function(self) -> RewardFunction | None:
        """The function that pays instead of `role_rewards`, where there is one."""
        return function_of(self.rewards)

    @cached_property
    def _limits(self) -> tuple[Limit, ...]:
        radius: Any = self.view_radius
        in_line: Any = self.line_of_sight
        unknown: Any = self.unknown_maze
        return limits_of(self.agent_names, radius, in_line, unknown)

    @cached_property
    def sight(self) -> Visibility:
        """Who sees what; the tables are made on first use."""
        return visibility_of(self.mazes, self._limits)

    def sees(self, seat: str | int, maze_number: int = 0) -> NDArray[np.bool_]:
        """[own cell, other cell] bool, read-only: what an agent sees from each cell of a maze.

        Raises:
            ValueError: no such agent, or no such maze.
        """
        maze_number = whole("maze_number", maze_number, 0, len(self.mazes) - 1)
        return self.sight.sees(self.seat(seat), maze_number)

    def hides_from(self, seat: str | int) -> bool:
        """Whether anything can be out of an agent's view; not where its view has all cells.

        Raises:
            ValueError: no such agent.
        """
        if self.sight.limits[self.seat(seat)].sees_all:
            return False
        return not all(self.sees(seat, number).all() for number in range(len(self.mazes)))

    @property
    def num_agents(self) -> int:
        """Chasers plus evaders plus runners."""
        return self.num_chasers + self.num_evaders + self.num_runners

    @property
    def num_actions(self) -> int:
        """4, or 5 with the stay action."""
        return 5 if self.stay_action else 4

    @cached_property
    def max_cells(self) -> int:
        """The cells of the largest maze."""
        return max(maze.num_cells for maze in self.mazes)

    @cached_property
    def agent_names(self) -> tuple[str, ...]:
        """`("chaser_0", ..., "evader_0", ..., "runner_0", ...)`: the name of each seat."""
        return tuple(f"{role}_{i}" for role in ROLES for i in range(self.count(role)))

    @cached_property
    def seat_roles(self) -> tuple[str, ...]:
        """The role of each seat."""
        return tuple(name.split("_")[0] for name in self.agent_names)

    def count(self, role: str) -> int:
        """How many agents of `role` there are."""
        one_of("role", role, ROLES)
        return int(getattr(self, f"num_{role}s"))

    def seat(self, agent: str | int) -> int:
        """The seat of an agent given by its name, by its role (the first of it) or by number."""
        if isinstance(agent, str):
            names = self.agent_names
            if agent in self.seat_roles:
                return self.seat_roles.index(agent)
            if agent not in names:
                raise ValueError(f"unknown agent {agent!r}; this task has {', '.join(names)}")
            return names.index(agent)
        if not is_int(agent) or not 0 <= agent < self.num_agents:
            raise ValueError(f"seat {agent!r}; this task has seats 0 to {self.num_agents - 1}")
        return int(agent)

    @property
    def is_duel(self) -> bool:
        """One chaser against one evader, no goals: the game that is solved exactly."""
        return tuple(self.teams) == (1, 1, 0, 0)

    @property
    def teams(self) -> layout.Teams:
        """How many of each there are, as the rule book has it."""
        return layout.Teams(self.num_chasers, self.num_evaders, self.num_runners, self.num_goals)

    def numbers_for_kernels(self) -> NDArray[np.int64]:
        """As `layout.rules_of` takes them."""
        first, marks = self.move_order == "chasers_first", self.start == "marks"
        return layout.numbers_of(self.teams, self.max_steps, self.num_actions, first, marks)

    def rewards_for_kernels(self) -> NDArray[np.float64]:
        """[roles, fields of `RewardCoefficients`] float64, the argument of `layout.rules_of`."""
        paid = [self.role_rewards[role] for role in ROLES]
        names = layout.RewardCoefficients._fields
        return np.array([[getattr(each, name) for name in names] for each in paid], np.float64)


def checked_task(task: Any) -> Task:
    """`task`, if it is one; ValueError otherwise."""
    if not isinstance(task, Task):
        raise ValueError(f"task={task!r}; give a Task, such as pursuit.make_task('chase')")
    return task


HEIST_REWARDS = {"evader": Rewards(step=-0.1, capture=-1.0, goal=1.0)}
"""An evader that collects goals is in a hurry; paid for every step survived it would not be."""

_NAMED: dict[str, Callable[[], Task]] = {
    "chase": lambda: Task(num_chasers=1, num_evaders=1, name="chase"),
    "maze": lambda: Task(num_runners=1, num_goals=3, name="maze"),
    "race": lambda: Task(num_runners=2, num_goals=3, name="race"),
    "heist": lambda: Task(
        num_chasers=1, num_evaders=1, num_goals=3, rewards=HEIST_REWARDS, name="heist"
    ),
}
TASK_NAMES = tuple(_NAMED)


def make_task(name: str, **settings: Any) -> Task:
    """The named task ("chase", "maze", "race" or "heist") with `settings` of `Task` changed.

    `max_cycles` is PettingZoo's name of `max_steps`.

    Raises:
        ValueError: an unknown name, or settings that make no game.
        TypeError: an unknown setting, as an unknown keyword is everywhere.
    """
    one_of("task", name, TASK_NAMES)
    known = [field.name for field in fields(Task) if field.name != "name"]
    settings = named_settings("make_task", settings, known)
    return replace(_NAMED[name](), **settings)
