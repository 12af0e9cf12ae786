"""One side of self-play: its games, its learner, and its opponents."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from train.algorithms.learner import Learner
from train.algorithms.registry import Algorithm, Build, build_learner
from train.environments.hooks import EpisodeHook
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.games import all_caught
from train.networks.policy import Seat
from train.runs.folder import check_learned
from train.runs.training_state import restore_simulator, simulator_tensors
from train.self_play.pool import OpponentPool, PoolPolicy
from train.settings.algorithms import Hyperparameters
from train.tensors import State

DECAY = 10
"""The average of the weights has terms proportional to iteration**DECAY: about the last tenth of
the iterations so far. Longer averages are nearer to mixed equilibria, shorter ones to pure ones."""


class Opponents(EpisodeHook):
    """Draws an opponent from a pool for every episode, and records the scores.

    Args:
        simulator: the games.
        role: of the learner.
        discount: of the scores.
        seed: of the sampling.
        steps: approximate number of steps between updates of an opponent that learns.

    Attributes:
        policy: the policy of the other agents; its `opponents` are the members by game.
        shares: sampling probabilities of the members of the pool.
        rng: of the sampling.
    """

    def __init__(
        self, simulator: Simulator, role: str, discount: float, seed: int, steps: int = 1
    ) -> None:
        super().__init__()
        self.simulator, self.role, self.discount = simulator, role, discount
        pool: Any = None  # set once both sides are constructed
        self.policy = PoolPolicy(pool, simulator.num_games, steps)
        self.rng = np.random.default_rng(seed)
        self.shares: NDArray[np.float64] = np.ones(1)

    @property
    def pool(self) -> OpponentPool:
        """The pool of opponents."""
        return self.policy.pool

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Draw an opponent for each of these games."""
        drawn = self.rng.choice(len(self.shares), size=len(games), p=self.shares)
        self.policy.opponents[games] = drawn

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Record the learner's scores against the opponents of these games.

        The score of an evader is 1 - discount ** steps, its share of the highest discounted return;
        that of a chaser is discount ** steps. With exits a chaser scores 1 for a game that ends by
        a capture, 0 for one that ends by an escape, 1/2 if time is up.
        """
        task = self.simulator.task
        rounds = -(-self.simulator.steps[games] // task.steps_per_round)
        left = self.discount ** rounds.astype(np.float64)
        if task.most_exits:  # the escapes of the last step, as `Payoffs` counts games to their end
            won = all_caught(self.simulator)[games].astype(np.float64)
            left = np.where(self.simulator.terminated[games], won, 0.5)
        scores = left if self.role == "chaser" else 1.0 - left
        opponents = self.policy.opponents[games]
        for member in np.unique(opponents).tolist():
            self.pool.note(member, scores[opponents == member])


@dataclass(frozen=True)
class SideParts:
    """The parts of one side.

    Attributes:
        seat: the role that learns, in the games.
        algorithm, hyper, build: the algorithm, its hyperparameters, and its build options.
        discount: of the exact game.
        scale: of the rewards.
        training: the task of the training games, with short episodes.
        min_probability: of actions of the evaluated policy.
    """

    seat: Seat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    discount: float
    scale: float
    training: Task
    min_probability: float


class Side:
    """One role that learns.

    Args:
        parts: of the side.
        number: index of the role, for different starts of both roles with the same seed.
        state: of `state_dict`; None for a new side.

    Attributes:
        parts, env, learner: of this role.
        opponents: its opponents.
        weights: of the policy of the learner, by name.
        average: average of the weights over iterations, by name, with polynomial decay (Shamir and
            Zhang, 2013). Two learners cycle around an equilibrium; the average lies inside.
        iterations: in the average.
    """

    def __init__(self, parts: SideParts, number: int, state: State | None = None) -> None:
        self.parts = parts
        task, role = parts.seat.task, parts.seat.agent
        games = parts.hyper.num_games // task.count(role)
        self.simulator = Simulator(
            parts.training,
            games,
            seed=parts.build.seed,
            first_game=number * 2**20,
            auto_restart=False,
        )
        self.opponents = Opponents(
            self.simulator,
            role,
            parts.discount,
            2 * parts.build.seed + number,
            getattr(parts.hyper, "rollout_steps", 1),
        )
        seat, pool = parts.seat, self.opponents.policy
        policies = [None if own == role else pool for own in task.seat_roles]
        self.env = SimulatorEnv(
            self.simulator, seat, policies, self.opponents, seat.members, parts.scale
        )
        if state is not None:
            check_learned(parts.algorithm.name, state)
            # before the collector of the learner reads the environment
            restore_simulator(self.simulator, state["simulator"])
            pool.opponents[:] = state["opponents"].numpy()
            self.opponents.rng.bit_generator.state = state["rng"]
            self.env.idle[:] = state["idle"].numpy()
            self.env.resume = True
        self.learner: Learner = build_learner(parts.algorithm, parts.hyper, self.env, parts.build)
        # Those of the learner itself: its states are loaded in place.
        self.weights: dict[str, torch.Tensor] = dict(self.learner.state_dict()["network"])
        self.average, self.iterations = self._copied(), 0
        if state is not None:
            self.iterations = state["iterations"]
            for name, weights in self.average.items():
                weights.copy_(state["average"][name])

    def iterate(self, progress: float) -> dict[str, float]:
        """One iteration of the learner; updates the average of the weights."""
        figures = self.learner.iterate(progress)
        self.iterations += 1
        rate = (DECAY + 1) / (self.iterations + DECAY)
        for name, weights in self.weights.items():
            own = self.average[name]
            own.lerp_(weights, rate) if own.is_floating_point() else own.copy_(weights)
        return figures

    def _copied(self) -> dict[str, torch.Tensor]:
        return {name: tensor.clone() for name, tensor in self.weights.items()}

    @property
    def greedy(self) -> bool:
        """Whether it plays greedily during training: for algorithms without a distribution."""
        return not self.parts.algorithm.learns_distribution

    def evaluated_policy(self) -> Policy:
        """The policy with averaged weights, in float32 and without improbable actions."""
        seat = replace(self.parts.seat, min_probability=self.parts.min_probability)
        return self._loaded(seat, self.snapshot())

    def policy(self) -> Policy:
        """The policy of training."""
        return self.learner.policy(greedy=self.greedy)

    def restart(self) -> None:
        """New weights and a new state of the optimizer, as for each best response of PSRO (Lanctot
        et al., 2017)."""
        parts = self.parts
        fresh = build_learner(parts.algorithm, parts.hyper, self.env, parts.build)
        self.learner.load_state_dict({**fresh.state_dict(), "frames": self.learner.frames})
        fresh.close()
        self.average, self.iterations = self._copied(), 0

    def load(self, state: State) -> Policy:
        """The policy of a snapshot; ValueError for weights that are not finite."""
        check_learned(self.parts.algorithm.name, {"learner": state})
        return self._loaded(self.parts.seat, state)

    def _loaded(self, seat: Seat, state: State) -> Policy:
        """A policy from a state, without drawing from torch's generator, so that runs do not depend
        on when policies are loaded."""
        with torch.random.fork_rng(devices=[]):
            return self.parts.algorithm.load(self.parts.hyper, seat, state, self.greedy)

    def snapshot(self) -> State:
        """The averaged weights, as a state for `load`."""
        return {"network": {name: tensor.clone() for name, tensor in self.average.items()}}

    def state_dict(self) -> State:
        """The state of the side with its opponents by game, without the pool."""
        return {
            "algorithm": self.parts.algorithm.name,
            "learner": self.learner.state_dict(),
            "average": self.average,
            "iterations": self.iterations,
            "simulator": simulator_tensors(self.simulator),
            "opponents": torch.from_numpy(self.opponents.policy.opponents.copy()),
            "idle": torch.from_numpy(self.env.idle.copy()),
            "rng": self.opponents.rng.bit_generator.state,
        }
