"""Policy and value heads in the form that TorchRL's losses want, to compare ours with."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import nn
from torchrl.modules import IndependentNormal

from pursuit.observations.masks import ACTION_MASK
from train.networks.actor_critic import ActorCritic
from train.networks.distributions import masked


class MaskedHead(nn.Module):
    """A policy head that keeps to masks."""

    def __init__(self, head: nn.Linear) -> None:
        super().__init__()
        self.head = head

    def forward(self, hidden: torch.Tensor, allowed: torch.Tensor) -> torch.Tensor:
        """[..., actions] logits."""
        return masked(self.head(hidden), allowed)


class NormalHead(nn.Module):
    """A policy head of continuous actions, with its standard deviations."""

    def __init__(self, head: nn.Linear, log_std: nn.Parameter) -> None:
        super().__init__()
        self.head, self.log_std = head, log_std

    def forward(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Means and standard deviations [..., numbers] before tanh."""
        mean = self.head(hidden)
        return mean, self.log_std.exp().expand_as(mean)


def actor_of(network: ActorCritic, masks: bool = False) -> ProbabilisticTensorDictSequential:
    """The policy head as TorchRL's losses want it, on "policy_hidden" (and "action_mask").

    The distribution is that of what was drawn: of continuous actions the normal, before tanh.
    """
    head: nn.Module = MaskedHead(network.policy_head) if masks else network.policy_head
    keys, form = ["logits"], torch.distributions.Categorical
    if network.log_std is not None:
        head = NormalHead(network.policy_head, network.log_std)
        keys, form = ["loc", "scale"], IndependentNormal
    return ProbabilisticTensorDictSequential(
        TensorDictModule(head, ["policy_hidden", ACTION_MASK][: 1 + masks], keys),
        ProbabilisticTensorDictModule(
            in_keys=keys,
            out_keys=[network.form.DRAWN],
            distribution_class=form,
            return_log_prob=True,
        ),
    )


def critic_of(network: ActorCritic) -> TensorDictModule:
    """The value head, on "value_hidden"."""
    return TensorDictModule(network.value_head, ["value_hidden"], ["state_value"])


def ours(minibatch: TensorDictBase) -> dict[str, torch.Tensor]:
    """A minibatch as our losses take it: one number a frame of advantages and targets."""
    flat = ("advantage", "value_target")
    return {name: minibatch[name].squeeze(-1) if name in flat else minibatch[name]
            for name in minibatch.keys()}  # noqa: SIM118  # fmt: skip
