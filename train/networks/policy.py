"""Policies that play with a trained network, and their tables for the exact solvers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.custom import AGENT_ID, without_id
from pursuit.observations.masks import action_masks, task_has_masks, warn_of_masks
from pursuit.observations.observations import Encoder
from pursuit.replays.adapters import MazeAdapter
from pursuit.rules.arrays import Array
from pursuit.rules.layout import Games, copied_games
from pursuit.simulator.policy import GameView, pairs_of_cells
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import ACTIONS, Task
from pursuit.validation import Plain, check
from train.networks.features import Features, dtype_of, features_for, features_of, observed
from train.networks.frames import Observations, stacked
from train.networks.joint_policy import JointPolicy, member_actions
from train.networks.layers import Network, float32_inference
from train.networks.numbering import SeatNumbering, StateNumbers
from train.networks.recurrent_policy import (
    RecurrentPolicy,
    check_looks,
    chosen_from,
    numbers_fit,
    probabilities_of,
)
from train.networks.seat import Seat
from train.settings.algorithms import STATE

GAMES_AT_ONCE, NUMBERS_AT_ONCE = 65_536, 2**23
"""Largest number of games, and of numbers in their observations, in one forward pass."""

CRITIC = "critic_observation"
"""The key of the observations of a central critic."""

NO_WALLS = ("index", "one_hot", "positions", "cells")
"""Encodings that do not contain the walls between cells."""


class PolicyNetwork(Network, Protocol):
    """A network for discrete actions: `ActorCritic`, `QNetwork`."""

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions] from observations; the greedy action has the largest logit."""


class ActionNetwork(Network, Protocol):
    """A network for continuous actions."""

    def act(self, observation: torch.Tensor, noise: torch.Tensor | None) -> torch.Tensor:
        """[..., numbers] in [-1, 1] from observations [..., k].

        Args:
            observation: float32.
            noise: [..., numbers] standard normal draws; None for the greedy action.
        """


def logits_of(network: PolicyNetwork, observations: Observations) -> torch.Tensor:
    """[..., actions] from observations [..., *shape], in float32 on the device of the network."""
    device = next(network.parameters()).device
    with float32_inference(network):
        return network.logits(torch.from_numpy(observations).to(device))


@dataclass(frozen=True)
class MazeSeat(Seat):
    """An agent of a task in mazes, or any agent of a role.

    Attributes:
        task: the game.
        agent: name or role.
        encoding: its observation.
        mask_bumps: whether moves into walls are masked, in training and evaluation.
        frame_stack: number of stacked observations.
        network: its network, by the name in the settings.
        min_probability: its policies never play actions of lower probability, unless greedy.
        team: whether all agents of the role learn together; then `agent` is the role.
        joint: whether the team is one player, whose actions are the joint actions of all agents.
        critic: the observation of a central critic: "state", the cells of `state()` with the number
            of the agent, or an encoding, seen with full view; "" for none.
    """

    task: Task
    agent: str
    encoding: str = "index"
    mask_bumps: bool = False
    frame_stack: int = 1
    network: str = "auto"
    min_probability: float = 0.0
    team: bool = False
    joint: bool = False
    critic: str = ""
    NO_NUMBERS: ClassVar[str] = ""
    NO_TEAM: ClassVar[bool] = False

    @property
    def num_actions(self) -> int:
        """4, or 5 with the stay action; of a team as one player all joint actions."""
        return self.task.num_actions ** (self.task.count(self.role) if self.joint else 1)

    @property
    def described(self) -> Plain:
        """As of `Seat`: the settings, as in replays."""
        return MazeAdapter().settings(self.task)

    def in_task(self, described: Plain) -> MazeSeat:
        """As of `Seat`; policies are checked where they play."""
        return replace(self, task=MazeAdapter().task(described))

    @property
    def action_names(self) -> list[str]:
        """As of `Seat`."""
        task = self.task
        moves = [*ACTIONS[:-1]] if task.mazes[0].is_grid else []
        moves = moves or [f"neighbor {number}" for number in range(task.num_moves)]
        return [*moves, *ACTIONS[-1:] * task.stay_action]

    def masks(self, view: GameView) -> NDArray[np.bool_] | None:
        """[games, actions]: the action mask of the agent of the view; None allows all."""
        if not self.has_masks:
            return None
        own = slice(view.seat, view.seat + 1)
        return action_masks(view.games, view.mazes, view.task, own)[:, 0]

    @property
    def has_masks(self) -> bool:
        """Whether actions are masked: with `mask_bumps`, or in turns."""
        return task_has_masks(self.task, self.mask_bumps)

    @cached_property
    def seen(self) -> Features:
        """The features of a single observation."""
        return features_of(Encoder(self.task, self.encoding), self.task.num_agents)

    @cached_property
    def features(self) -> Features:
        """The features of the network's input."""
        return features_for(stacked(self.seen, self.frame_stack), self.network)

    @cached_property
    def critic_encoder(self) -> Encoder:
        """The encoding of the central critic's observation, of the task with full views; asked only
        where there is one."""
        full = replace(self.task, view_radius=None, line_of_sight=False, unknown_maze=False)
        encoding = f"index{AGENT_ID}" if self.critic == STATE else self.critic
        return Encoder(full, encoding, dtype_of(encoding))

    @cached_property
    def critic_features(self) -> Features | None:
        """The features of the central critic's observation; None without one."""
        if not self.critic:
            return None
        return features_for(features_of(self.critic_encoder, self.task.num_agents), "auto")

    def critic_bounds(self, batch: Simulator) -> tuple[Array, Array]:
        """As of `Seat`."""
        return self.critic_encoder.space.low, self.critic_encoder.space.high

    def critic_observations(self, batch: Simulator) -> Observations:
        """As of `Seat`."""
        games, first, last = batch.games, self.number, self.number + self.members
        if self.critic != STATE:
            return self.critic_encoder.encode(games, slice(first, last))
        state = self.critic_encoder.encode(games, slice(first, first + 1))
        seen = state.repeat(self.members, axis=1)  # entities in one order for all
        seen[:, :, -1] += np.arange(self.members)
        return seen

    @property
    def numbering(self) -> SeatNumbering:
        """As of `Seat`; ValueError for several mazes."""
        return StateNumbers(self.task, self.agent, self.mask_bumps, self)

    def bounds(self, batch: Simulator) -> tuple[Array, Array]:
        """As of `Seat`; warns where masks forbid waiting."""
        if self.mask_bumps:
            warn_of_masks(batch.task)
        space = batch.encoder(self.encoding, dtype_of(self.encoding)).space
        return space.low.astype(space.dtype), space.high.astype(space.dtype)

    def observe(self, batch: Simulator, agents: slice) -> Observations:
        """As of `Seat`."""
        encoder = batch.encoder(self.encoding, dtype_of(self.encoding))
        return encoder.encode(batch.games, agents)

    def allowed(self, batch: Simulator, agents: slice) -> NDArray[np.bool_]:
        """As of `Seat`."""
        world = lay_out(batch.task.mazes)
        return action_masks(batch.games, world, batch.task, agents, batch.terminated)

    def left(self, batch: Simulator, agents: slice) -> NDArray[np.bool_]:
        """As of `Seat`: captured or escaped."""
        return np.asarray(batch.active[:, agents] == 0)

    def moves(self, actions: NDArray[Any]) -> NDArray[np.int32]:
        """As of `Seat`; joint actions by agent."""
        return (
            member_actions(actions, self.task, self.role) if self.joint else super().moves(actions)
        )

    def policy(self, network: PolicyNetwork, greedy: bool = True) -> Any:
        """A policy with this network: a `JointPolicy` of a team as one player, a `RecurrentPolicy`
        with memory or stacked observations, a `LearnedPolicy` where it observes cells only, else a
        `NetworkPolicy`."""
        if self.joint:
            return JointPolicy(LearnedPolicy(network, self, greedy))
        if self.frame_stack > 1 or getattr(network, "policy_memory", None) is not None:
            return RecurrentPolicy(network, self, greedy)
        known = sees_cells_only(self.task, self.encoding)
        return (LearnedPolicy if known else NetworkPolicy)(network, self, greedy)


@lru_cache(maxsize=256)
def sees_cells_only(task: Task, encoding: str) -> bool:
    """Whether an observation, built in or not, is a function of cells and goals only, not of time.

    Tested in a thousand states, fewer of large observations: at the first, second, middle and last
    step, and at many others. In a duel these are pairs of cells of up to ten mazes, else starts.
    """
    encoder = Encoder(task, encoding, dtype_of(encoding))
    most = max(min(1000, NUMBERS_AT_ONCE // (task.num_agents * math.prod(encoder.shape))), 10)
    mazes = task.mazes[:: 1 + len(task.mazes) // 10] if task.is_duel else ()
    samples = [pairs_of_cells(task, maze, 0) for maze in mazes] or [Simulator(task, most).games]
    for sample in samples:
        step = 1 + len(sample.steps) * len(samples) // most
        games = copied_games(sample, slice(None, None, step))
        games.steps[:] = 0
        at_first, last = encoder.encode(games), task.max_steps - 1
        for steps in (1, last // 2, last, np.arange(len(games.steps)) % task.max_steps):
            games.steps[:] = steps
            if not np.array_equal(at_first, encoder.encode(games)):
                return False
    return True


class NetworkPolicy:
    """A policy that plays with a network, for any observation.

    Args:
        network: gives the logits.
        seat: the one that it was trained in.
        greedy: the most probable action; False draws from the distribution.

    Attributes:
        network, seat, greedy: the arguments.
        task, agent, encoding: of the seat.
    """

    def __init__(self, network: PolicyNetwork, seat: MazeSeat, greedy: bool = True) -> None:
        self.network, self.seat, self.greedy = network, seat, greedy
        self.task, self.agent, self.encoding = seat.task, seat.agent, seat.encoding
        self._shape = seat.features.shape

    def probabilities(
        self, observations: Observations, allowed: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """[..., actions] float64: the action probabilities.

        Args:
            observations: [..., *shape].
            allowed: [..., actions], the action mask; None allows all.
        """
        logits = logits_of(self.network, observations)
        return probabilities_of(logits, allowed, self.greedy, self.seat.min_probability)

    def act(self, view: GameView) -> NDArray[np.int32]:
        """[num_games] int32: actions; draws use the random stream of the view.

        Raises:
            ValueError: observations other than in training.
        """
        observations = observed(view, self.encoding)
        draws = None if self.greedy else view.uniform()
        return self.choose(view, observations, draws, self.seat.masks(view))

    def choose(
        self,
        view: GameView,
        observations: Observations,
        draws: NDArray[np.float64] | None,
        allowed: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.int32]:
        """[games] int32 for these observations.

        Args:
            view: of these games, or of games of the same task.
            observations: [games, *shape].
            draws: [games] in [0, 1); None for greedy actions.
            allowed: [games, actions]; None allows all.

        Raises:
            ValueError: as `act`.
        """
        self._check(view, observations)
        return chosen_from(self.probabilities(observations, allowed), draws)

    def _check(self, view: GameView, observations: Observations) -> None:
        """ValueError unless the observations have the form of those in training."""
        check_looks(observations, self._shape, self.task, view, self.encoding)


class LearnedPolicy(NetworkPolicy):
    """A policy that observes cells and goals only, so that its distribution is known exactly."""

    def is_table(self, task: Task) -> bool:
        """Whether it observes cells and goals only also in the games of `task`."""
        return all(sees_cells_only(each, self.encoding) for each in (self.task, task))

    def distribution(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the action probabilities of agent `seat`, whatever the step.

        Raises:
            ValueError: as `probabilities_in`; an observation that depends on the step.
        """
        found = self.probabilities_in(task, games, seat)
        check(
            sees_cells_only(task, self.encoding),
            f"a policy that observes {self.encoding!r} depends on the step in task {task.name!r}, "
            "so it has no distribution in a state",
        )
        return found

    def probabilities_in(self, task: Task, games: Games, seat: int) -> NDArray[np.float64]:
        """[games, actions] float64: the action probabilities of agent `seat` in these games.

        Raises:
            ValueError: an agent of another role, or observations other than in training.
        """
        encoder = Encoder(task, self.encoding, dtype_of(self.encoding))
        role = task.seat_roles[seat]
        if (
            role != self.seat.role
            or tuple(encoder.shape) != self._shape
            or task.num_actions != self.task.num_actions
            or not numbers_fit(self.encoding, self.task, task)
        ):
            raise ValueError(
                f"this policy is for the {self.seat.role} of task {self.task.name!r}, observations "
                f"{self._shape} and mazes of {self.task.max_cells} cells; the {role} of task "
                f"{task.name!r} observes {encoder.shape} in {task.max_cells} cells; train with "
                "observation window:R to play in mazes of any size (on graphs, an observation "
                "of your own)"
            )
        return self._in_batches(encoder, task, games, seat)

    def _in_batches(
        self, encoder: Encoder, task: Task, games: Games, seat: int
    ) -> NDArray[np.float64]:
        """[games, actions] float64, computed in batches of limited size."""
        probabilities = np.empty((len(games.steps), self.seat.num_actions))
        at_once = max(min(GAMES_AT_ONCE, NUMBERS_AT_ONCE // math.prod(self._shape)), 1)
        own, world, allowed = slice(seat, seat + 1), lay_out(task.mazes), None
        for first in range(0, len(probabilities), at_once):
            batch = slice(first, first + at_once)
            part = Games(*(array[batch] for array in games))
            if self.seat.has_masks:
                allowed = action_masks(part, world, task, own)[:, 0]
            probabilities[batch] = self.probabilities(encoder.encode(part, own)[:, 0], allowed)
        return probabilities

    def action_probabilities(self, maze: Maze, stay_action: bool = False) -> NDArray[np.float64]:
        """[self cell, other cell, action] float64: one forward pass for all pairs of cells.

        Also in mazes other than those of the training, if the observation contains the walls and
        has the same shape.

        Raises:
            ValueError: the task is not a duel, or the maze or the actions do not match.
        """
        task = self.task
        if not task.is_duel or not self.plays_in(maze) or task.stay_action != stay_action:
            names = [each.name for each in task.mazes]
            listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if names[3:] else "")
            raise ValueError(
                f"{getattr(self, 'name', 'a policy')}, trained in task {task.name!r} on {listed} "
                f"with {task.num_actions} actions, has no table over pairs of cells of this "
                "maze; use a policy of one chaser against one evader, trained in this maze or with "
                "an observation that fits it"
            )
        task = self._in_maze(maze)
        size, seat = maze.num_cells, task.seat(self.agent)
        pairs = pairs_of_cells(task, maze, seat)
        encoder = Encoder(task, self.encoding, dtype_of(self.encoding))
        probabilities = self._in_batches(encoder, task, pairs, seat)
        return probabilities.reshape(size, size, task.num_actions)

    def table_rows(self, task: Task) -> int | None:
        """The number of rows of `state_table` in the games of a task: the pairs of cells of a duel
        in one maze; None if it has none there."""
        own, maze = self.task, task.mazes[0]
        fits = task.is_duel and own.is_duel and len(task.mazes) == 1
        if not fits or own.stay_action != task.stay_action or not self.plays_in(maze):
            return None
        return maze.num_cells**2

    def state_table(self, task: Task) -> NDArray[np.float64]:
        """[states, actions] float64: the action probabilities in every state of the games of a
        task, in the order of `table_rows_of` of their views."""
        table = self.action_probabilities(task.mazes[0], task.stay_action)
        return table.reshape(-1, table.shape[-1])

    def plays_in(self, maze: Maze) -> bool:
        """Whether it can play in a maze: a training maze, or any maze if the observation contains
        walls and has the same shape."""
        if maze in self.task.mazes:
            return True
        if without_id(self.encoding) in NO_WALLS:
            return False
        return tuple(Encoder(self._in_maze(maze), self.encoding).shape) == self._shape

    def _in_maze(self, maze: Maze) -> Task:
        """The training task; for another maze, the same task in this maze only."""
        return self.task if maze in self.task.mazes else replace(self.task, maze=maze)
