"""The `Policy` protocol, and `GameView`, the argument of policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import MazeArrays
from pursuit.rules import layout
from pursuit.rules.layout import Games
from pursuit.rules.randomness import draw_uniform
from pursuit.tasks.task import ROLES, Task


class GameArrays:
    """The arrays of a batch of games (`games`) under their public names."""

    games: Games

    @property
    def positions(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, cells; captured evaders stay in the cell of capture."""
        return self.games.position

    @property
    def active(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, 0 for captured evaders."""
        return self.games.active

    @property
    def events(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, the events of the last step: a sum of `rules.COLLECTED`,
        `CAPTURED` and `WAS_CAPTURED`."""
        return self.games.event

    @property
    def goals(self) -> NDArray[np.int32]:
        """[num_games, num_goals] int32, the cell of every goal; -1 when gone."""
        return self.games.goal

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps taken in the episode."""
        return self.games.steps

    @property
    def maze_index(self) -> NDArray[np.int32]:
        """[num_games] int32, which of `task.mazes` each game plays in."""
        return self.games.maze


@dataclass(frozen=True, eq=False)
class GameView(GameArrays):
    """A batch of games as seen by one agent: live arrays of the `Simulator`, not copies.

    Attributes:
        task: the rules and settings.
        seat: the index of the agent.
        games: the arrays of the games under the names of the rule book.
        streams: [num_games, ...] uint64, the random streams; a policy draws from its own only.
        epsilon: [num_games, num_agents] float64, the probability of a random move; NaN if the
            policy's own epsilon applies.
        mazes: the arrays of the mazes.
        observe: `observe(encoding)` -> [num_games, ...] what the agent in this seat observes.
        whole: of a view that `select` made, the view of all games of the batch; None otherwise.
        chosen: [num_games], which of those games these are; None where they are all.
    """

    task: Task
    seat: int
    games: Games
    streams: NDArray[np.uint64]
    epsilon: NDArray[np.float64]
    mazes: MazeArrays
    observe: Callable[[str], NDArray[Any]]
    whole: GameView | None = None
    chosen: NDArray[np.intp] | None = None

    @property
    def num_games(self) -> int:
        """Games in the batch."""
        return len(self.games.steps)

    def select(self, games: NDArray[np.intp]) -> GameView:
        """Copies of these games as a view of their own.

        After a policy has drawn random numbers from it, copy the streams back:
        `view.streams[games] = part.streams`.
        """
        return replace(
            self,
            games=Games(*(array[games] for array in self.games)),
            streams=self.streams[games],
            epsilon=self.epsilon[games],
            observe=lambda encoding: self.observe(encoding)[games],
            whole=self.whole or self,
            chosen=games if self.chosen is None else self.chosen[games],
        )

    @property
    def rows(self) -> NDArray[np.intp]:
        """[num_games], the numbers of these games in the batch: the rows of a `Memory`."""
        return np.arange(self.num_games) if self.chosen is None else self.chosen

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from the agent's own random stream, which advances."""
        numbers = np.empty(self.num_games)
        draw_uniform(self.streams, layout.named(layout.stream_of, self.seat), numbers)
        return numbers


def pairs_of_cells(task: Task, maze: Maze, agent: str | int) -> Games:
    """Games of a duel that were never played: one for each pair of cells of `maze`.

    Game `own * num_cells + other` has `agent` in cell `own` and its opponent in cell `other`, both
    active, and nothing else has happened. For policies that are functions of these two cells.

    Raises:
        ValueError: the task is no duel, or is not played in this maze.
    """
    if not task.is_duel or maze not in task.mazes:
        raise ValueError(f"task {task.name!r} is no duel in maze {maze.name}")
    size, seat = maze.num_cells, task.seat(agent)
    games = layout.empty_games(size * size, task.num_agents, task.num_goals)
    own, other = np.divmod(np.arange(size * size, dtype=np.int32), size)
    games.position[:, seat], games.position[:, 1 - seat] = own, other
    games.active[:] = 1
    games.maze[:] = task.mazes.index(maze)
    return games


class Policy(Protocol):
    """Chooses the actions of an agent: scripted, exact or learned.

    A policy of several agents can also have `act_together(view, seats, actions)`, which is called
    once for all of them (see `play_all`); `view` is that of the first.
    """

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game.

        Draw random numbers from `view.uniform()` (or the seat's stream) only, so that a game does
        not depend on the batch that it is in.
        """
        ...


def role_of(policy: object) -> str | None:
    """The role of a policy ("chaser", "evader" or "runner"), or None."""
    role = getattr(policy, "role", None) or getattr(policy, "agent", None)
    return None if role is None else str(role).split("_")[0]


def check_plays(policy: Any, task: Task, seat: int) -> None:
    """ValueError unless this is a policy, and of the role of a seat where it has one.

    A runner's policy may play an evader that collects goals.
    """
    if not callable(getattr(policy, "act", None)):
        raise ValueError(
            f"the policy of {task.agent_names[seat]} is {policy!r}; a policy has a method `act`"
        )
    role, needed = role_of(policy), task.seat_roles[seat]
    collects = role == "runner" and needed == "evader" and task.num_goals > 0
    if role in ROLES and role != needed and not collects:
        raise ValueError(
            f"{policy!r} is a policy of the {role}; the seat of {task.agent_names[seat]} takes one "
            f"of the {needed}"
        )


def seat_policies(task: Task, policies: Any) -> list[Policy | None]:
    """The policy of every seat, None where there is none.

    Args:
        task: the game.
        policies: by agent name, or by role for all agents of that role; a name goes first.

    Raises:
        ValueError: a policy of another role, or one for an agent that does not exist.
    """
    if not isinstance(policies, Mapping):
        raise ValueError(f"policies={policies!r}; give a dict, policies by agent or role")
    for name in policies:
        if name not in (*task.agent_names, *task.seat_roles):
            raise ValueError(
                f"a policy for {name!r}; this task has {', '.join(task.agent_names)} (or give a "
                f"role: {', '.join(sorted(set(task.seat_roles)))})"
            )
    named = zip(task.agent_names, task.seat_roles, strict=True)
    filled = [policies.get(name, policies.get(role)) for name, role in named]
    for seat, policy in enumerate(filled):
        if policy is not None:
            check_plays(policy, task, seat)
    return filled


class Memory:
    """The memory of a policy: arrays for each batch and agent that it plays.

    They are created on first use and deleted with the batch, so one policy can play several agents
    and batches. A copy of a policy starts with empty memory.

    Args:
        make: the arrays of a view, [num_games, ...] each, by name, at the start of an episode.
    """

    def __init__(self, make: Callable[[GameView], dict[str, NDArray[Any]]]) -> None:
        self._make = make
        self._kept: WeakKeyDictionary[GameView, dict[str, NDArray[Any]]] = WeakKeyDictionary()

    def of(self, view: GameView) -> dict[str, NDArray[Any]]:
        """The live arrays of the whole batch; those of the games of `view` are its `view.rows`."""
        whole = view.whole or view
        if whole not in self._kept:
            self._kept[whole] = self._make(whole)
        return self._kept[whole]

    def __reduce__(self) -> tuple[Any, ...]:
        return Memory, (self._make,)


@runtime_checkable
class MemoryPolicy(Protocol):
    """A policy with memory: its actions depend on earlier steps of the episode.

    Call `play`, which begins new episodes, rather than its `act`; the `Simulator` and the
    environments do. It acts once in every step, in all games of the view, or of a part of them.

    Attributes:
        memory: its memory, for saving games within an episode.
    """

    memory: Memory

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Forget all of these games of `view` (numbers [n] in it): their episodes begin now."""
        ...

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, as of any `Policy`."""
        ...


def play(policy: Policy, view: GameView) -> NDArray[np.int32]:
    """[num_games] int32: the actions of a policy; its memory is reset in new episodes.

    An episode is new where no step of it has been taken.
    """
    begin = getattr(policy, "begin", None)  # the protocol's isinstance takes as long as 20 steps
    if begin is not None:
        fresh = np.flatnonzero(view.steps == 0)
        if len(fresh):
            begin(view, fresh)
    return policy.act(view)


def play_all(
    policies: Sequence[Policy | None],
    actions: NDArray[np.int32],
    shape: tuple[int, int],
    view: Callable[[int], GameView],
) -> None:
    """Write the action of every seat that has a policy into `actions` [games, agents] = `shape`.

    A policy without memory that has `act_together(view, seats, actions)` is called once for all its
    seats; it writes what its `act` would do in each of them.

    Raises:
        ValueError: a wrong shape, another number of seats, or a policy that is none or of another
            role.
    """
    try:
        fit = actions.shape == shape and len(policies) == shape[1]
    except (AttributeError, TypeError):
        fit = False
    if not fit:
        needed = f"a policy or None a seat, actions of shape {shape}"
        raise ValueError(f"policies={policies!r}, actions={actions!r}; {needed}")
    together: dict[int, list[int]] = {}
    for seat, policy in enumerate(policies):
        if policy is None:
            continue
        check_plays(policy, view(seat).task, seat)
        if getattr(policy, "act_together", None) is None or hasattr(policy, "begin"):
            actions[:, seat] = play(policy, view(seat))
        else:
            together.setdefault(id(policy), []).append(seat)
    for seats in together.values():
        player: Any = policies[seats[0]]
        player.act_together(view(seats[0]), tuple(seats), actions)


@runtime_checkable
class TabularPolicy(Protocol):
    """A policy that is a function of (own cell, other cell) in games of one against one."""

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, the exact distribution over actions."""
        ...


@runtime_checkable
class DistributionPolicy(Protocol):
    """A policy that draws from a distribution known for any state of the games of a task.

    A team that draws its actions together has `joint_distribution(task, games)` besides: [games,
    joint actions] float64, the last member's action counting fastest.
    """

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, what it plays in `seat` of these games, played or not.

        Raises:
            ValueError: games for which it knows no distribution.
        """
