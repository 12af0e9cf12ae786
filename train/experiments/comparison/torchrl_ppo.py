"""PPO as TorchRL's own training scripts are put together, over our TorchRL environment.

Their parts, in their order: a `Collector` over a `ProbabilisticActor`, `GAE` before every epoch, a
replay buffer that is emptied without replacement, `ClipPPOLoss`, clipped gradients, Adam. (Ours has
the collector and the advantages too, but a policy that draws and a loss of its own.)
"""

from __future__ import annotations

from typing import Any

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torch.distributions import Categorical
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from train.environments.simulator_env import SimulatorEnv
from train.settings.algorithms import PPOSettings


def perceptron(outputs: int, inputs: int, settings: PPOSettings) -> MLP:
    """Two hidden layers, orthogonal weights, biases of 0."""
    between = nn.Tanh if settings.activation == "tanh" else nn.ReLU
    made = MLP(
        in_features=inputs,
        out_features=outputs,
        num_cells=[settings.width] * 2,
        activation_class=between,
    )
    for part in made.modules():
        if isinstance(part, nn.Linear):
            nn.init.orthogonal_(part.weight, 1.0)
            nn.init.zeros_(part.bias)
    return made


class TorchRLPPO:
    """The learner over a batch of games.

    Args:
        settings: the hyperparameters; `shared` and those of a KL penalty are not used.
        env: whose player observes a flat vector.
        seed: of the weights and the draws.

    Attributes:
        frames: environment steps, all games counted.
        network: the policy's.
    """

    def __init__(self, settings: PPOSettings, env: SimulatorEnv, seed: int) -> None:
        torch.manual_seed(seed)
        self.settings, self.frames = settings, 0
        inputs = env.observation_spec["observation"].shape[-1]
        self.network = perceptron(env.player.num_actions, inputs, settings)
        actor = ProbabilisticActor(
            TensorDictModule(self.network, ["observation"], ["logits"]),
            in_keys=["logits"],
            spec=env.action_spec,
            distribution_class=Categorical,
            return_log_prob=True,
        )
        critic = ValueOperator(perceptron(1, inputs, settings), in_keys=["observation"])
        batch = settings.num_games * settings.rollout_steps
        self.collector: Any = Collector(
            env,
            actor,
            frames_per_batch=batch,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        self.batches = iter(self.collector)
        self.advantage = GAE(
            gamma=settings.gamma,
            lmbda=settings.gae_lambda,
            value_network=critic,
            average_gae=False,
        )
        self.loss = ClipPPOLoss(
            actor,
            critic,
            clip_epsilon=settings.clip,
            loss_critic_type="l2",
            entropy_coeff=settings.entropy_coef,
            critic_coeff=settings.value_coef,
            normalize_advantage=True,
        )
        self.buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(batch),
            sampler=SamplerWithoutReplacement(drop_last=True),
            batch_size=settings.minibatch_size,
        )
        self.optimizer = torch.optim.Adam(
            self.loss.parameters(), lr=settings.learning_rate, eps=1e-5
        )

    def iterate(self, progress: float) -> None:
        """A rollout, and what is learned from it; `progress` in [0, 1] through the budget."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate * (1.0 - progress)
        rollout = next(self.batches)
        self.frames += rollout.numel()
        for _ in range(self.settings.epochs):
            with torch.no_grad():
                self.advantage(rollout)
            self.buffer.extend(rollout.reshape(-1))
            for minibatch in self.buffer:
                found = self.loss(minibatch)
                total = found["loss_objective"] + found["loss_entropy"] + found["loss_critic"]
                self.optimizer.zero_grad()
                total.backward()
                nn.utils.clip_grad_norm_(self.loss.parameters(), self.settings.max_grad_norm)
                self.optimizer.step()

    def close(self) -> None:
        """Stop collecting."""
        self.collector.shutdown()
