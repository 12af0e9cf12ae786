"""One side of self-play: its games, its learner, and its opponents."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.batch import Batch
from pursuit.simulator.policy import Policy
from scripted_agents.games.simulator import OpponentTables
from train.algorithms.learner import Learner
from train.algorithms.registry import Algorithm, Build, build_learner
from train.environments.hooks import EpisodeHook
from train.networks.seat import Seat
from train.runs.folder import check_learned, game_digest
from train.runs.training_state import restore_simulator, simulator_tensors, start_weights
from train.self_play.pool import PoolPolicy
from train.settings.algorithms import Hyperparameters
from train.tensors import StateDict

if TYPE_CHECKING:  # torch is slow to import
    from train.environments.batch_env import BatchEnv, Expert

DECAY = 10
"""The average of the weights has terms proportional to iteration**DECAY: about the last tenth of
the iterations so far. Longer averages are nearer to mixed equilibria, shorter ones to pure ones."""


LIKELY = 0.05
"""The usual `min_probability` with up to 5 moves; with more it is 0.25 / moves."""


def usual_least(actions: int) -> float:
    """The usual `min_probability` in self-play with so many moves."""
    return min(LIKELY, 0.25 / actions)


class Opponents(EpisodeHook):
    """Draws an opponent of each other role from its pool for every episode, and records the scores.

    Args:
        simulator: the games.
        game: that of all sides, which scores episodes.
        role: of the learner.
        others: the other roles.
        seed: of the sampling.
        steps: approximate number of steps between updates of an opponent that learns.

    Attributes:
        policies: by role the policy of its agents; its `opponents` are the members by game.
        shares: by role the sampling probabilities of the members of its pool.
        rng: of the sampling.
    """

    def __init__(
        self,
        simulator: Batch[Any],
        game: Any,
        role: str,
        others: Sequence[str],
        seed: int,
        steps: int = 1,
    ) -> None:
        super().__init__()
        self.simulator, self.game, self.role = simulator, game, role
        pool: Any = None  # set once all sides are constructed
        count = simulator.num_games
        self.policies = {other: PoolPolicy(pool, count, steps) for other in others}
        self.rng = np.random.default_rng(seed)
        self.shares: dict[str, NDArray[np.float64]] = {other: np.ones(1) for other in others}

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Draw the opponents of each of these games."""
        for role, shares in self.shares.items():
            drawn = self.rng.choice(len(shares), size=len(games), p=shares)
            self.policies[role].opponents[games] = drawn

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Record the learner's scores against the opponents of these games."""
        scores = self.game.scores(self.simulator, self.role, games)
        for policy in self.policies.values():
            policy.pool.note(policy.opponents[games], scores)

    def opponent_tables(self) -> OpponentTables | None:
        """As of `EpisodeHook`, where there is one opponent and all of its pool have tables."""
        if len(self.policies) > 1 or not self.simulator.PLAYS_TABLES:
            return None
        ((other, policy),) = self.policies.items()
        cumulative = policy.all_tables(self.simulator.task)
        if cumulative is None:
            return None
        return OpponentTables(cumulative, policy.opponents, self.shares[other])

    def note_episodes(self, members: NDArray[np.int64], returns: NDArray[np.float64]) -> None:
        """Record the learner's scores in these episodes."""
        (policy,) = self.policies.values()
        policy.pool.note(members, self.game.scores_of_returns(self.role, returns))


@dataclass(frozen=True)
class SideParts:
    """The parts of one side.

    Attributes:
        seat: the role that learns, in the games.
        algorithm, hyper, build: the algorithm, its hyperparameters, and its build options.
        game: that of all sides (`train.evaluation.sides.Sides`).
        training: the task of the training games, with short episodes.
        min_probability: of actions of the evaluated policy.
        average: whether the averaged weights are evaluated, saved and pooled, or the last ones.
        source: the folder of the policy whose weights it starts from; None for new weights.
        expert: (its frames) -> the policy that it imitates; None for none.
    """

    seat: Seat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    game: Any
    training: Any
    min_probability: float
    average: bool = True
    source: str | None = None
    expert: Callable[[int], Expert | None] = lambda frames: None

    def games(
        self, number: int, others: Sequence[str], frames: int = 0
    ) -> tuple[BatchEnv, Opponents]:
        """The training environment of the side with this number, whose learner has these frames,
        and its opponents."""
        game, seat, members = self.game, self.seat, self.seat.members
        count, steps = self.hyper.num_games, self.hyper.rollout_steps
        seed, first = self.build.seed, number * 2**20
        batch = game.world.BATCH(self.training, count // members, seed, first, auto_restart=False)
        opponents = Opponents(batch, game, seat.agent, others, 2 * seed + number, steps)
        policies = [opponents.policies.get(role) for role in game.by_agent]
        how = (opponents, members, game.scale(seat.agent), game.bounded)
        env = self.algorithm.env_form(batch, seat, policies, *how)
        env.expert = self.expert(frames)
        return env, opponents


class Side:
    """One role that learns.

    Args:
        parts: of the side.
        number: index of the role, for different starts of all roles with the same seed.
        others: the other roles.
        state: of `state_dict`; None for a new side.

    Attributes:
        parts, env, learner: of this role.
        opponents: its opponents.
        weights: of the policy of the learner, by name.
        average: average of the weights over iterations, by name, with polynomial decay (Shamir and
            Zhang, 2013). Two learners cycle around an equilibrium; the average lies inside.
        iterations: in the average.
    """

    def __init__(
        self, parts: SideParts, number: int, others: Sequence[str], state: StateDict | None = None
    ) -> None:
        self.parts = parts
        frames = 0 if state is None else state["learner"]["frames"]
        self.env, self.opponents = parts.games(number, others, frames)
        self.simulator = self.env.simulator
        if state is not None:
            check_learned(parts.algorithm.name, state, parts.seat)
        # Before the first iteration no game has begun, and no opponent is drawn.
        if state is not None and state["learner"]["frames"] > 0:
            # before the collector of the learner reads the environment
            restore_simulator(self.simulator, state["simulator"])
            for role, pool in self.opponents.policies.items():
                pool.opponents[:] = state["opponents"][role].numpy()
            self.opponents.rng.bit_generator.state = state["rng"]
            self.env.idle[:] = state["idle"].numpy()
            self.env.resume = True
        self.learner: Learner = build_learner(parts.algorithm, parts.hyper, self.env, parts.build)
        if state is None:
            start_weights(self.learner, parts.hyper, parts.source)
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

    def policy_with(self, average: bool, least: float) -> Policy:
        """The policy with the averaged or the last weights, which does not play actions of a
        probability below `least`."""
        return self.evaluated(self.snapshot(average), least)

    def evaluated(self, state: StateDict, least: float | None = None) -> Policy:
        """The policy of saved weights as it is evaluated: without actions of a probability below
        `least` (None: that of the settings)."""
        least = self.parts.min_probability if least is None else least
        seat: Any = self.parts.seat
        return self._loaded(replace(seat, min_probability=least), state)

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

    def load(self, state: StateDict) -> Policy:
        """The policy of a snapshot; ValueError for weights that are not finite."""
        named = {"learner": state, "game": game_digest(self.parts.seat)}
        check_learned(self.parts.algorithm.name, named, self.parts.seat)
        return self._loaded(self.parts.seat, state)

    def _loaded(self, seat: Any, state: StateDict) -> Policy:
        """A policy from a state, without drawing from torch's generator, so that runs do not depend
        on when policies are loaded."""
        with torch.random.fork_rng(devices=[]):
            return self.parts.algorithm.load(self.parts.hyper, seat, state, self.greedy)

    def snapshot(self, average: bool | None = None) -> StateDict:
        """The averaged or the last weights as a state for `load`, by default as in the settings."""
        chosen = self.parts.average if average is None else average
        weights = self.average if chosen else self.weights
        return {"network": {name: tensor.clone() for name, tensor in weights.items()}}

    def state_dict(self) -> StateDict:
        """The state of the side with its opponents by game, without the pool."""
        return {
            "algorithm": self.parts.algorithm.name,
            "game": game_digest(self.parts.seat),
            "learner": self.learner.state_dict(),
            "average": self.average,
            "iterations": self.iterations,
            "simulator": simulator_tensors(self.simulator),
            "opponents": {
                role: torch.from_numpy(policy.opponents.copy())
                for role, policy in self.opponents.policies.items()
            },
            "idle": torch.from_numpy(self.env.idle.copy()),
            "rng": self.opponents.rng.bit_generator.state,
        }
