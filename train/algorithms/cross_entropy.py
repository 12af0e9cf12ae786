"""The cross-entropy method on the weights of a network, all candidates in one batch of games."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch.func import functional_call, vmap
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from curricula import linear
from train.algorithms.rollouts import draw
from train.environment import SimulatorEnv
from train.hyperparameters import CrossEntropySettings
from train.learned_policy import LearnedPolicy
from train.networks import ActorCritic


class CrossEntropy:
    """Rubinstein (1999); with noise that is annealed, Szita and Lőrincz (2006).

    In each generation every candidate plays `num_games / population` episodes to their end, all
    from the same starts, and a
    normal distribution with independent weights is fitted to the best. Candidates draw their
    actions: nearly all greedy ones run in circles at first, with nothing to choose between them.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: its policy's weights are searched; the value is not used.
        seed: of the candidates.

    Attributes:
        mean, std: [weights] float32, the distribution.
    """

    stochastic = True

    def __init__(
        self, settings: CrossEntropySettings, env: SimulatorEnv, network: ActorCritic, seed: int
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
        env, population = self.env, len(candidates)
        games = env.simulator.num_games
        each = games // population
        weights, taken = {}, 0
        for name, weight in self._named.items():
            size = weight.numel()
            weights[name] = candidates[:, taken : taken + size].reshape(population, *weight.shape)
            taken += size
        trunk, head = self.network.policy_trunk, self.network.policy_head

        def logits(weights: dict[str, torch.Tensor], prepared: torch.Tensor) -> torch.Tensor:
            of = {
                part: {n[len(part) + 1 :]: w for n, w in weights.items() if n.startswith(part)}
                for part in ("policy_trunk", "policy_head")
            }
            hidden = functional_call(trunk, of["policy_trunk"], (prepared,))
            found: torch.Tensor = functional_call(head, of["policy_head"], (hidden,))
            return found

        batched = vmap(logits)
        if not self.frames:
            self._share_starts(population, each)
        now = env.reset()
        running = torch.ones(games, dtype=torch.bool)
        returns = torch.zeros(games)
        while running.any():
            prepared = trunk.prepare(now["observation"])
            found = batched(weights, prepared.reshape(population, each, *prepared.shape[1:]))
            actions = draw(found.log_softmax(dim=-1))
            alive = running.nonzero().squeeze(-1)
            now = env.step_episodes(actions.reshape(games), alive)
            returns[running] += now["reward"][running, 0]
            self.frames += len(alive)
            running &= ~now["done"][:, 0]
        return returns.reshape(population, each).mean(dim=1)

    def _share_starts(self, population: int, each: int) -> None:
        """Give every candidate's games the same random streams, so that all get the same starts."""
        simulator = self.env.simulator
        simulator.reset()
        state = simulator.get_state()
        shared = {
            name: np.concatenate([array[:each]] * population)
            for name, array in vars(state).items()
            if name in ("rows", "streams")
        }
        simulator.set_state(replace(state, **shared))

    def policy(self, greedy: bool = True) -> LearnedPolicy:
        """That of the mean."""
        task, seat = self.env.simulator.task, self.env.seat
        return LearnedPolicy(self.network, task, task.agent_names[seat], self.env.encoding, greedy)

    def state_dict(self) -> dict[str, Any]:
        """The distribution, the random state and the frames; and the mean as a network."""
        return {
            "network": self.network.state_dict(),
            "mean": self.mean,
            "std": self.std,
            "generator": self.generator.get_state(),
            "frames": self.frames,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        self.network.load_state_dict(state["network"])
        self.mean, self.std = state["mean"], state["std"]
        self.generator.set_state(state["generator"])
        self.frames = state["frames"]
        self.env.resume = False

    def close(self) -> None:
        """Nothing is held open."""
