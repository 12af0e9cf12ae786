"""A policy and a value over joined hidden layers, with draws and gradients written out; on the CPU.

What PPO and A2C do most: they ask a small network about all games, and descend on minibatches. Of
that time half went into dozens of small operations and into products with four columns, which
kernels do at once (`joined_head_kernels`). The same functions as `ActorCritic` and `ppo_loss`, up
to the last bits; where products are in bfloat16, the first layer is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch

from train.networks.actor_critic import ActorCritic
from train.networks.distributions import Categorical
from train.networks.joined import Joinable, gradients_of, hidden_layers, joinable
from train.networks.joined_head_kernels import below_heads, clipped_loss, draw_actions


class Drawn(NamedTuple):
    """What was drawn for every observation.

    Attributes:
        action: [batch] int64.
        log_prob: [batch] float32, of the action.
        value: [batch] float32.
    """

    action: torch.Tensor
    log_prob: torch.Tensor
    value: torch.Tensor


@dataclass(frozen=True, eq=False)
class Learned:
    """Frames to learn from.

    Attributes:
        observation: [batch, numbers].
        action: [batch] int64.
        log_prob: [batch] float32, of the action when it was drawn.
        advantage: [batch] float32.
        target: [batch] float32, of the value.
    """

    observation: torch.Tensor
    action: torch.Tensor
    log_prob: torch.Tensor
    advantage: torch.Tensor
    target: torch.Tensor

    def __len__(self) -> int:
        return len(self.action)

    def at(self, chosen: torch.Tensor) -> Learned:
        """Those frames, [n] int64, of them."""
        return Learned(
            *(column.index_select(0, chosen) for column in (self.observation, *self.rest))
        )

    @property
    def rest(self) -> tuple[torch.Tensor, ...]:
        """All but the observations."""
        return self.action, self.log_prob, self.advantage, self.target


class Weighing(NamedTuple):
    """How the parts of the loss are weighed.

    Attributes:
        clip: of the probability ratio; infinity for none.
        value_coef: of squared errors of the value.
        entropy_coef: of the entropy bonus.
        standardize: whether advantages are scaled to mean 0 and standard deviation 1 first.
    """

    clip: float
    value_coef: float
    entropy_coef: float
    standardize: bool = True


class JoinedActorCritic:
    """The network of an `ActorCritic`, which keeps the weights.

    Args:
        network: one that `joined_actor_critic` takes.
        layers: its hidden ones.
    """

    def __init__(self, network: ActorCritic, layers: Joinable) -> None:
        self.layers, self.policy, self.value_head = layers, network.policy_head, network.value_head
        self._room = torch.empty(self.policy.out_features)

    def _heads(self) -> tuple[torch.Tensor, torch.Tensor]:
        """[actions + 1, width] and [actions + 1]: the two heads in one."""
        heads = (self.policy, self.value_head)
        weight = torch.cat([head.weight.detach() for head in heads])
        return weight, torch.cat([head.bias.detach() for head in heads])

    @torch.no_grad()
    def draw(self, observation: torch.Tensor) -> Drawn:
        """Actions by torch's generator, of observations [batch, numbers]."""
        hidden = hidden_layers(self.layers, observation).second.float()
        weight, bias = self._heads()
        batch = len(observation)
        outputs = torch.empty(batch, len(bias))
        action, log_prob = torch.empty(batch, dtype=torch.int64), torch.empty(batch)
        chance = torch.rand(batch)
        given = (hidden, weight, bias, chance, outputs, action, log_prob, self._room)
        draw_actions(*_arrays(given))
        return Drawn(action, log_prob, outputs[:, -1])

    @torch.no_grad()
    def value(self, observation: torch.Tensor) -> torch.Tensor:
        """[batch] of observations [batch, numbers]."""
        hidden = hidden_layers(self.layers, observation).second.float()
        return torch.addmv(
            self.value_head.bias.expand(len(hidden)), hidden, self.value_head.weight[0]
        )

    @torch.no_grad()
    def set_gradients(self, frames: Learned, weighing: Weighing) -> dict[str, torch.Tensor]:
        """The gradients of the loss, into `grad` of all parameters.

        Args:
            frames: to learn from.
            weighing: of the parts of the loss.

        Returns:
            Means over the frames for the log, those of `ppo_loss`; and "log_prob_gain", that of
            log-probabilities times advantages.
        """
        passed = hidden_layers(self.layers, frames.observation)
        hidden = passed.second.float()
        weight, bias = self._heads()
        slopes, sums = torch.empty(len(hidden), len(bias)), torch.zeros(6, dtype=torch.float64)
        coefficients = torch.tensor(weighing, dtype=torch.float64)
        given = (hidden, weight, bias, *frames.rest, coefficients, slopes, sums, self._room)
        clipped_loss(*_arrays(given))
        behind = torch.empty_like(hidden)
        below_heads(*_arrays((hidden, weight, slopes, behind)))
        of_weight, of_bias = slopes.T @ hidden, slopes.sum(0)
        layer, below, _ = self.layers
        behind = behind.to(passed.second.dtype)
        found = gradients_of(self.layers, frames.observation, passed, behind)
        gradients = {
            self.policy.weight: of_weight[:-1],
            self.policy.bias: of_bias[:-1],
            self.value_head.weight: of_weight[-1:],
            self.value_head.bias: of_bias[-1:],
        }
        weights = (layer.weight, layer.bias, below.weight, below.bias)
        gradients |= zip(weights, found, strict=True)
        for one, gradient in gradients.items():
            one.grad = gradient if one.requires_grad else None
        means = (sums / len(hidden)).float()
        objective, error, entropy, clipped, change, gain = means.unbind()
        return {
            "loss_objective": objective,
            "loss_critic": weighing.value_coef * error,
            "entropy": entropy,
            "clip_fraction": clipped,
            "kl_approx": -change,
            "log_prob_gain": gain,
        }


def _arrays(tensors: tuple[torch.Tensor, ...]) -> list[Any]:
    return [tensor.numpy() for tensor in tensors]


def joined_actor_critic(network: ActorCritic, device: str) -> JoinedActorCritic | None:
    """The joined form of a network; None where there is none.

    It is there for choices of actions, with one trunk for policy and value that is `joinable`,
    nothing remembered, on the CPU; and not for subclasses, which may do something else.
    """
    plain = network.form is Categorical and network.policy_memory is None
    if device != "cpu" or not plain or type(network) is not ActorCritic:
        return None
    layers = joinable(network.policy_trunk) if network.shared else None
    return None if layers is None else JoinedActorCritic(network, layers)
