"""Sight: which cells are seen from which, and how the sight of a task's agents is limited."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import MAX_TABLE_CELLS, Maze, load_maze, table_of_distances
from pursuit.rules.layout import UNREACHABLE, Games
from pursuit.rules.visibility import SEES_ALL
from pursuit.validation import FrozenDict, check_bool, is_int, whole

EVERYBODY = "all"


class Limit(NamedTuple):
    """How the sight of one agent is limited.

    Attributes:
        view_radius: path steps up to which it sees; None for no such limit.
        line_of_sight: whether it sees along rows and columns only, until a wall.
        unknown_maze: whether it knows walls and cells within its view only.
    """

    view_radius: int | None = None
    line_of_sight: bool = False
    unknown_maze: bool = False

    @property
    def sees_all(self) -> bool:
        """Whether nothing is hidden from it."""
        return self.view_radius is None and not self.line_of_sight


def visible_cells(
    maze: Maze | str | Path, view_radius: int | None = None, line_of_sight: bool = False
) -> NDArray[np.bool_]:
    """[own cell, other cell] bool, a fresh array: whether the other is seen from the own one.

    Args:
        maze: of at most `pursuit.mazes.maze.MAX_TABLE_CELLS` cells, or the name of one.
        view_radius: path steps, 0 or more, up to which cells are seen; None for no such limit.
        line_of_sight: cells are seen along rows and columns only, until a wall. With a radius as
            well both must hold.

    Returns:
        A symmetric matrix, True on its diagonal: one's own cell is always seen.

    Raises:
        ValueError: a radius or a maze that is none, or a maze too large for a table of all pairs.
    """
    maze = load_maze(maze)
    radius = None if view_radius is None else whole("view_radius", view_radius)
    check_visible(maze)
    size = maze.num_cells
    seen = np.ones((size, size), dtype=bool)
    if check_bool("line_of_sight", line_of_sight):
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


def check_visible(maze: Maze) -> None:
    """ValueError for a maze that is too large for limited sight."""
    if maze.num_cells > MAX_TABLE_CELLS:
        raise ValueError(
            f"{maze.name}: {maze.num_cells} cells; limited sight needs a table of all pairs of "
            f"cells, which is built up to {MAX_TABLE_CELLS}. Take a smaller maze, or full sight"
        )


@dataclass(frozen=True, eq=False)
class Visibility:
    """Who sees what in the games of a task; `Task.sight` has it.

    Attributes:
        limits: of every seat.
        table, begin: arrays of the kernels, see `pursuit.rules.visibility`; None if no view is
            limited.
        hidden_maze: [agents] bool, who knows of the maze only what is within view.
    """

    limits: tuple[Limit, ...]
    mazes: tuple[Maze, ...]
    table: NDArray[np.bool_] | None
    begin: NDArray[np.int64] | None
    hidden_maze: NDArray[np.bool_]

    @property
    def limited(self) -> bool:
        """Whether anything can be hidden from anybody."""
        return self.table is not None

    def sees(self, seat: int, maze_number: int) -> NDArray[np.bool_]:
        """[own cell, other cell] bool, what the agent in `seat` sees in that maze; read-only."""
        size = self.mazes[maze_number].num_cells
        if self.table is None or self.begin is None or self.limits[seat].sees_all:
            seen = np.ones((size, size), dtype=bool)
        else:
            first = self.begin[seat, maze_number]
            seen = self.table[first : first + size * size].reshape(size, size)
        seen.flags.writeable = False
        return seen

    def observed_games(self, games: Games, seat: int) -> Games:
        """The games as the agent in `seat` sees them: whoever and whatever it does not is absent.

        Returns:
            Copies in which an agent out of view is not active, in cell -1 and without events, and a
            goal out of view is -1; the games themselves where it sees everything.
        """
        if self.table is None or self.begin is None or self.limits[seat].sees_all:
            return games
        own = games.position[:, seat].astype(np.int64)
        row = self.begin[seat][games.maze] + own * self.begin[-1][games.maze]
        position, active, event = games.position.copy(), games.active.copy(), games.event.copy()
        agents = ~self.table[row[:, None] + position]
        position[agents], active[agents], event[agents] = -1, 0, 0
        goal = games.goal.copy()
        goals = (goal >= 0) & ~self.table[row[:, None] + np.maximum(goal, 0)]
        goal[goals] = -1
        return games._replace(position=position, active=active, event=event, goal=goal)


@lru_cache(maxsize=64)
def visibility_of(mazes: tuple[Maze, ...], limits: tuple[Limit, ...]) -> Visibility:
    """The `Visibility` of agents with these limits in these mazes.

    Raises:
        ValueError: limited sight in a maze that is too large for a table of all pairs of cells.
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


# -- what tasks are given --------------------------------------------------------------------------

ViewRadius = int | FrozenDict[str, int | None] | None
AgentChoice = bool | tuple[str, ...]


def check_view_radius(name: str, given: Any) -> ViewRadius:
    """A view radius as a task keeps it: None, a number, or numbers by role or agent.

    Text is taken as the command line has it: "2", or "chaser=2,evader_0=none".

    Raises:
        ValueError: anything else.
    """
    if given is None or is_int(given):
        return _one_radius(name, given)
    if isinstance(given, str):
        if "=" not in given:
            return _one_radius(name, given.strip())
        text, pairs = given, [part.partition("=") for part in given.split(",")]
        given = {who.strip(): radius.strip() for who, _, radius in pairs}
        if len(given) < len(pairs):
            raise ValueError(f"{name}={text!r}; somebody is named twice: name everybody once")
        if "" in given or "" in given.values():
            raise ValueError(
                f"{name}={text!r}; each is a role or agent and its path steps, or 'none' to see "
                "everything, such as chaser=2,evader_0=3"
            )
    if not isinstance(given, Mapping) or not all(isinstance(who, str) for who in given):
        raise ValueError(
            f"{name}={given!r}; path steps such as 2, None to see everything, or either by role "
            "or agent, such as {'chaser': 2}"
        )
    by_name = {who: _one_radius(f"{name} of {who}", radius) for who, radius in given.items()}
    return FrozenDict(by_name) if by_name else None


def _one_radius(name: str, given: Any) -> int | None:
    if isinstance(given, str):
        if given.lower() in ("none", ""):
            return None
        if not given.isdecimal():
            raise ValueError(
                f"{name}={given!r}; path steps such as 2, 'none' to see everything, or either by "
                "role or agent, such as chaser=2,evader_0=3"
            )
        given = int(given)
    return None if given is None else whole(name, given)


def check_agent_choice(name: str, given: Any) -> AgentChoice:
    """Who is chosen, as a task keeps it: True for everybody, False for nobody, or sorted names.

    Text is taken as the command line has it: "all", "" for nobody, or "chaser,evader_0".

    Raises:
        ValueError: anything else.
    """
    if isinstance(given, (bool, np.bool_)):
        return bool(given)
    if isinstance(given, str):
        if given.strip() in ("", EVERYBODY):
            return given.strip() == EVERYBODY
        given = [who.strip() for who in given.split(",")]
    if not isinstance(given, Sequence) or not all(isinstance(who, str) and who for who in given):
        raise ValueError(
            f"{name}={given!r}; True for everybody, False, or roles and agents, such as "
            "('chaser', 'evader_0')"
        )
    return tuple(sorted(set(given))) or False


def view_radius_text(radius: ViewRadius) -> str | None:
    """A kept view radius as text that `check_view_radius` reads again; None for full sight."""
    if not isinstance(radius, dict):
        return None if radius is None else str(radius)
    return ",".join(
        f"{who}={'none' if steps is None else steps}" for who, steps in sorted(radius.items())
    )


def agent_choice_text(chosen: AgentChoice) -> str:
    """The text of a choice, as `check_agent_choice` reads it: "" (none), "all" or names."""
    if isinstance(chosen, bool):
        return EVERYBODY if chosen else ""
    return ",".join(chosen)


def limits_of(
    agents: Sequence[str], radius: ViewRadius, in_line: AgentChoice, unknown: AgentChoice
) -> tuple[Limit, ...]:
    """The limit of every agent; its own name goes before that of its role.

    Raises:
        ValueError: a role or agent that does not play.
    """
    known = {*agents, *(agent.split("_")[0] for agent in agents)}
    given = {"view_radius": radius, "line_of_sight": in_line, "unknown_maze": unknown}
    for name, value in given.items():
        for who in value if isinstance(value, (tuple, dict)) else ():
            if who not in known:
                raise ValueError(
                    f"{name} of {who!r}, who does not play here; one of {', '.join(sorted(known))}"
                )

    def radius_of(agent: str) -> int | None:
        if not isinstance(radius, dict):
            return radius
        return radius.get(agent, radius.get(agent.split("_")[0]))

    def chosen(agent: str, names: AgentChoice) -> bool:
        if isinstance(names, bool):
            return names
        return agent in names or agent.split("_")[0] in names

    return tuple(
        Limit(radius_of(agent), chosen(agent, in_line), chosen(agent, unknown)) for agent in agents
    )
