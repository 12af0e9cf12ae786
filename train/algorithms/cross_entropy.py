"""The cross-entropy method on the weights of a network, all candidates in one batch of games."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.func import functional_call, vmap
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from curricula import linear
from pursuit.compilation.compiled import compiled
from pursuit.rules import draw_uniform, next_uniform
from pursuit.simulator.policy import Policy
from train.algorithms.exploration import exploration_streams
from train.algorithms.learner import Build
from train.environments.lockstep import LockstepEnv
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import SquashedNormal
from train.networks.layers import Convolutions, Flat, Hidden, IndexLayer
from train.networks.masks import masked
from train.networks.policy import Player
from train.settings.algorithms import CrossEntropySettings


@compiled
def act_on_index(
    observed: Any, table: Any, layers: Any, tanh: bool, streams: Any, running: Any, allowed: Any,
    actions: Any, hidden: Any,
) -> None:  # fmt: skip
    """Drawn actions of the running games on "index", each by its own candidate's network.

    Args:
        observed: [games, entities + 1], the observation.
        table: [numbers] int64, the row of the first layer that each number of an observation names;
            the last one is no row.
        layers: weights [population, inputs, outputs] and biases [population, outputs] of the three
            layers in turn.
        tanh: or ReLU.
        streams: [games, 1] uint64.
        running: [games] bool; the actions of the others stay as they are.
        allowed: [games, actions] bool; no other is drawn.
        actions: [games] int32, out.
        hidden: [2, width] float32, scratch.
    """
    first, first_bias, second, second_bias, last, last_bias = layers
    each = running.shape[0] // first.shape[0]
    width, nothing = hidden.shape[1], table[table.shape[0] - 1]
    for game in range(running.shape[0]):
        if not running[game]:
            continue
        own = game // each
        for unit in range(width):
            hidden[0, unit] = first_bias[own, unit]
            hidden[1, unit] = second_bias[own, unit]
        for entity in range(observed.shape[1]):
            row = table[observed[game, entity]]
            if row != nothing:
                for unit in range(width):
                    hidden[0, unit] += first[own, row, unit]
        for inner in range(width):
            value = hidden[0, inner]
            value = np.tanh(value) if tanh else max(value, np.float32(0.0))
            for unit in range(width):
                hidden[1, unit] += value * second[own, inner, unit]
        for unit in range(width):
            value = hidden[1, unit]
            hidden[1, unit] = np.tanh(value) if tanh else max(value, np.float32(0.0))
        best, most = 0, -np.inf
        for action in range(last.shape[2]):
            logit = np.float64(last_bias[own, action])
            for unit in range(width):
                logit += hidden[1, unit] * last[own, unit, action]
            # The largest logit less log E, E exponential, is a draw from the softmax.
            logit -= np.log(-np.log1p(-next_uniform(streams[game], 0)))
            if logit > most and allowed[game, action]:
                best, most = action, logit
        actions[game] = best


class Candidates:
    """Many policies of one architecture, as batched matrix products.

    `vmap` does the same at several times the cost on networks of this size; it is kept for the
    convolutions. First layers that it cannot take (planning, and users' own) run one by one.

    Args:
        network: the architecture, and the standard deviations of continuous actions.
        named: its policy's weights by name, in the order in which `flat` lists them.
        flat: [population, weights] float32.
    """

    def __init__(
        self, network: ActorCritic, named: Mapping[str, torch.Tensor], flat: torch.Tensor
    ) -> None:
        self.trunk, self.population = network.policy_trunk, len(flat)
        self._log_std = None if network.log_std is None else network.log_std.detach()
        weights, taken = {}, 0
        for name, weight in named.items():
            size = weight.numel()
            weights[name] = flat[:, taken : taken + size].reshape(self.population, *weight.shape)
            taken += size
        first = "policy_trunk.first."
        self._first = {
            name.removeprefix(first): weight
            for name, weight in weights.items()
            if name.startswith(first)
        }
        if isinstance(self.trunk.first, IndexLayer):
            matrix = self._first["weight"][:, : self.trunk.first.num_rows]
            self._matrix, self._bias = matrix, self._first["bias"][:, None]
        elif isinstance(self.trunk.first, Flat):
            self._matrix = self._first["linear.weight"].mT
            self._bias = self._first["linear.bias"][:, None]
        self._layers = [
            (weights[f"{name}.weight"].mT, weights[f"{name}.bias"][:, None])
            for name in ("policy_trunk.rest.1", "policy_head")
            if f"{name}.weight" in weights
        ]
        if isinstance(self.trunk.first, IndexLayer):
            self._table = self.trunk.first.rows.numpy()
            self._for_kernel = tuple(
                np.ascontiguousarray(part.numpy())
                for matrix, bias in ((self._matrix, self._bias), *self._layers)
                for part in (matrix, bias[:, 0])
            )
            self._hidden = np.zeros((2, self._bias.shape[-1]), dtype=np.float32)

    def act(
        self,
        observation: NDArray[Any],
        streams: NDArray[np.uint64],
        running: NDArray[np.bool_],
        allowed: NDArray[np.bool_],
        actions: NDArray[Any],
    ) -> None:
        """Draw actions for the `running` games [games] into `actions`: [games] or [games, numbers].

        Only those are drawn that are `allowed` [games, actions].

        Only where the observation is an index does it pay to leave out the games that have ended.
        """
        if isinstance(self.trunk.first, IndexLayer):
            act_on_index(
                observation,
                self._table,
                self._for_kernel,
                isinstance(self.trunk.rest[0], nn.Tanh),
                streams,
                running,
                allowed,
                actions,
                self._hidden,
            )
            return
        every = self.logits(torch.from_numpy(observation))
        if self._log_std is not None:
            noise = torch.from_numpy(_normal(streams, every.shape[1]))
            drawn = every + self._log_std.exp() * noise
            actions[:] = SquashedNormal.action(drawn).numpy()
            return
        logits = masked(every, torch.from_numpy(allowed)).numpy()
        uniform = _uniform(streams, logits.shape[1])
        actions[:] = (logits - np.log(-np.log1p(-uniform))).argmax(axis=1)

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[games, actions] from [games, ...]; the games are shared out among the population.

        Of continuous actions the means, before tanh.
        """
        prepared = self.trunk.prepare(observation)
        batch = prepared.reshape(self.population, -1, *prepared.shape[1:])
        first = self.trunk.first

        def run(weights: dict[str, torch.Tensor], inputs: torch.Tensor) -> torch.Tensor:
            found: torch.Tensor = functional_call(first, weights, (inputs,))
            return found

        if isinstance(first, Convolutions):
            hidden = vmap(run)(self._first, batch)
        elif isinstance(first, IndexLayer | Flat):
            hidden = torch.baddbmm(self._bias, batch, self._matrix)
        else:
            each = [
                run({name: weight[number] for name, weight in self._first.items()}, inputs)
                for number, inputs in enumerate(batch)
            ]
            hidden = torch.stack(each)
        for matrix, bias in self._layers:
            for activation in list(self.trunk.rest)[:1]:  # none of a user's network
                hidden = activation(hidden)
            hidden = torch.baddbmm(bias, hidden, matrix)
        return hidden.flatten(0, 1)


def _uniform(streams: NDArray[np.uint64], count: int) -> NDArray[np.float64]:
    """[games, count] in [0, 1)."""
    numbers = np.empty((len(streams), count))
    for column in range(count):
        draw_uniform(streams, 0, numbers[:, column])
    return numbers


def _normal(streams: NDArray[np.uint64], count: int) -> NDArray[np.float32]:
    """[games, count], standard normal (Box and Muller, 1958)."""
    uniform = _uniform(streams, 2 * count)
    lengths = np.sqrt(-2.0 * np.log1p(-uniform[:, :count]))
    return (lengths * np.cos(2.0 * np.pi * uniform[:, count:])).astype(np.float32)


class CrossEntropy:
    """Rubinstein (1999); with noise that is annealed, Szita and Lőrincz (2006).

    In each generation every candidate plays `num_games / population` episodes to their end, all
    from the same starts, and a normal distribution with independent weights is fitted to the best.
    Candidates draw their actions: nearly all greedy ones run in circles at first, with nothing to
    choose between them. The greedy policy of the mean is good only once the search has narrowed.

    Args:
        settings: the hyperparameters.
        env: the games, stepped without tensors.
        network: its policy's weights are searched; the value is not used.
        seed: of the candidates.

    Attributes:
        mean, std: [weights] float32, the distribution.
    """

    def __init__(
        self, settings: CrossEntropySettings, env: LockstepEnv, network: ActorCritic, seed: int
    ) -> None:
        self.settings, self.env, self.network, self.frames = settings, env, network, 0
        self._named = {
            name: weight
            for name, weight in network.named_parameters()
            if name.startswith(("policy_trunk", "policy_head"))
        }
        self.generator = torch.Generator().manual_seed(seed)
        self.mean = torch.zeros_like(parameters_to_vector(self._named.values()).detach())
        self.std = torch.full_like(self.mean, settings.initial_std)
        self._write_mean()
        env.hook.copies = settings.population
        self._streams = exploration_streams(env.simulator, seed)
        self._actions = env.action_spec.zero().numpy()

    def _write_mean(self) -> None:
        with torch.no_grad():
            vector_to_parameters(self.mean, self._named.values())

    def iterate(self, progress: float) -> dict[str, float]:
        """One generation."""
        settings, population = self.settings, self.settings.population
        noise = torch.randn(population, len(self.mean), generator=self.generator)
        candidates = self.mean + self.std * noise
        returns = self.play(candidates)
        elite = candidates[returns.topk(round(population * settings.elite_share)).indices]
        self.mean = elite.mean(dim=0)
        extra = linear(settings.extra_std, 0.0, progress)
        self.std = elite.std(dim=0) + extra
        self._write_mean()
        return {
            "return_best": float(returns.max()),
            "return_mean": float(returns.mean()),
            "weight_std": float(self.std.mean()),
        }

    @torch.no_grad()
    def play(self, candidates: torch.Tensor) -> torch.Tensor:
        """[population] float32: the mean episode return of each of [population, weights]."""
        env, population, games = self.env, len(candidates), self.env.num_games
        network = Candidates(self.network, self._named, candidates)
        if not self.frames or env.carries_over:
            # The same random streams for every candidate: the same starts, while no episode's
            # start depends on how the last one ended.
            env.share_starts(games // population)
        env.restart()
        running = np.ones(games, dtype=bool)
        returns = np.zeros(games, dtype=np.float32)
        while running.any():
            allowed = env.masks()[:, 0]
            network.act(env.observe(), self._streams, running, allowed, self._actions)
            ending = env.advance(self._actions, running)
            self.frames += int(running.sum())
            if ending.any():
                returns[ending] = env.finished_returns[-1]
                running &= ~ending
        return torch.from_numpy(returns).reshape(population, -1).mean(dim=1)

    def policy(self, greedy: bool = True) -> Policy:
        """That of the mean."""
        return self.env.player.policy(self.network, greedy)

    def state_dict(self) -> dict[str, Any]:
        """The distribution, the random state and the frames; and the mean as a network."""
        return {
            "network": self.network.state_dict(),
            "mean": self.mean,
            "std": self.std,
            "generator": self.generator.get_state(),
            "streams": torch.from_numpy(self._streams.view(np.int64)),
            "frames": self.frames,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        self.network.load_state_dict(state["network"])
        self.mean, self.std = state["mean"], state["std"]
        self.generator.set_state(state["generator"])
        self._streams[:] = state["streams"].numpy().view(np.uint64)
        self.frames = state["frames"]
        self.env.resume = False

    def close(self) -> None:
        """Nothing is held open."""


def network_of(settings: CrossEntropySettings, player: Player, how: Build) -> ActorCritic:
    """A policy of what the player observes, with fresh weights; its value is not used."""
    hidden = Hidden(settings.width, settings.activation, form="dense")
    action_std = settings.action_std if player.continuous else None
    return ActorCritic(player.features, player.num_actions, hidden, action_std=action_std)


def build(settings: CrossEntropySettings, env: LockstepEnv, how: Build) -> CrossEntropy:
    """The learner over its games."""
    return CrossEntropy(settings, env, network_of(settings, env.player, how), how.seed)
