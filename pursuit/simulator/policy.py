"""The `Policy` protocol, and `GameView`, the argument of policies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.rules import layout
from pursuit.rules.arrays import Array
from pursuit.rules.layout import Games, World
from pursuit.rules.randomness import uniform_numbers
from pursuit.tasks.task import ROLES, Task
from pursuit.validation import shortened


class GameArrays:
    """The arrays of a batch of games (`games`) under their public names."""

    games: Games

    @property
    def positions(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, cells; captured evaders stay in the cell of capture."""
        return self.games.position

    @property
    def active(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, 0 for evaders that were captured or have escaped."""
        return self.games.active

    @property
    def events(self) -> NDArray[np.int32]:
        """[num_games, num_agents] int32, the events of the last step: a sum of COLLECTED,
        CAPTURED, WAS_CAPTURED and ESCAPED of `pursuit.rules.layout`."""
        return self.games.event

    @property
    def goals(self) -> NDArray[np.int32]:
        """[num_games, num_goals] int32, the cell of every goal; -1 after collection."""
        return self.games.goal

    @property
    def steps(self) -> NDArray[np.int32]:
        """[num_games] int32, steps of the episode so far; two for each round of turns."""
        return self.games.steps

    @property
    def maze_index(self) -> NDArray[np.int32]:
        """[num_games] int32, the index of the maze of each game in `task.mazes`."""
        return self.games.maze

    @property
    def exits(self) -> NDArray[np.int32]:
        """[num_games, exits] int32, the cell of every exit; -1 for absent ones."""
        return self.games.exit


@dataclass(frozen=True, eq=False)
class GameView(GameArrays):
    """A batch of games as seen by one agent: live arrays of the `Simulator`, not copies.

    Attributes:
        task: the task.
        seat: the index of the agent.
        games: the arrays of the games under the names that kernels use.
        streams: [num_games, ...] uint64, the random streams; a policy draws from its stream only.
        epsilon: [num_games, num_agents] float64, the probability of a random move; NaN if the
            policy's own epsilon applies.
        mazes: the arrays of the mazes.
        observe: `observe(encoding, dtype=None)` -> [num_games, ...], the observations of the agent;
            `dtype` is that of `pursuit.observations.observations.Encoder`.
        whole: the view of the whole batch, for a view made by `select`; None otherwise.
        chosen: [num_games], the indices of these games in the batch; None for all games.
    """

    task: Task
    seat: int
    games: Games
    streams: NDArray[np.uint64]
    epsilon: NDArray[np.float64]
    mazes: World
    observe: Callable[..., Array]
    whole: GameView | None = None
    chosen: NDArray[np.intp] | None = None

    @property
    def num_games(self) -> int:
        """Number of games in the batch."""
        return len(self.games.steps)

    def select(self, games: NDArray[np.intp]) -> GameView:
        """A view of copies of these games.

        After a policy has drawn random numbers from it, copy the streams back:
        `view.streams[games] = part.streams`.
        """
        return replace(
            self,
            games=layout.copied_games(self.games, games),
            streams=self.streams[games],
            epsilon=self.epsilon[games],
            observe=lambda *form: self.observe(*form)[games],
            whole=self.whole or self,
            chosen=games if self.chosen is None else self.chosen[games],
        )

    @property
    def rows(self) -> NDArray[np.intp]:
        """[num_games], the indices of these games in the batch: the rows of a `Memory`."""
        return np.arange(self.num_games) if self.chosen is None else self.chosen

    def table_rows_of(self, games: NDArray[np.intp] | slice) -> NDArray[np.int64]:
        """[n] int64: the pairs of cells of some games of a duel, numbered as by `pairs_of_cells`,
        which are the rows of tables of policies."""
        cells = self.positions[games]
        pairs = cells[:, self.seat] * np.int64(self.task.mazes[0].num_cells)
        return pairs + cells[:, 1 - self.seat]

    def uniform(self) -> NDArray[np.float64]:
        """[num_games] float64 in [0, 1), from the agent's own random stream, which advances."""
        return uniform_numbers(self.streams, layout.named_views(layout.stream_of, self.seat))


def pairs_of_cells(task: Task, maze: Maze, agent: str | int) -> Games:
    """States of a duel, one for each pair of cells of `maze`.

    Game `own * num_cells + other` has `agent` in cell `own` and its opponent in cell `other`, both
    active, at the start of an episode. For policies that are functions of these two cells.

    Raises:
        ValueError: the task is not a duel, or does not include this maze.
    """
    if not task.is_duel or maze not in task.mazes:
        raise ValueError(f"task {task.name!r} is not a duel in maze {maze.name}")
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

        Draw random numbers from `view.uniform()` (or the stream of the agent) only, so that games
        do not depend on the batch size.
        """
        ...


def role_of(policy: object) -> str | None:
    """The role of a policy ("chaser", "evader" or "runner"), or None."""
    role = getattr(policy, "role", None) or getattr(policy, "agent", None)
    return None if role is None else str(role).split("_")[0]


def check_plays(policy: Any, task: Task, seat: int) -> None:
    """Raise ValueError unless this is a policy and its role, if any, matches the agent.

    The policy of a runner may control an evader that collects goals.
    """
    if not callable(getattr(policy, "act", None)):
        raise ValueError(
            f"the policy of {task.agent_names[seat]} is {policy!r}; it needs a method `act`"
        )
    role, needed = role_of(policy), task.seat_roles[seat]
    collects = role == "runner" and needed == "evader" and task.num_goals > 0
    if role in ROLES and role != needed and not collects:
        raise ValueError(
            f"{policy!r} is a policy of the {role}; {task.agent_names[seat]} needs one "
            f"of the {needed}"
        )


def seat_policies(task: Task, policies: Any) -> list[Policy | None]:
    """The policy of every agent, or None.

    Args:
        task: the task.
        policies: by agent name, or by role for all agents of that role; names take precedence.

    Raises:
        ValueError: a policy of another role, or for an unknown agent.
    """
    if not isinstance(policies, Mapping):
        raise ValueError(f"policies={policies!r}; give a dict, policies by agent or role")
    for name in policies:
        if name not in (*task.agent_names, *task.seat_roles):
            raise ValueError(
                f"a policy for {name!r}; give one of {', '.join(task.agent_names)} or a "
                f"role ({', '.join(sorted(set(task.seat_roles)))})"
            )
    named = zip(task.agent_names, task.seat_roles, strict=True)
    filled = [policies.get(name, policies.get(role)) for name, role in named]
    for seat, policy in enumerate(filled):
        if policy is not None:
            check_plays(policy, task, seat)
    return filled


class Memory:
    """The memory of a policy: arrays for each batch and agent that it controls.

    They are created on first use and deleted with the batch, so one policy can control several
    agents and batches. A copy of a policy starts with empty memory.

    Args:
        make: returns the initial arrays of a view by name, each [num_games, ...].
    """

    def __init__(self, make: Callable[[GameView], dict[str, Array]]) -> None:
        self._make = make
        self._kept: WeakKeyDictionary[GameView, dict[str, Array]] = WeakKeyDictionary()

    def of(self, view: GameView) -> dict[str, Array]:
        """The live arrays of the whole batch; `view.rows` are the rows of the games of `view`."""
        whole = view.whole or view
        if whole not in self._kept:
            self._kept[whole] = self._make(whole)
        return self._kept[whole]

    def __reduce__(self) -> tuple[Any, ...]:
        return Memory, (self._make,)


@runtime_checkable
class MemoryPolicy(Protocol):
    """A policy with memory: its actions depend on earlier steps of the episode.

    Call `play`, which also calls `begin`, and not `act`, as the `Simulator` and the environments
    do. It acts once per step, in all games of the view or in a part of them.

    Attributes:
        memory: the memory, for saving games within an episode.
    """

    memory: Memory

    def begin(self, view: GameView, games: NDArray[np.intp]) -> None:
        """Reset the memory of these games of `view` (indices [n]), as their episodes start."""
        ...

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, as in `Policy`."""
        ...


ONE_RESULT = (
    "the policy returned a tuple; return the actions alone, such as model.predict(observations)[0]"
)


def play(policy: Policy, view: GameView) -> NDArray[np.int32]:
    """[num_games] int32: the actions of a policy; its memory is reset at the start of episodes."""
    begin = getattr(policy, "begin", None)  # isinstance with a protocol takes as long as 20 steps
    if begin is not None:
        fresh = np.flatnonzero(view.steps == 0)
        if len(fresh):
            begin(view, fresh)
    actions = policy.act(view)
    if isinstance(actions, tuple):
        raise ValueError(f"{ONE_RESULT}; policy={shortened(policy)}")
    return actions


def play_all(
    policies: Sequence[Policy | None],
    actions: NDArray[np.int32],
    shape: tuple[int, int],
    view: Callable[[int], GameView],
) -> None:
    """Write the actions of all agents with a policy into `actions` [games, agents] = `shape`.

    A policy without memory and with `act_together(view, seats, actions)` is called once for all its
    agents; it writes the same actions as its `act` for each of them.

    Raises:
        ValueError: a wrong shape or number of policies, or an invalid policy.
    """
    try:
        fit = actions.shape == shape and len(policies) == shape[1]
    except (AttributeError, TypeError):
        fit = False
    if not fit:
        needed = f"give a policy or None per agent, and actions of shape {shape}"
        raise ValueError(f"policies={shortened(policies)}, actions={shortened(actions)}; {needed}")
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


def tells_its_play(policy: object, method: str) -> bool:
    """Whether a method, "action_probabilities" or "distribution", tells what a policy plays.

    Not without that method or with memory, nor where a class has an `act` of its own beside the
    method of its base: that tells what the base plays. (`moves` defines all of a scripted agent.)
    """
    if not callable(getattr(policy, method, None)) or hasattr(policy, "begin"):
        return False
    for own in (getattr(policy, "__dict__", {}), *map(vars, type(policy).__mro__)):
        if method in own or "moves" in own:
            return True
        if "act" in own:
            return False
    return False


@runtime_checkable
class TabularPolicy(Protocol):
    """A policy that is a function of (own cell, other cell) in duels.

    Where it is one in some tasks only, `is_table(task)` says in which, as of learned policies.
    """

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64, the exact distribution over actions."""
        ...


@runtime_checkable
class DistributionPolicy(Protocol):
    """A policy with a known action distribution in every state of a task.

    A team with correlated actions also has `joint_distribution(task, games)`: [games, joint
    actions] float64, with the action of the last member varying fastest.
    """

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, the distributions for agent `seat` in any given states.

        Raises:
            ValueError: states for which the distribution is unknown.
        """
