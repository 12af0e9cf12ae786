"""Action distributions: categorical, and squashed normal for continuous actions in [-1, 1].

Both have the same methods. Learners keep the drawn value; `action` converts it to the action of the
environment.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

DISTRIBUTION = "distribution"
"""Column of the `parameters` of the distributions that the actions were drawn from."""

LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)
FORBIDDEN = -1e9
"""Logit of a masked action: its probability is 0, and unlike -inf it gives no NaN in 0 * log 0."""


def are_probabilities(rows: NDArray[np.floating]) -> bool:
    """Whether each row of [n, actions] is a distribution, with sums up to rounding in float16."""
    return bool((rows >= 0.0).all() and (abs(rows.sum(axis=1) - 1.0) < 1e-3).all())


def masked(logits: torch.Tensor, allowed: torch.Tensor | None) -> torch.Tensor:
    """[..., actions]: `logits` where `allowed` [..., actions] bool, FORBIDDEN elsewhere.

    Without a mask (None) they are unchanged.
    """
    return logits if allowed is None else logits.masked_fill(~allowed, FORBIDDEN)


class Categorical:
    """A categorical distribution over discrete actions.

    Args:
        logits: [..., actions].
        allowed: [..., actions] bool, the action mask; None allows all.

    Attributes:
        DRAWN: column of the drawn values.
        parameters: [..., actions], log-probabilities.
    """

    DRAWN: ClassVar[str] = "action"

    def __init__(self, logits: torch.Tensor, allowed: torch.Tensor | None = None) -> None:
        self.parameters = masked(logits, allowed).log_softmax(dim=-1)

    def draw(self) -> torch.Tensor:
        """[...] int64.

        The Gumbel-max trick: argmax of log p - log(E), E exponential, is a draw from p.
        """
        logarithms = self.parameters
        return (logarithms - torch.empty_like(logarithms).exponential_().log()).argmax(dim=-1)

    @staticmethod
    def action(drawn: torch.Tensor) -> torch.Tensor:
        """The drawn value is the action."""
        return drawn

    def log_prob(self, drawn: torch.Tensor) -> torch.Tensor:
        """[...]: the log-probability of the drawn value."""
        return self.parameters.gather(-1, drawn[..., None]).squeeze(-1)

    def entropy(self) -> torch.Tensor:
        """[...]: the entropy in nats."""
        return -(self.parameters.exp() * self.parameters).sum(dim=-1)

    def divergence(self, before: torch.Tensor) -> torch.Tensor:
        """[...]: KL(before, self), with the `parameters` of another distribution."""
        return (before.exp() * (before - self.parameters)).sum(dim=-1)


class SquashedNormal:
    """Numbers in [-1, 1]: tanh of independent normal draws.

    The drawn value is x, before tanh. The density of tanh(x) is that of x divided by 1 - tanh(x)^2,
    which does not depend on mean and standard deviation. So probability ratios, gradients of
    log-probabilities and divergences equal those of the normal distributions, and are exact even
    where tanh(x) rounds to ±1.

    Args:
        mean: [..., numbers], before tanh.
        log_std: [numbers], logarithms of the standard deviations before tanh.

    Attributes:
        DRAWN: column of the drawn values.
    """

    DRAWN: ClassVar[str] = "drawn"

    def __init__(self, mean: torch.Tensor, log_std: torch.Tensor) -> None:
        self.mean, self.log_std = mean, log_std

    @property
    def parameters(self) -> torch.Tensor:
        """[..., 2 * numbers]: the means, then the logarithms of the standard deviations."""
        return torch.cat([self.mean, self.log_std.expand_as(self.mean)], dim=-1)

    def draw(self) -> torch.Tensor:
        """[..., numbers] float32, before tanh."""
        return self.mean + self.log_std.exp() * torch.randn_like(self.mean)

    @staticmethod
    def action(drawn: torch.Tensor) -> torch.Tensor:
        """[..., numbers] in [-1, 1]."""
        return drawn.tanh()

    def log_prob(self, drawn: torch.Tensor) -> torch.Tensor:
        """[...]: the log-density of the drawn value, before tanh."""
        scaled = (drawn - self.mean) * (-self.log_std).exp()
        return (-0.5 * scaled.square() - self.log_std - LOG_ROOT_TWO_PI).sum(dim=-1)

    def entropy(self) -> torch.Tensor:
        """[...]: the entropy in nats of the normal distribution, before tanh.

        The entropy of tanh(x) has no closed form, and a bonus on it would keep the mean away from
        ±1, where the best actions often are.
        """
        return (self.log_std + (0.5 + LOG_ROOT_TWO_PI)).sum(dim=-1).expand(self.mean.shape[:-1])

    def divergence(self, before: torch.Tensor) -> torch.Tensor:
        """[...]: KL(before, self), with the `parameters` of another one, equal before tanh."""
        mean, log_std = before.chunk(2, dim=-1)
        spread = (log_std - self.log_std).mul(2.0).exp()
        shift = ((mean - self.mean) * (-self.log_std).exp()).square()
        return (0.5 * (spread + shift - 1.0) + self.log_std - log_std).sum(dim=-1)
