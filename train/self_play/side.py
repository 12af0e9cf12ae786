"""One side of self-play: its games, its learner, and the opponents it meets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from train.algorithms.learner import Learner
from train.algorithms.registry import Algorithm, Build
from train.environments.hooks import EpisodeHook
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import Seat
from train.runs.folder import check_learned
from train.runs.training_state import restore_simulator, simulator_tensors
from train.self_play.pool import OpponentPool, PoolPolicy
from train.settings.algorithms import Hyperparameters


class Opponents(EpisodeHook):
    """Gives every game another member of a pool in each episode, and keeps the scores.

    Args:
        simulator: the games.
        role: of the learner.
        discount: of the scores.
        seed: of the drawing.
        steps: between two changes of an opponent that learns as well, about.

    Attributes:
        policy: fills the other seats; its `opponents` says who plays in which game.
        shares: how often each member of the pool is drawn.
        rng: what draws them.
    """

    def __init__(
        self, simulator: Simulator, role: str, discount: float, seed: int, steps: int = 1
    ) -> None:
        super().__init__()
        self.simulator, self.role, self.discount = simulator, role, discount
        nobody: Any = None  # the pool, once both sides stand
        self.policy = PoolPolicy(nobody, simulator.num_games, steps)
        self.rng = np.random.default_rng(seed)
        self.shares: NDArray[np.float64] = np.ones(1)

    @property
    def pool(self) -> OpponentPool:
        """Whose members are drawn."""
        return self.policy.pool

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Draw an opponent for each of these games."""
        drawn = self.rng.choice(len(self.shares), size=len(games), p=self.shares)
        self.policy.opponents[games] = drawn

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Note the learner's scores against the opponents of these games.

        An evader's score is 1 - discount ** steps: what it got of the most that it could get, in
        the discounted game; a chaser's is discount ** steps.
        """
        left = self.discount ** self.simulator.steps[games].astype(np.float64)
        scores = left if self.role == "chaser" else 1.0 - left
        opponents = self.policy.opponents[games]
        for member in np.unique(opponents).tolist():
            self.pool.note(member, scores[opponents == member])


@dataclass(frozen=True)
class SideParts:
    """What one side is made of.

    Attributes:
        seat: whose policy is learned: the role, in the games.
        algorithm, hyper, build: what it learns by, the settings of that, and how it is built.
        discount: of the exact game.
        scale: of the rewards.
    """

    seat: Seat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    discount: float
    scale: float


class Side:
    """One role that learns.

    Args:
        parts: of the side.
        number: of the role; both roles' games begin differently though they share a seed.
        state: what `state_dict` gave; None begins.

    Attributes:
        parts, env, learner: of this role.
        opponents: whom it meets.
    """

    def __init__(self, parts: SideParts, number: int, state: dict[str, Any] | None = None) -> None:
        self.parts = parts
        task, role = parts.seat.task, parts.seat.agent
        games = parts.hyper.num_games // task.count(role)
        given: Any = {"seed": parts.build.seed, "first_game": number * 2**20, "auto_restart": False}
        self.simulator = Simulator(task, games, **given)
        self.opponents = Opponents(
            self.simulator,
            role,
            parts.discount,
            2 * parts.build.seed + number,
            getattr(parts.hyper, "rollout_steps", 1),
        )
        self.env = self._games()
        if state is not None:
            check_learned(parts.algorithm.name, state)
            # before there is a collector, which begins with what it finds
            restore_simulator(self.simulator, state["simulator"])
            self.opponents.policy.opponents[:] = state["opponents"].numpy()
            self.opponents.rng.bit_generator.state = state["rng"]
            self.env.idle[:] = state["idle"].numpy()
            self.env.resume = True
        self.learner: Learner = parts.algorithm.build(parts.hyper, self.env, parts.build)

    def _games(self) -> SimulatorEnv:
        """The training games."""
        parts, others = self.parts, self.opponents
        roles = parts.seat.task.seat_roles
        policies = [None if role == parts.seat.agent else others.policy for role in roles]
        given = (parts.seat.members, parts.scale)
        return SimulatorEnv(self.simulator, parts.seat, policies, others, *given)

    @property
    def greedy(self) -> bool:
        """Whether it plays greedily while it learns: where there is no distribution."""
        return not self.parts.algorithm.learns_distribution

    def policy(self) -> Policy:
        """As it plays while it learns."""
        return self.learner.policy(greedy=self.greedy)

    def load(self, state: dict[str, Any]) -> Policy:
        """The policy of a snapshot; ValueError for weights that are not finite."""
        check_learned(self.parts.algorithm.name, {"learner": state})
        return self.parts.algorithm.load(self.parts.hyper, self.parts.seat, state, self.greedy)

    def snapshot(self) -> dict[str, Any]:
        """What `load` needs."""
        network: Any = self.learner.state_dict()["network"]
        return {"network": {name: tensor.clone() for name, tensor in network.items()}}

    def state_dict(self) -> dict[str, Any]:
        """Everything but the pool."""
        return {
            "algorithm": self.parts.algorithm.name,
            "learner": self.learner.state_dict(),
            "simulator": simulator_tensors(self.simulator),
            **self._own_state(),
        }

    def _own_state(self) -> dict[str, Any]:
        """Who plays in which game, and who is drawn next."""
        return {
            "opponents": torch.from_numpy(self.opponents.policy.opponents.copy()),
            "idle": torch.from_numpy(self.env.idle.copy()),
            "rng": self.opponents.rng.bit_generator.state,
        }
