"""The cross-entropy method: a search over the weights of a policy network, without gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import nn
from torch.func import functional_call, vmap
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from pursuit.simulator.policy import Policy
from pursuit.validation import check
from train.algorithms.collector import Seen
from train.algorithms.cross_entropy_kernels import draw_actions, outputs_of
from train.algorithms.learner import Build, has_masks, no_actions
from train.environments.batch_env import BatchEnv
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import masked
from train.networks.layers import Convolutions, Hidden, IndexLayer
from train.networks.seat import Seat
from train.settings.algorithms import CrossEntropySettings
from train.tensors import StateDict


class CrossEntropy:
    """Rubinstein (1999); with annealed noise as in Szita and Lőrincz (2006).

    In each generation every candidate plays `num_games / population` whole episodes, all from the
    same starts, and a normal distribution with independent weights is fitted to the best ones.
    Candidates sample their actions, because at first nearly all greedy policies loop, so that their
    returns are equal.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        options: have the seed of the candidates.

    Attributes:
        network: its policy weights are searched; its value function is not used.
        mean, std: [weights] float32, the distribution.
        frames: environment steps, summed over games.
    """

    def __init__(self, settings: CrossEntropySettings, env: BatchEnv, options: Build) -> None:
        self.settings, self.env, self.frames = settings, env, 0
        self.network = network = network_of(settings, env.player, options)
        self._policy = nn.Sequential(network.policy_trunk, network.policy_head)
        self._searched = dict(self._policy.named_parameters())
        self.generator = torch.Generator().manual_seed(options.seed)
        self.mean = torch.zeros_like(parameters_to_vector(self._searched.values()).detach())
        self.std = torch.full_like(self.mean, settings.initial_std)
        self._write_mean()

    def _write_mean(self) -> None:
        with torch.no_grad():
            vector_to_parameters(self.mean, self._searched.values())

    def iterate(self, progress: float) -> dict[str, float]:
        """One generation."""
        settings, population = self.settings, self.settings.population
        noise = torch.randn(population, len(self.mean), generator=self.generator)
        candidates = self.mean + self.std * noise
        returns = self.play(candidates)
        elite = candidates[returns.topk(round(population * settings.elite_share)).indices]
        self.mean = elite.mean(dim=0)
        self.std = elite.std(dim=0) + linear(settings.extra_std, 0.0, progress)
        self._write_mean()
        return {
            "return_best": float(returns.max()),
            "return_mean": float(returns.mean()),
            "weight_std": float(self.std.mean()),
        }

    @torch.no_grad()
    def play(self, candidates: torch.Tensor) -> torch.Tensor:
        """[population] float32: the mean episode returns of candidates [population, weights]."""
        env, simulator, population = self.env, self.env.simulator, len(candidates)
        each = env.num_games // population
        if not self.frames:
            env.reset_games()
        simulator.set_state(simulator.get_state(np.arange(env.num_games) % each))
        seen: Seen = env.reset()
        outputs = self._outputs(candidates, each)
        running, returns = np.arange(env.num_games), np.zeros(env.num_games, np.float32)
        actions, masks = no_actions(env), has_masks(env)
        while len(running):
            chosen = torch.from_numpy(running)
            output = outputs(seen["observation"], chosen)
            if self.network.log_std is not None:  # continuous
                distribution = self.network.distribution(output)
                actions[chosen] = distribution.action(distribution.draw())
            else:
                logits = masked(output, seen[ACTION_MASK][chosen] if masks else None)
                chances = torch.rand(len(running))
                draw_actions(logits.numpy(), chances.numpy(), running, actions.numpy())
            seen = env.step_episodes(actions, chosen)
            returns += seen["reward"].numpy()[:, 0]  # 0 where an episode has ended
            self.frames += len(running)
            running = running[~seen["done"].numpy()[running, 0]]
        return torch.from_numpy(returns).reshape(population, each).mean(dim=1)

    def _outputs(
        self, candidates: torch.Tensor, each: int
    ) -> Callable[[torch.Tensor, torch.Tensor], torch.Tensor]:
        """A function of observations [games, ...] and running games [n] int64, which returns the
        outputs [n, actions] of the policy heads; `each` games in turn belong to a candidate."""
        trunk, population = self.network.policy_trunk, len(candidates)
        parts = torch.split(candidates, [one.numel() for one in self._searched.values()], dim=1)
        pairs = zip(self._searched.items(), parts, strict=True)
        weights = {name: part.reshape(-1, *one.shape) for (name, one), part in pairs}

        def convolved(observation: torch.Tensor, running: torch.Tensor) -> torch.Tensor:
            inputs = trunk.prepare(observation)
            batch = inputs.reshape(population, each, *inputs.shape[1:])
            output = vmap(functional_call, (None, 0, 0))(self._policy, weights, batch)
            return output.flatten(0, 1)[running]

        layer = trunk.first
        if isinstance(layer, Convolutions):
            return convolved
        index = isinstance(layer, IndexLayer)
        first, first_bias, second, *others = [*weights.values()]
        layers = (first if index else first.mT, first_bias, second.mT, *others)
        arrays = tuple(np.ascontiguousarray(part.numpy()) for part in layers)
        rows = layer.rows.numpy() if isinstance(layer, IndexLayer) else None
        tanh = isinstance(trunk.rest[0], nn.Tanh)
        hidden = np.empty((2, first_bias.shape[1]), np.float32)

        def dense(observation: torch.Tensor, running: torch.Tensor) -> torch.Tensor:
            observed = observation if index else trunk.prepare(observation)
            output = torch.empty(len(running), others[-1].shape[1])
            games = (observed.numpy(), rows, running.numpy())
            outputs_of(*games, arrays, tanh, hidden, output.numpy())
            return output

        return dense

    def policy(self, greedy: bool = True) -> Policy:
        """The policy of the mean weights."""
        return self.env.player.policy(self.network, greedy)

    def state_dict(self) -> StateDict:
        """The distribution, its random state and the frames; the mean also as a network."""
        return {
            "network": self.network.state_dict(),
            "mean": self.mean,
            "std": self.std,
            "generator": self.generator.get_state(),
            "frames": self.frames,
        }

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state; the next generation starts new episodes."""
        self.network.load_state_dict(state["network"])
        self.mean, self.std = state["mean"], state["std"]
        self.generator.set_state(state["generator"])
        self.frames = state["frames"]
        self.env.resume = False

    def start_from(self, state: StateDict) -> None:
        """As `Learner`: the mean of the distribution."""
        self.network.load_state_dict(state["network"])
        self.mean = parameters_to_vector(self._searched.values()).detach().clone()

    def close(self) -> None:
        """Nothing to release."""


def check_seat(settings: CrossEntropySettings, seat: Seat) -> None:
    """ValueError for a network that `vmap` does not support."""
    features = seat.features
    check(
        features.network == "" and features.kind != "grid",
        f"network={features.network or 'planning'!r}; cross_entropy supports mlp and convolutions",
    )


def network_of(settings: CrossEntropySettings, seat: Seat, options: Build) -> ActorCritic:
    """A new policy network for the seat; its value function is not used."""
    hidden = Hidden(settings.width, settings.activation, form="dense")
    action_std = settings.action_std if seat.continuous else None
    return ActorCritic(seat.features, seat.num_actions, hidden, action_std=action_std)
