"""One side of self-play: its games, its learner, and its opponents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.simulator.batch import Batch
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents.games.episodes import return_range
from scripted_agents.games.simulator import GameSimulator, GameTask, OpponentTables
from scripted_agents.games.small_game import KEPT
from train.algorithms.learner import Learner
from train.algorithms.registry import Algorithm, Build, build_learner
from train.environments.hooks import EpisodeHook
from train.evaluation.games import all_caught
from train.networks.policy import MazeSeat
from train.networks.small_game_policy import SmallGameSeat
from train.runs.folder import check_learned, game_digest
from train.runs.training_state import restore_simulator, simulator_tensors
from train.self_play.pool import OpponentPool, PoolPolicy
from train.settings.algorithms import Hyperparameters
from train.tensors import State

if TYPE_CHECKING:  # TorchRL and TensorDict, which are slow to import; only training needs them
    from train.environments.simulator_env import SimulatorEnv

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
        role: of the learner.
        others: the other roles.
        discount: of the scores.
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
        role: str,
        others: Sequence[str],
        discount: float,
        seed: int,
        steps: int = 1,
    ) -> None:
        super().__init__()
        self.simulator, self.role, self.discount = simulator, role, discount
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
        if isinstance(self.simulator, GameSimulator):
            returns = self.simulator.returns[games]
            scores = game_scores(self.simulator.task, self.role, returns)
        else:
            assert isinstance(self.simulator, Simulator)
            scores = maze_scores(self.simulator, self.role, games, self.discount)
        for policy in self.policies.values():
            note(policy.pool, policy.opponents[games], scores)

    def opponent_tables(self) -> OpponentTables | None:
        """As of `EpisodeHook`, where there is one opponent and all of its pool have tables."""
        if len(self.policies) > 1 or not isinstance(self.simulator, GameSimulator):
            return None
        ((other, policy),) = self.policies.items()
        cumulative = policy.all_tables(self.simulator.task)
        if cumulative is None:
            return None
        return OpponentTables(cumulative, policy.opponents, self.shares[other])

    def note_episodes(self, members: NDArray[np.int64], returns: NDArray[np.float64]) -> None:
        """Record the learner's scores in these episodes."""
        assert isinstance(self.simulator, GameSimulator)
        (policy,) = self.policies.values()
        note(policy.pool, members, game_scores(self.simulator.task, self.role, returns))


def note(pool: OpponentPool, members: NDArray[np.int64], scores: NDArray[np.float64]) -> None:
    """Record scores [n] against members [n] of a pool."""
    for member in np.unique(members).tolist():
        pool.note(member, scores[members == member])


def maze_scores(
    simulator: Simulator, role: str, games: NDArray[np.bool_], discount: float
) -> NDArray[np.float64]:
    """[n] the scores in [0, 1] of a role in the games of a mask, which have just ended.

    The score of an evader is 1 - discount ** steps, its share of the highest discounted return;
    that of a chaser is discount ** steps. With exits a chaser scores 1 for a game that ends by a
    capture, 0 for one that ends by an escape, 1/2 if time is up.
    """
    task = simulator.task
    rounds = -(-simulator.steps[games] // task.steps_per_round)
    left = discount ** rounds.astype(np.float64)
    if task.most_exits:  # the escapes of the last step, as `Payoffs` counts games to their end
        won = all_caught(simulator)[games].astype(np.float64)
        left = np.where(simulator.terminated[games], won, 0.5)
    return np.asarray(left if role == "chaser" else 1.0 - left)


def game_scores(task: GameTask, player: str, returns: NDArray[np.float64]) -> NDArray[np.float64]:
    """[n] the scores in [0, 1] of a player in episodes with these returns [n, players].

    In a zero-sum game of two the return as a share of its range within the time limit, so that they
    also differ where one player never has a return above 0. In other games 1 for a return above the
    mean of all players, 0 for one below it, 1/2 for one equal to it.
    """
    own = returns[:, task.seat(player)]
    if task.game.zero_sum:
        low, high = range_of_returns(task, player)
        return np.clip((own - low) / max(high - low, 1e-9), 0.0, 1.0)
    lead = own - returns.mean(axis=1)
    return np.asarray(0.5 + 0.5 * np.sign(np.where(np.abs(lead) < 1e-9, 0.0, lead)))


@lru_cache(maxsize=2 * KEPT)
def range_of_returns(task: GameTask, player: str) -> tuple[float, float]:
    """The least and the largest expected return of a player within the time limit, whatever all
    play, without discount."""
    return return_range(task.game, player, 1.0, task.max_steps)


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
        average: whether the averaged weights are evaluated, saved and pooled, or the last ones.
    """

    seat: MazeSeat | SmallGameSeat
    algorithm: Algorithm
    hyper: Hyperparameters
    build: Build
    discount: float
    scale: float
    training: Task | GameTask
    min_probability: float
    average: bool = True

    def games(self, number: int, others: Sequence[str]) -> tuple[SimulatorEnv, Opponents]:
        """The training environment of the side with this number, and its opponents."""
        from train.environments.simulator_env import SimulatorEnv

        count, steps = self.hyper.num_games, getattr(self.hyper, "rollout_steps", 1)
        seed, first = self.build.seed, number * 2**20
        drawn = (self.seat.agent, others, self.discount, 2 * seed + number, steps)
        task, seat, members = self.training, self.seat, self.seat.members
        small = isinstance(task, GameTask)
        form: Any = GameSimulator if small else Simulator
        games = form(task, count // members, seed, first, auto_restart=False)
        opponents = Opponents(games, *drawn)
        roles = task.agent_names if isinstance(task, GameTask) else task.seat_roles
        policies = [opponents.policies.get(role) for role in roles]
        bounded = small and self.discount == 1.0
        how = (opponents, members, self.scale, bounded)
        return SimulatorEnv(games, seat, policies, *how), opponents


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
        self, parts: SideParts, number: int, others: Sequence[str], state: State | None = None
    ) -> None:
        self.parts = parts
        self.env, self.opponents = parts.games(number, others)
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
        """The policy with averaged weights (or the last ones, by the settings), in float32 and
        without improbable actions."""
        return self.policy_with(self.parts.average, self.parts.min_probability)

    def policy_with(self, average: bool, least: float) -> Policy:
        """The policy with the averaged or the last weights, which does not play actions of a
        probability below `least`."""
        seat: Any = self.parts.seat
        seat = replace(seat, min_probability=least)
        return self._loaded(seat, self.snapshot(average))

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
        named = {"learner": state, "game": game_digest(self.parts.seat)}
        check_learned(self.parts.algorithm.name, named, self.parts.seat)
        return self._loaded(self.parts.seat, state)

    def _loaded(self, seat: Any, state: State) -> Policy:
        """A policy from a state, without drawing from torch's generator, so that runs do not depend
        on when policies are loaded."""
        with torch.random.fork_rng(devices=[]):
            return self.parts.algorithm.load(self.parts.hyper, seat, state, self.greedy)

    def snapshot(self, average: bool | None = None) -> State:
        """The averaged or the last weights as a state for `load`, by default as in the settings."""
        chosen = self.parts.average if average is None else average
        weights = self.average if chosen else self.weights
        return {"network": {name: tensor.clone() for name, tensor in weights.items()}}

    def state_dict(self) -> State:
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
