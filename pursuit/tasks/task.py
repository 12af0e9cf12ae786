"""The `Task` class, an immutable and validated description of a game, and the named tasks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.suites import load_mazes
from pursuit.rules import layout
from pursuit.tasks.checks import check_consistent, check_starts
from pursuit.tasks.options import (
    CAPTURE_CHECKS,
    CAPTURES,
    COLLISIONS,
    Slip,
    check_exits,
    check_options,
    check_slip,
    options_of,
    slips_of,
)
from pursuit.tasks.options import MOVE_ORDERS as MOVE_ORDERS
from pursuit.tasks.placements import StartConstraint
from pursuit.tasks.pursuit_v5 import PursuitV5Rewards
from pursuit.tasks.rewards import REWARD_SCHEMES as REWARD_SCHEMES
from pursuit.tasks.rewards import REWARDS, RewardFunction, check_rewards
from pursuit.tasks.rewards import ROLES as ROLES
from pursuit.tasks.rewards import Rewards as Rewards
from pursuit.tasks.visibility import (
    AgentChoice,
    Limit,
    ViewRadius,
    Visibility,
    check_agent_choice,
    check_view_radius,
    check_visible,
    view_limits_of,
    visibility_of,
)
from pursuit.validation import (
    Flag,
    FrozenDict,
    Rule,
    Whole,
    WholeFrom1,
    check,
    check_fields,
    choice,
    is_int,
    named_settings,
    one_of,
    unknown,
    whole,
)

ACTIONS = ("north", "south", "east", "west", "stay")
"""The actions on a grid; in a graph, moves have numbers."""
STARTS = ("random", "marks")
Agents = Annotated[AgentChoice | Sequence[str] | str, Rule(check_agent_choice)]


def _checked_mazes(name: str, given: Any) -> Any:
    """One maze unchanged; several as a tuple, so that later changes of a list have no effect."""
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


def _checked_name(name: str, value: Any) -> Any:
    """`value` if it is a string; ValueError otherwise."""
    check(isinstance(value, str), f"{name}={value!r}; give a string")
    return value


@dataclass(frozen=True)
class Task:
    """Rules and settings of one game. Immutable, hashable, and validated when it is created.

    Args:
        maze: the name of a shipped maze, a path, a `Maze`, a suite ("suite:7x7-train"), or a list
            of these. Of several mazes, each game draws one at every reset.
        num_chasers, num_evaders, num_runners: the number of agents of each role.
        num_goals: the number of goals. Runners and evaders collect them.
        max_steps: an episode is truncated after this many steps.
        stay_action: whether there is an action 4, stay (of a graph the last action).
        move_order: "simultaneous"; "chasers_first": the chasers move and captures are resolved,
            then all other agents move and captures are resolved again; or "turns": as that, but
            each side sees the other's move. A step is then the move of one side, the chasers first,
            and the actions of the other side are ignored. Two steps are a round: `max_steps` counts
            rounds, and step rewards are paid at the end of each. Needs `stay_action`.
        start: "random": each agent and goal on a different, uniformly random cell. "marks": the
            first agent on `S`, the goals (or the evaders, if there are no goals) on the `G` marks
            in order, all others at random.
        min_start_distance: the least path distance between any chaser and any evader at the start
            (infinite without a connecting path). Only for tasks with both roles.
        capture: where chasers must be to capture an evader: "cell", in its cell (or swapping cells
            with it, if both move at once); "adjacent", at a path distance of at most 1; "surround",
            on every cell that a move of the evader leads to (an enclosed evader is never captured).
        n_catch: the number of chasers that a capture needs, with "cell" and "adjacent".
        capture_check: "each_move", or "after_chasers": captures are resolved only after the
            chasers' moves, if these come first.
        exits: the cells of exits, for all mazes; None for the marks `E` of each maze. An evader
            that stands on an exit and is not captured leaves the game.
        num_exits: the number of exits that are drawn at every reset, instead of fixed ones.
        collisions: "share": agents can share cells. "block": agents of one role cannot, nor can
            chasers and evaders unless captures are by "cell". A move is cancelled if such an agent
            was in the target, or moves to it.
        slip: the probability that a move, stay included, is replaced by a uniformly random one of
            the moves that change the cell: a number, a dict from roles or agents, or the same as
            text ("evader=0.1").
        rewards: a name ("goal", "completion", "distance", "zero_sum", "win_loss", "pursuit_v5", or
            "pursuit_v5_local" without sharing); a dict from role to `Rewards` (roles left out use
            "goal"); the same as text ("chaser.step=-0.1,evader.capture=-2"; without a role for all
            roles); or a custom function or its name "package.module:Name" (see
            `pursuit.tasks.rewards.RewardFunction`).
        view_radius: the path distance up to which an agent sees: None (no limit), a number, a dict
            ({"chaser": 2, "evader_0": None}; an agent's entry overrides its role's), or the same as
            text ("chaser=2,evader_0=3"). What is out of view is absent from the observation.
        line_of_sight: the agents that see only along their row and column, up to the next wall
            (and up to `view_radius`): True for all, a list of roles or agents, or the same as text
            ("chaser").
        unknown_maze: the agents that observe only the part of the maze within view; same form as
            `line_of_sight`.
        name: the name of the task in results.

    Raises:
        ValueError: an invalid setting, or settings that contradict each other.
    """

    maze: Annotated[str | Path | Maze | Sequence[str | Path | Maze], Rule(_checked_mazes)] = "5x5"
    num_chasers: Whole = 0
    num_evaders: Whole = 0
    num_runners: Whole = 0
    num_goals: Whole = 0
    max_steps: WholeFrom1 = 200
    stay_action: Flag = False
    move_order: Annotated[str, choice(*MOVE_ORDERS)] = "simultaneous"
    start: Annotated[str, choice(*STARTS)] = "random"
    min_start_distance: WholeFrom1 = 1
    capture: Annotated[str, choice(*CAPTURES)] = "cell"
    n_catch: WholeFrom1 = 1
    capture_check: Annotated[str, choice(*CAPTURE_CHECKS)] = "each_move"
    exits: Annotated[Sequence[int] | str | None, Rule(check_exits)] = None
    num_exits: Whole = 0
    collisions: Annotated[str, choice(*COLLISIONS)] = "share"
    slip: Annotated[Slip, Rule(check_slip)] = 0.0
    rewards: Annotated[str | Mapping[str, Rewards] | RewardFunction, Rule(check_rewards)] = "goal"
    view_radius: Annotated[ViewRadius | Mapping[str, int | None] | str, Rule(check_view_radius)] = (
        None
    )
    line_of_sight: Agents = False
    unknown_maze: Agents = False
    name: Annotated[str, Rule(_checked_name)] = "custom"

    def __post_init__(self) -> None:
        check_fields(self)
        check_consistent(self)
        check_options(self)
        check_starts(self)
        if not all(limit.sees_all for limit in self._limits):
            for maze in self.mazes:
                check_visible(maze, any(limit.line_of_sight for limit in self._limits))

    def apart(self, maze: int, num_goals: int, least: int, most: int) -> StartConstraint:
        """The constraint on start placements in the maze with index `maze`.

        `num_goals` -1 means all goals. `least` and `most` are path distances; -1 means no limit.
        """
        teams, marked = self.teams, self.start == "marks"
        goals = teams.goals if num_goals < 0 else min(teams.goals, num_goals)
        exits = self.fixed_exits[maze]
        marks = goals if marked else 0
        return StartConstraint(self.mazes[maze], teams, marked, marks, least, most, exits)

    @cached_property
    def mazes(self) -> tuple[Maze, ...]:
        """The mazes of this task."""
        return load_mazes(self.maze)

    @cached_property
    def role_rewards(self) -> dict[str, Rewards]:
        """Immutable dict from role to `Rewards`; the scheme "goal" with a reward function."""
        own = REWARDS.resolved(self.rewards)
        return FrozenDict({**REWARD_SCHEMES["goal"], **(own if isinstance(own, Mapping) else {})})

    @cached_property
    def reward_function(self) -> RewardFunction | None:
        """The custom reward function that replaces `role_rewards`, or None."""
        own = REWARDS.resolved(self.rewards)
        if isinstance(own, PursuitV5Rewards):
            return own.for_mazes(self.mazes)
        return None if isinstance(own, Mapping) else own

    @cached_property
    def slips(self) -> tuple[float, ...]:
        """The probability of a slip of each agent, by index."""
        slip: Any = self.slip
        return slips_of(slip, self.agent_names, self.seat_roles)

    @cached_property
    def fixed_exits(self) -> tuple[tuple[int, ...], ...]:
        """The fixed exits of each maze; empty if there are none, or if they are drawn."""
        if self.num_exits or not self.num_evaders:
            return ((),) * len(self.mazes)
        given: Any = self.exits  # checked, no text
        return tuple(maze.exit_marks if given is None else given for maze in self.mazes)

    @cached_property
    def options(self) -> layout.Options:
        """The options of the rules, as used by `pursuit.rules`; `layout.PLAIN` without any."""
        return options_of(self)

    @property
    def most_exits(self) -> int:
        """The number of exits of a game, or of the maze with most of them."""
        return self.options.exits

    @cached_property
    def _limits(self) -> tuple[Limit, ...]:
        checked: Any = (self.view_radius, self.line_of_sight, self.unknown_maze)
        return view_limits_of(self.agent_names, *checked)

    @cached_property
    def sight(self) -> Visibility:
        """What each agent sees; its tables are computed on first use."""
        return visibility_of(self.mazes, self._limits)

    def sees(self, seat: str | int, maze_number: int = 0) -> NDArray[np.bool_]:
        """[own cell, other cell] bool, read-only: the cells visible to an agent from each cell.

        Raises:
            ValueError: no such agent, or no such maze.
        """
        maze_number = whole("maze_number", maze_number, 0, len(self.mazes) - 1)
        return self.sight.sees(self.seat(seat), maze_number)

    def hides_from(self, seat: str | int) -> bool:
        """Whether anything can be out of an agent's view; False if its view covers all cells.

        Raises:
            ValueError: no such agent.
        """
        if self.sight.limits[self.seat(seat)].sees_all:
            return False
        return not all(self.sees(seat, number).all() for number in range(len(self.mazes)))

    @property
    def steps_per_round(self) -> int:
        """2 in turns, else 1: `max_steps`, discounts and lengths in results count rounds."""
        return 2 if self.options.turns else 1

    @property
    def num_agents(self) -> int:
        """Chasers plus evaders plus runners."""
        return self.num_chasers + self.num_evaders + self.num_runners

    @property
    def num_actions(self) -> int:
        """The number of moves of the mazes, 4 unless they are graphs; with stay one more."""
        return self.num_moves + self.stay_action

    @property
    def num_moves(self) -> int:
        """The number of moves of the mazes, `Maze.num_moves`."""
        return self.mazes[0].num_moves

    @cached_property
    def max_cells(self) -> int:
        """The number of cells of the largest maze."""
        return max(maze.num_cells for maze in self.mazes)

    @cached_property
    def agent_names(self) -> tuple[str, ...]:
        """`("chaser_0", ..., "evader_0", ..., "runner_0", ...)`: the name of each agent."""
        return tuple(f"{role}_{i}" for role in ROLES for i in range(self.count(role)))

    @cached_property
    def seat_roles(self) -> tuple[str, ...]:
        """The role of each agent."""
        return tuple(name.split("_")[0] for name in self.agent_names)

    def count(self, role: str) -> int:
        """The number of agents of `role`."""
        one_of("role", role, ROLES)
        return int(getattr(self, f"num_{role}s"))

    def seat(self, agent: str | int) -> int:
        """The index of an agent given by name, by role (the first agent of it) or by index."""
        if isinstance(agent, str):
            names = self.agent_names
            if agent in self.seat_roles:
                return self.seat_roles.index(agent)
            if agent not in names:
                raise ValueError(unknown("agent", agent, dict.fromkeys((*self.seat_roles, *names))))
            return names.index(agent)
        if not is_int(agent) or not 0 <= agent < self.num_agents:
            raise ValueError(f"agent index {agent!r}; this task has 0 to {self.num_agents - 1}")
        return int(agent)

    @property
    def is_duel(self) -> bool:
        """Whether there is one chaser, one evader, no goal and no option of the rules; such games
        are solved as tables over both cells."""
        return tuple(self.teams) == (1, 1, 0, 0) and self.options == layout.PLAIN

    @property
    def teams(self) -> layout.Teams:
        """The numbers of agents and goals, as used by `pursuit.rules`."""
        return layout.Teams(self.num_chasers, self.num_evaders, self.num_runners, self.num_goals)

    def numbers_for_kernels(self) -> NDArray[np.int64]:
        """The argument `numbers` of `layout.rules_of`."""
        first, marks = self.move_order != "simultaneous", self.start == "marks"
        rules = (self.max_steps, self.num_actions, first, marks)
        exits: list[int] = []
        if any(self.fixed_exits):
            for cells in self.fixed_exits:
                exits += [*cells, *[-1] * (self.most_exits - len(cells))]
        return layout.numbers_of(self.teams, *rules, self.options, exits)

    def rewards_for_kernels(self) -> NDArray[np.float64]:
        """[roles, fields of `RewardCoefficients`] float64, the argument of `layout.rules_of`."""
        rewards = [self.role_rewards[role] for role in ROLES]
        names = layout.RewardCoefficients._fields
        return np.array([[getattr(each, name) for name in names] for each in rewards], np.float64)


def checked_task(task: Any) -> Task:
    """`task`, if it is one; ValueError otherwise."""
    if not isinstance(task, Task):
        raise ValueError(f"task={task!r}; give a Task, such as pursuit.make_task('chase')")
    return task


HEIST_REWARDS = {"evader": Rewards(step=-0.1, capture=-1.0, goal=1.0)}
"""The step reward is negative: an evader rewarded for surviving has no reason to collect goals."""

_NAMED: dict[str, dict[str, Any]] = {
    "chase": {"num_chasers": 1, "num_evaders": 1},
    "maze": {"num_runners": 1, "num_goals": 3},
    "race": {"num_runners": 2, "num_goals": 3},
    "heist": {"num_chasers": 1, "num_evaders": 1, "num_goals": 3, "rewards": HEIST_REWARDS},
    "escape": {"num_chasers": 1, "num_evaders": 1, "rewards": "win_loss"},
}
TASK_NAMES = tuple(_NAMED)
NUM_EXITS = 2
"""The exits that are drawn in the task "escape", if neither these nor the maze has any."""


def make_task(name: str, **settings: Any) -> Task:
    """The named task ("chase", "maze", "race", "heist" or "escape") with `settings` changed.

    `max_cycles`, PettingZoo's name, is accepted for `max_steps`.

    Raises:
        ValueError: an unknown name or invalid settings.
        TypeError: an unknown setting.
    """
    one_of("task", name, TASK_NAMES)
    known = [field.name for field in fields(Task) if field.name != "name"]
    settings = named_settings("make_task", settings, known)
    settings = {**_NAMED[name], "name": name, **settings}
    without = not settings.get("num_exits") and settings.get("exits") is None
    if name == "escape" and without:
        marks = [maze.exit_marks for maze in load_mazes(settings.get("maze", Task.maze))]
        settings["num_exits"] = 0 if any(marks) else NUM_EXITS
    return Task(**settings)
