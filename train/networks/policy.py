"""A trained network in any seat, and where it sees cells only as a table for the exact solvers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks
from pursuit.observations.observations import Encoder
from pursuit.observations.own import is_ours
from pursuit.rules.layout import Games
from pursuit.simulator.policy import GameView, pairs_of_cells
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from train.networks.features import Features, features_for, features_of
from train.networks.frames import stacked
from train.networks.recurrent_policy import (
    RecurrentPolicy,
    check_looks,
    chosen_from,
    numbers_fit,
    probabilities_of,
)

GAMES_AT_ONCE, NUMBERS_AT_ONCE = 65_536, 2**23
"""Games that a network is asked about in one pass, and numbers of their observations: all at once
are too many."""

NO_WALLS = ("index", "one_hot", "positions", "cells")
"""Encodings that say nothing of the walls between cells."""


class Network(Protocol):
    """Whatever learns: weights."""

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """All weights."""

    def state_dict(self) -> dict[str, Any]:
        """All weights by name."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> Any:
        """Take them."""


class PolicyNetwork(Network, Protocol):
    """What makes a policy of choices: `ActorCritic`, `QNetwork`."""

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] from observations; the greedy action has the largest."""


class ActionNetwork(Network, Protocol):
    """What makes a policy of continuous actions."""

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None) -> torch.Tensor:
        """[..., numbers] in [-1, 1] from observations [..., k].

        Args:
            observation: float32.
            noise: [..., numbers] standard normal, of a policy that draws; None for the greedy one.
        """


class Player(Protocol):
    """Whoever a learner learns to play: all that it knows of the game is this and its specs."""

    @property
    def features(self) -> Features:
        """What it observes."""

    @property
    def continuous(self) -> bool:
        """Whether an action is a row of numbers in [-1, 1], and no choice of one of several."""

    @property
    def num_actions(self) -> int:
        """How many actions it chooses from; where they are continuous, numbers of an action."""

    @property
    def members(self) -> int:
        """How many agents have its role, itself included."""

    def policy(self, network: Any, greedy: bool = True) -> Any:
        """A network as this player."""


@dataclass(frozen=True)
class Seat:
    """An agent of a task, or with a role's name any of that role: the `Player` of grid games.

    Attributes:
        task: the game.
        agent: by name or role.
        encoding: what it observes.
        mask_bumps: whether moves into walls are forbidden to it, as it learns and as it plays.
        frame_stack: how many observations its network is given at once, the last of the episode.
        network: what sees it, by its name in the settings.
    """

    task: Task
    agent: str
    encoding: str = "index"
    mask_bumps: bool = False
    frame_stack: int = 1
    network: str = "auto"
    continuous: ClassVar[bool] = False

    @property
    def number(self) -> int:
        """Of the seat; for a role that of its first agent."""
        return self.task.seat(self.agent)

    @property
    def role(self) -> str:
        """Its role."""
        return self.task.seat_roles[self.number]

    @property
    def members(self) -> int:
        """Agents of that role."""
        return self.task.count(self.role)

    @property
    def num_actions(self) -> int:
        """4, or 5 where one may stay."""
        return self.task.num_actions

    def masks(self, view: GameView) -> NDArray[np.bool_] | None:
        """[games, actions]: what it may do, sitting where the view is from; None for anything."""
        if not self.mask_bumps:
            return None
        own = slice(view.seat, view.seat + 1)
        return action_masks(view.games, view.mazes.world, view.task.num_actions, own)[:, 0]

    @cached_property
    def seen(self) -> Features:
        """Of one observation."""
        return features_of(Encoder(self.task, self.encoding), self.task.num_agents)

    @cached_property
    def features(self) -> Features:
        """Of what its network is given."""
        return features_for(stacked(self.seen, self.frame_stack), self.network)

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> Any:
        """A network in this seat; one that sees cells only is known as a distribution over them,
        one that remembers is not."""
        if self.frame_stack > 1 or getattr(network, "policy_memory", None) is not None:
            return RecurrentPolicy(network, self, greedy)
        sees_more = not is_ours(self.encoding) and not sees_cells_only(self.task, self.encoding)
        return (NetworkPolicy if sees_more else LearnedPolicy)(network, self, greedy)


@lru_cache(maxsize=64)
def sees_cells_only(task: Task, encoding: Any) -> bool:
    """Whether what is observed is a function of the cells (and goals): not of time as well.

    Tried on all pairs of cells of a duel, and on a thousand starts of other tasks.
    """
    encoder, samples = Encoder(task, encoding), [Simulator(task, 1000).games]
    if task.is_duel:
        samples = [pairs_of_cells(task, maze, 0) for maze in task.mazes]
    for sample in samples:
        step = 1 + len(sample.steps) // 100_000  # a part of them will do in large mazes
        games = Games(*(array[::step].copy() for array in sample))
        games.steps[:] = 0
        at_first = encoder.encode(games)
        for steps in (1, task.max_steps // 2, task.max_steps - 1):
            games.steps[:] = steps
            if not np.array_equal(at_first, encoder.encode(games)):
                return False
    return True


class NetworkPolicy:
    """A network that fills a seat, whatever it observes.

    Args:
        network: gives the logits.
        seat: in which it was trained.
        greedy: take the most probable action; False draws from the distribution.

    Attributes:
        network, seat, greedy: the arguments.
        task, agent, encoding: of the seat.
    """

    def __init__(self, network: PolicyNetwork, seat: Seat, greedy: bool = True) -> None:
        self.network, self.seat, self.greedy = network, seat, greedy
        self.task, self.agent, self.encoding = seat.task, seat.agent, seat.encoding
        self._shape = seat.features.shape

    def probabilities(
        self, observations: NDArray[Any], allowed: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """[..., actions] float64: the distribution played.

        Args:
            observations: [..., *shape].
            allowed: [..., actions], what may be done; None for anything.
        """
        device = next(self.network.parameters()).device
        with torch.no_grad():
            logits = self.network.logits(torch.from_numpy(observations).to(device))
        return probabilities_of(logits, allowed, self.greedy)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: the games look different from those that it was trained in.
        """
        observations = view.observe(self.encoding)
        draws = None if self.greedy else view.uniform()
        return self.choose(view, observations, draws, self.seat.masks(view))

    def choose(
        self,
        view: GameView,
        observations: NDArray[Any],
        draws: NDArray[np.float64] | None,
        allowed: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.int32]:
        """[games] int32 for these observations.

        Args:
            view: of games like these.
            observations: [games, *shape].
            draws: [games] in [0, 1); None where greedy.
            allowed: [games, actions]; None for anything.

        Raises:
            ValueError: as `act`.
        """
        check_looks(observations, self._shape, self.task, view, self.encoding)
        return chosen_from(self.probabilities(observations, allowed), draws)


class LearnedPolicy(NetworkPolicy):
    """A network in a seat that observes cells and goals: a known distribution for any of them."""

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the network run on what `seat` observes in these games.

        Raises:
            ValueError: another role's seat, or games that look different from those of its
                training.
        """
        encoder = Encoder(task, self.encoding)
        role = task.seat_roles[seat]
        if (
            role != self.seat.role
            or tuple(encoder.shape) != self._shape
            or task.num_actions != self.task.num_actions
            or not numbers_fit(self.encoding, self.task, task)
        ):
            raise ValueError(
                f"a policy of the {self.seat.role} of task {self.task.name!r}, for observations of "
                f"shape {self._shape} in mazes of {self.task.max_cells} cells; the {role} of task "
                f"{task.name!r} observes {encoder.shape} in {task.max_cells}. A policy that "
                "observes window:R plays in mazes of any size"
            )
        return self._in_parts(encoder, task, games, seat)

    def _in_parts(
        self, encoder: Encoder, task: Task, games: Games, seat: int
    ) -> NDArray[np.float64]:
        """[games, actions] float64, of some games after the other."""
        found = np.empty((len(games.steps), task.num_actions))
        at_once = max(min(GAMES_AT_ONCE, NUMBERS_AT_ONCE // math.prod(self._shape)), 1)
        for first in range(0, len(found), at_once):
            some = slice(first, first + at_once)
            part = Games(*(array[some] for array in games))
            found[some] = self._played(encoder, task, part, seat)
        return found

    def _played(self, encoder: Encoder, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64."""
        own = slice(seat, seat + 1)
        observed, allowed = encoder.encode(games, own)[:, 0], None
        if self.seat.mask_bumps:
            world = lay_out(task.mazes).world
            allowed = action_masks(games, world, task.num_actions, own)[:, 0]
        return self.probabilities(observed, allowed)

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the network run once on all pairs of cells.

        In other mazes than those of its training where its observation shows the walls, and is of
        the same shape there.

        Raises:
            ValueError: it was not trained one against one, or in such a maze, or with other
                actions.
        """
        task = self.task
        if not task.is_duel or not self.plays_in(maze) or task.stay_action != stay_action:
            names = [each.name for each in task.mazes]
            told = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if names[3:] else "")
            raise ValueError(
                f"a policy trained in task {task.name!r} on {told} with {task.num_actions} actions "
                "is no table over pairs of cells of this maze; only one chaser against one evader "
                "is, in mazes of its training, or that look like them to it"
            )
        task = self._in_maze(maze)
        size, seat = maze.num_cells, task.seat(self.agent)
        pairs = pairs_of_cells(task, maze, seat)
        found = self._in_parts(Encoder(task, self.encoding), task, pairs, seat)
        return found.reshape(size, size, task.num_actions)

    def plays_in(self, maze: Maze) -> bool:
        """Whether it can play in a maze: one of its training, or where what it observes shows the
        walls and is of the same shape."""
        if maze in self.task.mazes:
            return True
        if self.encoding in NO_WALLS:
            return False
        return tuple(Encoder(self._in_maze(maze), self.encoding).shape) == self._shape

    def _in_maze(self, maze: Maze) -> Task:
        """The task of its training in this maze alone, if it is not one of its own."""
        return self.task if maze in self.task.mazes else replace(self.task, maze=maze)
