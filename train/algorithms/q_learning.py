"""Tabular Q-learning over the exact states of a game, with compiled kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from curricula import linear
from pursuit.rules import seed_streams
from pursuit.validation import check, need
from train.algorithms.learner import Build
from train.algorithms.q_learning_kernels import choose_actions, learn
from train.environments.batch_env import BatchEnv
from train.networks.numbering import SeatNumbering
from train.networks.seat import Seat
from train.settings.algorithms import QLearningSettings
from train.tensors import StateDict

STEPS_PER_ITERATION = 64
EXPLORATION_SEEDS = 2**63
"""Exploration uses seeds from here on; games have lower ones."""


def check_seat(settings: QLearningSettings, seat: Seat) -> None:
    """ValueError for a task without a table, a limited view, or unbounded values."""
    need(seat.numbering).check(settings.gamma)


def initial_values(numbers: SeatNumbering, actions: int, optimism: float) -> NDArray[np.float64]:
    """[states, actions] float64: `optimism` for every remaining goal; without goals, once."""
    goal_sets = numbers.goal_sets
    if len(goal_sets) == 1:
        return np.full((numbers.count, actions), optimism)
    left = np.repeat(np.arange(len(goal_sets)), goal_sets)
    placements = numbers.count // len(left)
    return np.repeat(np.tile(optimism * left, placements)[:, None], actions, axis=1)


class QLearning:
    """Watkins (1989), with parallel games that share one table.

    Args:
        settings: the hyperparameters.
        env: the training environment; its simulator is stepped directly.
        options: have the seed of the exploration.

    Raises:
        ValueError: the task has too many states for a table.

    Attributes:
        q_values: [states, actions] float64.
        visits: [states, actions] uint32.
    """

    def __init__(self, settings: QLearningSettings, env: BatchEnv, options: Build) -> None:
        self.settings, self.env, self.frames = settings, env, 0
        simulator, seat = env.simulator, env.player
        self.numbers: SeatNumbering = need(seat.numbering)
        self.q_values = initial_values(self.numbers, seat.num_actions, settings.optimism)
        self.visits = np.zeros(self.q_values.shape, dtype=np.uint32)
        self._streams = np.zeros((simulator.num_games, 1), dtype=np.uint64)
        own: Any = np.uint64(EXPLORATION_SEEDS + options.seed)
        seed_streams(self._streams, own, simulator.first_game)
        agents = simulator.task.num_agents
        self._actions = np.zeros((simulator.num_games, agents), dtype=np.int32)
        self._begun = False

    def iterate(self, progress: float) -> dict[str, float]:
        """Play and learn STEPS_PER_ITERATION steps of every game."""
        settings, env = self.settings, self.env
        simulator, seat, actions = env.simulator, env.seat, self._actions
        if not self._begun:
            if not env.resume:
                env.reset_games()
            self._begun = True
        explored = min(progress / max(settings.exploration_share, 1e-9), 1.0)
        epsilon = linear(settings.epsilon_start, settings.epsilon_end, explored)
        error, numbers = 0.0, self.numbers
        states = numbers(numbers.games(simulator))
        done = np.zeros(len(states), dtype=bool)
        for _ in range(STEPS_PER_ITERATION):
            simulator.act(env.policies, actions)
            choose_actions(
                self.q_values, states, numbers.games(simulator).position, numbers.allowed,
                self._streams, epsilon, actions, seat,
            )  # fmt: skip
            simulator.step(actions)
            ended = simulator.ended if env.bounded else simulator.terminated
            size, count = learn(
                self.q_values, self.visits, *numbers.games(simulator), numbers.for_kernels,
                numbers.allowed, states, actions, seat, simulator.rewards, ended,
                simulator.truncated, done, settings.gamma, settings.learning_rate,
                settings.learning_rate_power,
            )  # fmt: skip
            error += size
            if count:
                env.finish(done)
                env.restart(done)
                numbers.renumber(numbers.games(simulator), done, states)
        self.frames += STEPS_PER_ITERATION * simulator.num_games
        return {"epsilon": epsilon, "td_error": error / STEPS_PER_ITERATION}

    def policy(self, greedy: bool = True) -> Any:
        """The greedy policy; otherwise ValueError, as action values are not a distribution."""
        if not greedy:
            raise ValueError("q_learning learns no distribution; use the greedy policy")
        return self.numbers.policy(self.q_values)

    def state_dict(self) -> StateDict:
        """The table, the visits, the random streams and the frames."""
        return {
            "q_values": torch.from_numpy(self.q_values),
            "visits": torch.from_numpy(self.visits.view(np.int32)),
            "streams": torch.from_numpy(self._streams.view(np.int64)),
            "frames": self.frames,
        }

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state; ValueError where the table has another shape."""
        self.q_values[:] = state["q_values"].numpy()
        self.visits[:] = state["visits"].numpy().view(np.uint32)
        self._streams[:] = state["streams"].numpy().view(np.uint64)
        self.frames = state["frames"]

    def start_from(self, state: StateDict) -> None:
        """As `Learner`: the table."""
        saved, own = tuple(state["q_values"].shape), self.q_values.shape
        check(saved == own, f"its table has shape {saved} instead of {own}")
        self.q_values[:] = state["q_values"].numpy()

    def close(self) -> None:
        """Nothing to release."""


def load(settings: QLearningSettings, seat: Seat, state: StateDict, greedy: bool = True) -> Any:
    """The policy in a `QLearning.state_dict`; ValueError for a table of another shape."""
    numbers = need(seat.numbering)
    shape = (numbers.count, seat.num_actions)
    saved = tuple(state["q_values"].shape)
    check(saved == shape, f"the table has shape {saved} instead of {shape}")
    return numbers.policy(state["q_values"].numpy())
