"""Agents that look at the cells of a whole team: joint tables, and plans for every step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pursuit.maze import Maze
from pursuit.policy import GameView
from pursuit.rules.layout import Games
from pursuit.task import Task
from scripted_agents.places import Places
from scripted_agents.team_kernels import draw_together


class TeamPolicy:
    """A side of a chase of one evader by a team, as one table over the cells of all.

    The chasers draw their joint action together: from a random number that each of them finds for
    itself in the state of the game, so every chaser must be filled by this policy for their joint
    play to be this table; alone among others a chaser plays its own part of it.

    Args:
        maze: where it plays.
        places: of that maze.
        role: "chaser" or "evader".
        table: [teams, cells, joint actions] float64 of the chasers, or [teams, cells, actions] of
            the evader.
        epsilon: share of random moves of each agent; the simulator's own of a game goes first.
    """

    def __init__(
        self,
        maze: Maze,
        places: Places,
        role: str,
        table: NDArray[np.float64],
        epsilon: float = 0.0,
    ) -> None:
        self.maze, self.places, self.role, self.epsilon = maze, places, role, float(epsilon)
        self.table = table
        self._cumulative = table.reshape(-1, table.shape[-1]).cumsum(axis=1)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.role}, {self.places.num_chasers} chaser(s))"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game.

        Raises:
            ValueError: games of another maze, team or set of actions.
        """
        check_place(self, view.task, view.seat)
        chances = self._cumulative[self._numbers(view.games)]
        shared = np.empty(view.num_games)
        if self.role == "chaser":
            draw_together(view.streams, view.steps, shared)
        else:
            shared[:] = view.uniform()
        chosen = (shared[:, None] * chances[:, -1:] >= chances[:, :-1]).sum(axis=1)
        if self.role == "chaser":
            chosen = self.places.parts[chosen, view.seat]
        return with_random_moves(self.places, view, chosen, self.epsilon)

    def joint_distribution(self, task: Task, games: Games) -> NDArray[np.float64]:
        """[games, joint actions] float64, of the chasers; of the evader [games, actions]."""
        check_place(self, task, 0 if self.role == "chaser" else self.places.num_chasers)
        joint = self.table.reshape(-1, self.table.shape[-1])[self._numbers(games)]
        if self.epsilon == 0.0:
            return joint
        actions, agents = task.num_actions, self._agents()
        moves = self.places.random_moves
        joint = joint.reshape(-1, *(actions,) * len(agents))
        for axis, agent in enumerate(agents, start=1):
            others = joint.sum(axis=axis, keepdims=True)
            shape = [-1] + [actions if a == axis else 1 for a in range(1, len(agents) + 1)]
            random = moves[games.position[:, agent]].reshape(shape)
            joint = (1.0 - self.epsilon) * joint + self.epsilon * others * random
        return joint.reshape(len(joint), -1)

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64, the part of one agent; of a chaser whatever the others do."""
        check_place(self, task, seat)
        joint = self.joint_distribution(task, games)
        if self.role == "evader":
            return joint
        parts = joint.reshape(-1, *(task.num_actions,) * self.places.num_chasers)
        others = [axis for axis in range(1, parts.ndim) if axis != seat + 1]
        own: NDArray[np.float64] = parts.sum(axis=tuple(others))
        return own

    def _agents(self) -> list[int]:
        chasers = self.places.num_chasers
        return list(range(chasers)) if self.role == "chaser" else [chasers]

    def _numbers(self, games: Games) -> NDArray[np.int64]:
        return numbers_of(self.places, games)


class TeamPlan:
    """A deterministic plan of some agents of a chase: what each does at every step and place.

    Args:
        maze: where it plays.
        places: of that maze.
        role: whose.
        actions: [steps, teams * cells, agents] int8; beyond the last step the last row goes on.
        seats: of those agents.
    """

    epsilon = 0.0

    def __init__(
        self,
        maze: Maze,
        places: Places,
        role: str,
        actions: NDArray[np.int8],
        seats: tuple[int, ...],
    ) -> None:
        self.maze, self.places, self.role = maze, places, role
        self.actions, self.seats = actions, seats

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.role}, {len(self.actions)} steps)"

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game.

        Raises:
            ValueError: games of another maze, team or set of actions, or a seat it has no plan for.
        """
        check_place(self, view.task, view.seat)
        if view.seat not in self.seats:
            raise ValueError(f"{self!r} has a plan for the seats {self.seats}, not for {view.seat}")
        step = np.minimum(view.steps, len(self.actions) - 1)
        own = self.actions[step, numbers_of(self.places, view.games), self.seats.index(view.seat)]
        return with_random_moves(self.places, view, own, self.epsilon)


def numbers_of(places: Places, games: Games) -> NDArray[np.int64]:
    """[games] int64: team * cells + evader's cell."""
    chasers = places.num_chasers
    team = places.number(games.position[:, :chasers])
    return team * places.size + games.position[:, chasers]


def check_place(policy: TeamPolicy | TeamPlan, task: Task, seat: int) -> None:
    """ValueError unless these are games as the policy's table is of, and the seat its role's."""
    places = policy.places
    if task.seat_roles[seat] != policy.role:
        raise ValueError(
            f"{policy!r} is a {policy.role}; this seat is another's: {task.seat_roles[seat]}"
        )
    mine = (places.num_chasers, 1, 0, 0, places.neighbors.shape[1])
    theirs = (*task.teams, task.num_actions)
    if mine != theirs or task.mazes != (policy.maze,):
        raise ValueError(
            f"{policy!r} plays in {policy.maze.name} with {mine[4]} actions; this task has "
            f"{task.num_chasers} chaser(s), {task.num_evaders} evader(s), {task.num_runners} "
            f"runner(s), {task.num_goals} goal(s) and {task.num_actions} actions in "
            f"{', '.join(maze.name for maze in task.mazes)}"
        )


def with_random_moves(
    places: Places, view: GameView, chosen: NDArray[np.integer], default: float
) -> NDArray[np.int32]:
    """[games] int32: `chosen`, or with a game's epsilon (`default` where it is NaN) a random move.

    Two numbers of the seat's own stream are drawn in every game, whatever the other games do.
    """
    epsilon = view.epsilon[:, view.seat]
    epsilon = np.where(np.isnan(epsilon), default, epsilon)
    random, draw = view.uniform() < epsilon, view.uniform()
    moves = places.random_moves[view.positions[:, view.seat]].cumsum(axis=1)
    moved = (draw[:, None] * moves[:, -1:] >= moves[:, :-1]).sum(axis=1)
    return np.where(random, moved, chosen).astype(np.int32)
