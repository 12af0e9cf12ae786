"""PPO of Stable-Baselines3, with its own loop. It needs the extra `sb3`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete

from train.algorithms.learner import Build, HasState, LearnedNetwork
from train.environments.vector_env import LearnerVectorEnv
from train.networks.flat import FlatInputs, FlatNetwork
from train.networks.seat import Seat
from train.settings.algorithms import LibraryPPOSettings
from train.tensors import StateDict

LOGGED = {
    "train/policy_gradient_loss": ("loss_objective", 1.0),
    "train/value_loss": ("loss_critic", 1.0),
    "train/entropy_loss": ("entropy", -1.0),
    "train/approx_kl": ("kl_approx", 1.0),
    "train/clip_fraction": ("clip_fraction", 1.0),
}
"""What the library logs: our names, with factors."""


class StableBaselinesNetwork(torch.nn.Module):
    """A Stable-Baselines3 policy as the network of one of our policies."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def logits(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., actions]: of the distribution, or the action values of DQN."""
        shape = observation.shape[: -len(self.policy.observation_space.shape)]
        flat = observation.reshape(-1, *self.policy.observation_space.shape)
        if hasattr(self.policy, "q_net"):
            logits = self.policy.q_net(flat)
        else:
            logits = self.policy.get_distribution(flat).distribution.logits
        return logits.reshape(*shape, -1)


class NumpyStream:
    """The state of NumPy's global generator, from which the library draws its minibatches."""

    def state_dict(self) -> StateDict:
        """As plain values."""
        _, key, place, has_gauss, gauss = np.random.get_state()  # noqa: NPY002
        numbers = torch.from_numpy(np.asarray(key).astype(np.int64))
        return {"key": numbers, "place": place, "has_gauss": has_gauss, "gauss": gauss}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore it."""
        key = state["key"].numpy().astype(np.uint32)
        own = (state["place"], state["has_gauss"], state["gauss"])
        np.random.set_state(("MT19937", key, *own))  # noqa: NPY002


def sizes_of(settings: LibraryPPOSettings) -> dict[str, Any]:
    """The network in the terms of the library."""
    between = torch.nn.Tanh if settings.activation == "tanh" else torch.nn.ReLU
    return {"net_arch": [settings.width] * 2, "activation_fn": between}


def network_of(settings: LibraryPPOSettings, seat: Seat, build: Build) -> FlatNetwork:
    """A new network for the seat."""
    from stable_baselines3.common.policies import ActorCriticPolicy

    inputs = FlatInputs(seat.features)
    spaces = Box(-np.inf, np.inf, (inputs.size,), np.float32), Discrete(seat.num_actions)
    policy = ActorCriticPolicy(*spaces, lambda _: settings.learning_rate, **sizes_of(settings))
    return FlatNetwork(inputs, StableBaselinesNetwork(policy))


class StableBaselinesPPO(LearnedNetwork):
    """The learner; an iteration is a rollout and its update.

    Args:
        settings: the hyperparameters.
        env: the games.
        build: the seed of everything that is random.

    Attributes:
        model: of the library.
    """

    def __init__(self, settings: LibraryPPOSettings, env: LearnerVectorEnv, build: Build) -> None:
        from stable_baselines3 import PPO
        from stable_baselines3.common.logger import Logger

        from pursuit.environments.stable_baselines import StableBaselinesVecEnv

        self.progress, self.batch = 0.0, settings.num_games * settings.rollout_steps
        self.model = PPO(
            "MlpPolicy",
            StableBaselinesVecEnv(env),
            n_steps=settings.rollout_steps,
            batch_size=settings.minibatch_size,
            n_epochs=settings.epochs,
            learning_rate=lambda _: settings.learning_rate * (1.0 - self.progress),
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip,
            ent_coef=settings.entropy_coef,
            vf_coef=settings.value_coef,
            max_grad_norm=settings.max_grad_norm,
            policy_kwargs=sizes_of(settings),
            seed=build.seed % 2**32,
            device="cpu",
        )
        # Without a logger every rollout creates a log folder.
        self.model.set_logger(Logger(folder=None, output_formats=[]))
        network = StableBaselinesNetwork(self.model.policy)
        super().__init__(env, FlatNetwork(env.interface.inputs, network))
        self.optimizer = self.model.policy.optimizer

    def iterate(self, progress: float) -> dict[str, float]:
        """A rollout and an update; what the library logs of the update."""
        self.progress = progress
        self.model.learn(self.batch, reset_num_timesteps=False)
        self.frames = int(self.model.num_timesteps)
        logged = self.model.logger.name_to_value
        return {own: sign * float(logged[name]) for name, (own, sign) in LOGGED.items()}

    def parts(self) -> dict[str, HasState]:
        """As of `LearnedNetwork`, with NumPy's generator."""
        return {**super().parts(), "numpy": NumpyStream()}

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        super().load_state_dict(state)
        self.model.num_timesteps = self.frames
