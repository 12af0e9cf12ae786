"""LearnedPolicy: a trained network in any seat, and as a table for the exact solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.maze import Maze
from pursuit.observations import ENCODINGS, Encoder
from pursuit.policy import GameView, Policy, pairs_of_cells
from pursuit.rules.layout import Games
from pursuit.task import Task
from train.networks.features import Features, features_of


class PolicyNetwork(Protocol):
    """What makes a policy: `ActorCritic`, `QNetwork`."""

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] from observations; the greedy action has the largest."""

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """All weights."""

    def state_dict(self) -> dict[str, Any]:
        """All weights by name."""

    def load_state_dict(self, state_dict: dict[str, Any]) -> Any:
        """Take them."""


class Player(Protocol):
    """Whoever a learner learns to play: all that it knows of the game is this and its specs."""

    @property
    def features(self) -> Features:
        """What it observes."""

    @property
    def num_actions(self) -> int:
        """How many actions it chooses from."""

    @property
    def members(self) -> int:
        """How many agents have its role, itself included."""

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> Policy:
        """A network as this player."""


@dataclass(frozen=True)
class Seat:
    """An agent of a task, or with a role's name any of that role: the `Player` of grid games.

    Attributes:
        task: the game.
        agent: by name or role.
        encoding: what it observes.
    """

    task: Task
    agent: str
    encoding: str = "index"

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

    @cached_property
    def features(self) -> Features:
        """Of its encoding."""
        return features_of(Encoder(self.task, self.encoding), self.task.num_agents)

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> LearnedPolicy:
        """A network in this seat; a table over cells only where cells are all that it sees."""
        timed = self.encoding not in ENCODINGS and not sees_cells_only(self.task, self.encoding)
        return (TimedPolicy if timed else LearnedPolicy)(network, self, greedy)


@lru_cache(maxsize=64)
def sees_cells_only(task: Task, encoding: Any) -> bool:
    """Whether what is observed in a duel is a function of the two cells: not of time as well."""
    if not task.is_duel:
        return True
    encoder = Encoder(task, encoding)
    for maze in task.mazes:
        pairs = pairs_of_cells(task, maze, 0)
        step = 1 + len(pairs.steps) // 100_000  # a part of them will do in large mazes
        games = Games(*(array[::step] for array in pairs))
        at_first = encoder.encode(games)
        for steps in (1, task.max_steps // 2, task.max_steps - 1):
            games.steps[:] = steps
            if not np.array_equal(at_first, encoder.encode(games)):
                return False
    return True


class LearnedPolicy:
    """A network that fills a seat.

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

    def probabilities(self, observations: NDArray[Any]) -> NDArray[np.float64]:
        """[..., actions] float64: the distribution played, for observations [..., *shape]."""
        device = next(self.network.parameters()).device
        with torch.no_grad():
            logits = self.network.logits(torch.from_numpy(observations).to(device))
            if self.greedy:
                chosen = torch.nn.functional.one_hot(logits.argmax(dim=-1), logits.shape[-1])
                return chosen.cpu().double().numpy()
            return logits.double().softmax(dim=-1).cpu().numpy()

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32, an action for every game; random numbers from the seat's stream.

        Raises:
            ValueError: the games look different from those that it was trained in.
        """
        observations = view.observe(self.encoding)
        return self.choose(view, observations, None if self.greedy else view.uniform())

    def choose(
        self, view: GameView, observations: NDArray[Any], draws: NDArray[np.float64] | None
    ) -> NDArray[np.int32]:
        """[games] int32 for these observations; `draws` [games] in [0, 1), None where greedy.

        Raises:
            ValueError: as `act`.
        """
        if observations.shape[1:] != self._shape or view.task.num_actions != self.task.num_actions:
            raise ValueError(
                f"a policy for observations of shape {self._shape} and {self.task.num_actions} "
                f"actions; this task gives {observations.shape[1:]} and {view.task.num_actions}. "
                "Mazes and agents must be those of its training"
            )
        probabilities = self.probabilities(observations)
        if draws is None:
            return probabilities.argmax(axis=-1).astype(np.int32)
        cumulative = probabilities.cumsum(axis=-1)
        scaled = draws[:, None] * cumulative[:, -1:]
        chosen = (scaled >= cumulative).sum(axis=-1).clip(max=view.task.num_actions - 1)
        return chosen.astype(np.int32)

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: the network run once on all pairs of cells.

        Raises:
            ValueError: it was not trained one against one in this maze, or with other actions.
        """
        task = self.task
        if not task.is_duel or maze not in task.mazes or task.stay_action != stay_action:
            raise ValueError(
                f"a policy trained in task {task.name!r} on "
                f"{', '.join(maze.name for maze in task.mazes)} with {task.num_actions} actions is "
                "no table over pairs of cells of this maze; only one chaser against one evader is"
            )
        size, seat = maze.num_cells, task.seat(self.agent)
        pairs = pairs_of_cells(task, maze, seat)
        observed = Encoder(task, self.encoding).encode(pairs, slice(seat, seat + 1))[:, 0]
        return self.probabilities(observed).reshape(size, size, task.num_actions)


class TimedPolicy(LearnedPolicy):
    """A network that sees more than the cells, the time say, and so is no `TabularPolicy`."""

    action_probabilities = None  # type: ignore[assignment]  # how a class says so to a protocol
