"""The losses of DDPG, TD3 and SAC.

Equal to those of TorchRL with squared errors (tested). Written explicitly, they avoid functional
calls at every step and unused gradients, and prepare observations once for actor and critics.

A batch has "observation", "action", "reward", "next_observation", "terminated", "steps" (to the
next observation) and, with prioritised replay, "priority_weight".
"""

from __future__ import annotations

import torch

from train.algorithms.replay import Minibatch, weighted_mean
from train.networks.continuous import Critics, DeterministicActor, GaussianActor


@torch.no_grad()
def next_action(
    actor: DeterministicActor, prepared: torch.Tensor, noise: float, clip: float
) -> torch.Tensor:
    """[batch, actions]: target actions, smoothed by clipped noise (Fujimoto et al.).

    Args:
        actor: the target actor.
        prepared: the next observations.
        noise: standard deviation; 0 for none.
        clip: the noise lies in [-clip, clip].
    """
    action: torch.Tensor = actor(prepared)
    if noise == 0.0:
        return action
    drawn = torch.randn_like(action).mul_(noise).clamp_(-clip, clip)
    return (action + drawn).clamp_(-1.0, 1.0)


def critic_loss(
    values: torch.Tensor, goal: torch.Tensor, batch: Minibatch
) -> tuple[torch.Tensor, torch.Tensor]:
    """The sum of squared errors of all critics, and the largest |error| of every transition.

    Args:
        values: [critics, batch].
        goal: [batch].
        batch: with its weights.

    Returns:
        The loss, and |error| [batch], detached.
    """
    error = values - goal
    return weighted_mean(error.square().sum(dim=0), batch), error.detach().abs().amax(dim=0)


def deterministic_actor_loss(
    actor: DeterministicActor, critics: Critics, prepared: torch.Tensor, batch: Minibatch
) -> torch.Tensor:
    """Minus the value of the actor's action, by the first critic (Silver et al., 2014)."""
    return -weighted_mean(critics.frozen(prepared, actor(prepared), 1)[0], batch)


def soft_actor_loss(
    actor: GaussianActor,
    critics: Critics,
    prepared: torch.Tensor,
    batch: Minibatch,
    alpha: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Minus the lowest value of a drawn action, and minus the weighted entropy.

    Returns:
        The loss, and the logarithms of the densities [batch], detached.
    """
    action, log_prob = actor.draw(prepared)
    values = critics.frozen(prepared, action, len(critics.weights[0])).amin(dim=0)
    return weighted_mean(alpha * log_prob - values, batch), log_prob.detach()


def temperature_loss(
    log_alpha: torch.Tensor, log_prob: torch.Tensor, target: float, batch: Minibatch
) -> torch.Tensor:
    """Lowers the temperature where the entropy is above its target, and raises it below."""
    return weighted_mean(-log_alpha * (log_prob + target), batch)
