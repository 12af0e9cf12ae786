"""Which cells are visible from which, and the limited views of the agents of a task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze, table_of_distances
from pursuit.rules.layout import UNREACHABLE, Games, copied_games
from pursuit.rules.visibility import SEES_ALL
from pursuit.validation import FrozenDict, check, check_bool, is_int, whole
from pursuit.validation import unknown as unknown_name

ALL_AGENTS = "all"


class Limit(NamedTuple):
    """The limited view of one agent.

    Attributes:
        view_radius: the path distance up to which it sees; None for no limit.
        line_of_sight: whether it sees only along rows and columns, up to the next wall.
        unknown_maze: whether it observes only the walls and cells within its view.
    """

    view_radius: int | None = None
    line_of_sight: bool = False
    unknown_maze: bool = False

    @property
    def sees_all(self) -> bool:
        """Whether its view is not limited."""
        return self.view_radius is None and not self.line_of_sight


def visible_cells(
    maze: Maze | str | Path, view_radius: int | None = None, line_of_sight: bool = False
) -> NDArray[np.bool_]:
    """[own cell, other cell] bool, a new array: whether the other cell is visible from the own one.

    Args:
        maze: a maze of at most `pursuit.mazes.maze.MAX_TABLE_CELLS` cells, or its name.
        view_radius: the path distance, 0 or more, up to which cells are visible; None for no limit.
        line_of_sight: whether cells are visible only along rows and columns, up to the next wall.
            With a radius, both conditions must hold.

    Returns:
        A matrix, symmetric unless a graph is directed; its diagonal is True, as the own cell is
        always visible.

    Raises:
        ValueError: an invalid radius or maze, a maze too large for a table of all pairs, or a line
            of sight in a graph.
    """
    maze = load_maze(maze)
    radius = None if view_radius is None else whole("view_radius", view_radius)
    check_visible(maze, check_bool("line_of_sight", line_of_sight))
    size = maze.num_cells
    seen = np.ones((size, size), dtype=bool)
    if line_of_sight:
        seen = np.eye(size, dtype=bool)
        for action in range(4):
            own, at = np.arange(size), np.arange(size)
            while len(own):
                after = maze.neighbors[at, action]
                free = after != at
                own, at = own[free], after[free]
                seen[own, at] = True
    if radius is not None:
        distances = table_of_distances(maze)
        seen &= (distances <= radius) & (distances != UNREACHABLE)
    return seen


def check_visible(maze: Maze, line_of_sight: bool = False) -> None:
    """ValueError if a maze is too large for limited views, or is a graph without lines of sight."""
    check(
        maze.is_grid or not line_of_sight,
        f"line_of_sight: {maze.name} is a graph, without rows and columns to look along; use "
        "view_radius",
    )
    check(
        maze.num_cells <= MAX_TABLE_CELLS,
        f"{maze.name}: {maze.num_cells} cells; a limited view needs a table of all pairs of cells, "
        f"at most {MAX_TABLE_CELLS}. Use a smaller maze, or no limit",
    )


@dataclass(frozen=True, eq=False)
class Visibility:
    """The views of all agents of a task (`Task.sight`).

    Attributes:
        limits: the limit of each agent.
        table, begin: arrays of the kernels, see `pursuit.rules.visibility`; None if no view is
            limited.
        hidden_maze: [agents] bool, whether the agent observes only the part of the maze in view.
    """

    limits: tuple[Limit, ...]
    mazes: tuple[Maze, ...]
    table: NDArray[np.bool_] | None
    begin: NDArray[np.int64] | None
    hidden_maze: NDArray[np.bool_]

    @property
    def limited(self) -> bool:
        """Whether the view of any agent is limited."""
        return self.table is not None

    def sees(self, seat: int, maze_number: int) -> NDArray[np.bool_]:
        """[own cell, other cell] bool, read-only: what the agent with index `seat` sees."""
        size = self.mazes[maze_number].num_cells
        if self.table is None or self.begin is None or self.limits[seat].sees_all:
            seen = np.ones((size, size), dtype=bool)
        else:
            first = self.begin[seat, maze_number]
            seen = self.table[first : first + size * size].reshape(size, size)
        seen.flags.writeable = False
        return seen

    def observed_games(self, games: Games, seat: int) -> Games:
        """The games as the agent with index `seat` sees them.

        Returns:
            Copies in which an agent out of view is not active, in cell -1 and without events, and a
            goal or exit out of view is -1; the games themselves if the view is not limited.
        """
        if self.table is None or self.begin is None or self.limits[seat].sees_all:
            return games
        own = games.position[:, seat].astype(np.int64)
        row = self.begin[seat][games.maze] + own * self.begin[-1][games.maze]
        seen = copied_games(games, slice(None))
        position, active, event = seen.position, seen.active, seen.event
        agents = ~self.table[row[:, None] + position]
        position[agents], active[agents], event[agents] = -1, 0, 0
        for places in (seen.goal, seen.exit):
            hidden = (places >= 0) & ~self.table[row[:, None] + np.maximum(places, 0)]
            places[hidden] = -1
        return seen


@lru_cache(maxsize=64)
def visibility_of(mazes: tuple[Maze, ...], limits: tuple[Limit, ...]) -> Visibility:
    """The `Visibility` of agents with these limits in these mazes.

    Raises:
        ValueError: a limited view in a maze that is too large for a table of all pairs of cells.
    """
    hidden = np.array([not of.sees_all and of.unknown_maze for of in limits], dtype=bool)
    kinds = list(dict.fromkeys(of[:2] for of in limits if not of.sees_all))
    if not kinds:
        return Visibility(limits, mazes, None, None, hidden)
    begin = np.full((len(limits) + 1, len(mazes)), SEES_ALL, dtype=np.int64)
    begin[-1] = [maze.num_cells for maze in mazes]
    parts: list[NDArray[np.bool_]] = []
    length = 0
    for kind in kinds:
        for number, maze in enumerate(mazes):
            for seat, of in enumerate(limits):
                if of[:2] == kind:
                    begin[seat, number] = length
            parts.append(visible_cells(maze, *kind).ravel())
            length += len(parts[-1])
    table = np.concatenate(parts)
    return Visibility(limits, mazes, table, begin, hidden)


# -- settings of tasks -----------------------------------------------------------------------------

ViewRadius = int | FrozenDict[str, int | None] | None
AgentChoice = bool | tuple[str, ...]


def check_view_radius(name: str, given: Any) -> ViewRadius:
    """The value of `Task.view_radius`: None, a number, or a dict from role or agent to these.

    Text has the form of the command line: "2", or "chaser=2,evader_0=none".

    Raises:
        ValueError: anything else.
    """
    if given is None or is_int(given):
        return _one_radius(name, given)
    if isinstance(given, str):
        if "=" not in given:
            return _one_radius(name, given.strip())
        text, pairs = given, [part.partition("=") for part in given.split(",")]
        given = {agent.strip(): radius.strip() for agent, _, radius in pairs}
        if len(given) < len(pairs):
            raise ValueError(f"{name}={text!r}; an agent is given twice; give it once")
        if "" in given or "" in given.values():
            raise ValueError(
                f"{name}={text!r}; give a role or agent and a path distance, or 'none' for no "
                "limit, such as chaser=2,evader_0=3"
            )
    if not isinstance(given, Mapping) or not all(isinstance(agent, str) for agent in given):
        raise ValueError(
            f"{name}={given!r}; give a path distance such as 2, None for no limit, or either by "
            "role or agent, such as {'chaser': 2}"
        )
    by_name = {agent: _one_radius(f"{name} of {agent}", steps) for agent, steps in given.items()}
    return FrozenDict(by_name) if by_name else None


def _one_radius(name: str, given: Any) -> int | None:
    if isinstance(given, str):
        if given.lower() in ("none", ""):
            return None
        if not given.isdecimal():
            raise ValueError(
                f"{name}={given!r}; give a path distance such as 2, 'none' for no limit, or either "
                "by role or agent, such as chaser=2,evader_0=3"
            )
        given = int(given)
    return None if given is None else whole(name, given)


def check_agent_choice(name: str, given: Any) -> AgentChoice:
    """A choice of agents as a task keeps it: True for all, False for none, or sorted names.

    Text has the form of the command line: "all", "" for none, or "chaser,evader_0".

    Raises:
        ValueError: anything else.
    """
    if isinstance(given, (bool, np.bool_)):
        return bool(given)
    if isinstance(given, str):
        if given.strip() in ("", ALL_AGENTS):
            return given.strip() == ALL_AGENTS
        given = [agent.strip() for agent in given.split(",")]
    if not isinstance(given, Sequence) or not all(isinstance(each, str) and each for each in given):
        raise ValueError(
            f"{name}={given!r}; give True for all, False for none, or roles and agents, such as "
            "('chaser', 'evader_0')"
        )
    return tuple(sorted(set(given))) or False


def view_radius_text(radius: ViewRadius) -> str | None:
    """A view radius as text, as `check_view_radius` reads it; None for no limit."""
    if not isinstance(radius, dict):
        return None if radius is None else str(radius)
    return ",".join(
        f"{agent}={'none' if steps is None else steps}" for agent, steps in sorted(radius.items())
    )


def agent_choice_text(chosen: AgentChoice) -> str:
    """The text of a choice, as `check_agent_choice` reads it: "" (none), "all" or names."""
    if isinstance(chosen, bool):
        return ALL_AGENTS if chosen else ""
    return ",".join(chosen)


def view_limits_of(
    agents: Sequence[str], radius: ViewRadius, in_line: AgentChoice, unknown: AgentChoice
) -> tuple[Limit, ...]:
    """The limit of every agent; the entry of an agent overrides that of its role.

    Raises:
        ValueError: an unknown role or agent.
    """
    known = {*agents, *(agent.split("_")[0] for agent in agents)}
    given = {"view_radius": radius, "line_of_sight": in_line, "unknown_maze": unknown}
    for name, value in given.items():
        for agent in value if isinstance(value, (tuple, dict)) else ():
            if agent not in known:
                raise ValueError(f"{name} of " + unknown_name("agent", agent, sorted(known)))

    def limit_of(agent: str, role: str) -> Limit:
        own = radius.get(agent, radius.get(role)) if isinstance(radius, dict) else radius
        chosen = (
            names if isinstance(names, bool) else agent in names or role in names
            for names in (in_line, unknown)
        )
        return Limit(own, *chosen)

    return tuple(limit_of(agent, agent.split("_")[0]) for agent in agents)
