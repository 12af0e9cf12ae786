"""What a policy draws actions from: one of several choices, or a row of numbers in [-1, 1].

Both have the same verbs, so that no learner asks which it has. What is drawn is kept for learning;
`action` makes of it what the environment takes.
"""

from __future__ import annotations

import math
from typing import ClassVar

import torch

DISTRIBUTION = "distribution"
"""Where frames keep the `parameters` of the distributions that their actions were drawn from."""

LOG_ROOT_TWO_PI = 0.5 * math.log(2.0 * math.pi)
FORBIDDEN = -1e9
"""Of a masked action: its probability is 0, and unlike -inf it makes no NaN of 0 * log 0."""


def masked(logits: torch.Tensor, allowed: torch.Tensor | None) -> torch.Tensor:
    """[..., actions]: `logits` where `allowed` [..., actions] bool, FORBIDDEN elsewhere.

    Without masks (None) they are as they were.
    """
    return logits if allowed is None else logits.masked_fill(~allowed, FORBIDDEN)


class Categorical:
    """One of several choices.

    Args:
        logits: [..., actions].
        allowed: [..., actions] bool, what may be done; None for anything.

    Attributes:
        DRAWN: where frames keep what was drawn.
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

    def greedy(self) -> torch.Tensor:
        """[...] int64: the most probable one."""
        return self.parameters.argmax(dim=-1)

    @staticmethod
    def action(drawn: torch.Tensor) -> torch.Tensor:
        """The same."""
        return drawn

    def log_prob(self, drawn: torch.Tensor) -> torch.Tensor:
        """[...] of what was drawn."""
        return self.parameters.gather(-1, drawn[..., None]).squeeze(-1)

    def entropy(self) -> torch.Tensor:
        """[...], in nats."""
        return -(self.parameters.exp() * self.parameters).sum(dim=-1)

    def divergence(self, before: torch.Tensor) -> torch.Tensor:
        """[...]: KL(before, this), of the `parameters` of another one."""
        return (before.exp() * (before - self.parameters)).sum(dim=-1)


class SquashedNormal:
    """Numbers in [-1, 1]: tanh of independent normal draws.

    What is drawn, and kept, is the number before tanh, x. The density of tanh(x) is that of x over
    1 - tanh(x)^2, a factor in which mean and standard deviation do not occur. So ratios of
    probabilities, gradients of their logarithms and divergences between two such distributions are
    those of the normals alone, and exact where tanh(x) has come as near to ±1 as to be rounded.

    Args:
        mean: [..., numbers], before tanh.
        log_std: [numbers], logarithms of the standard deviations before tanh.

    Attributes:
        DRAWN: where frames keep what was drawn.
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

    def greedy(self) -> torch.Tensor:
        """[..., numbers], before tanh: the mean, whose tanh is the median of each number."""
        return self.mean

    @staticmethod
    def action(drawn: torch.Tensor) -> torch.Tensor:
        """[..., numbers] in [-1, 1]."""
        return drawn.tanh()

    def log_prob(self, drawn: torch.Tensor) -> torch.Tensor:
        """[...]: of what was drawn, before tanh."""
        scaled = (drawn - self.mean) * (-self.log_std).exp()
        return (-0.5 * scaled.square() - self.log_std - LOG_ROOT_TWO_PI).sum(dim=-1)

    def entropy(self) -> torch.Tensor:
        """[...], in nats: of the normal, before tanh.

        That of tanh(x) has no closed form. It is less where the mean is far from 0, so a bonus on
        it would hold the mean back from ±1, where the best actions often are; this one does not.
        """
        return (self.log_std + (0.5 + LOG_ROOT_TWO_PI)).sum(dim=-1).expand(self.mean.shape[:-1])

    def divergence(self, before: torch.Tensor) -> torch.Tensor:
        """[...]: KL(before, this), of the `parameters` of another one; tanh does not change it."""
        mean, log_std = before.chunk(2, dim=-1)
        spread = (log_std - self.log_std).mul(2.0).exp()
        shift = ((mean - self.mean) * (-self.log_std).exp()).square()
        return (0.5 * (spread + shift - 1.0) + self.log_std - log_std).sum(dim=-1)
