"""What an agent may not do, taken out of a network's logits or action values."""

from __future__ import annotations

import torch

FORBIDDEN = -1e9
"""Of a masked action: its probability is 0, and unlike -inf it makes no NaN of 0 * log 0."""


def masked(logits: torch.Tensor, allowed: torch.Tensor | None) -> torch.Tensor:
    """[..., actions]: `logits` where `allowed` [..., actions] bool, FORBIDDEN elsewhere.

    Without masks (None) they are as they were.
    """
    return logits if allowed is None else logits.masked_fill(~allowed, FORBIDDEN)
