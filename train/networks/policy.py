"""A trained network in any seat, and where it sees cells only as a table for the exact solvers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.masks import action_masks
from pursuit.maze import Maze
from pursuit.maze_arrays import lay_out
from pursuit.observations import Encoder
from pursuit.own_observations import is_ours
from pursuit.policy import GameView, pairs_of_cells
from pursuit.rules.layout import Games
from pursuit.simulator import Simulator
from pursuit.task import Task
from train.networks.features import Features, features_of
from train.networks.masks import masked

GAMES_AT_ONCE = 65_536
"""Games that a network is asked about in one pass: one-hot observations of all are too many."""


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

    @property
    def bytes_of_game(self) -> int:
        """What one game takes, about, without its observation."""

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
    """

    task: Task
    agent: str
    encoding: str = "index"
    mask_bumps: bool = False
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
    def bytes_of_game(self) -> int:
        """About."""
        return 100 * self.task.num_agents + 20 * self.task.num_goals

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
    def features(self) -> Features:
        """Of its encoding."""
        return features_of(Encoder(self.task, self.encoding), self.task.num_agents)

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> NetworkPolicy:
        """A network in this seat; one that sees cells only is known as a distribution over them."""
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
            if allowed is not None:
                logits = masked(logits, torch.from_numpy(allowed).to(device))
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
        if observations.shape[1:] != self._shape or view.task.num_actions != self.task.num_actions:
            raise ValueError(
                f"a policy for observations of shape {self._shape} and {self.task.num_actions} "
                f"actions; this task gives {observations.shape[1:]} and {view.task.num_actions}. "
                "Mazes and agents must be those of its training"
            )
        probabilities = self.probabilities(observations, allowed)
        if draws is None:
            return probabilities.argmax(axis=-1).astype(np.int32)
        cumulative = probabilities.cumsum(axis=-1)
        scaled = draws[:, None] * cumulative[:, -1:]
        chosen = (scaled >= cumulative).sum(axis=-1).clip(max=view.task.num_actions - 1)
        return chosen.astype(np.int32)


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
        ):
            raise ValueError(
                f"a policy of the {self.seat.role} of task {self.task.name!r}, for observations of "
                f"shape {self._shape}; the {role} of task {task.name!r} observes {encoder.shape}"
            )
        found = np.empty((len(games.steps), task.num_actions))
        for first in range(0, len(found), GAMES_AT_ONCE):
            some = slice(first, first + GAMES_AT_ONCE)
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
        found = self._played(Encoder(task, self.encoding), task, pairs, seat)
        return found.reshape(size, size, task.num_actions)
