"""Prioritised replay without TorchRL's compiled extension, which not every torch can load.

TorchRL's `PrioritizedSampler` keeps its priorities in segment trees written in C++. Where they are
missing, these trees in torch take their place; everything else is TorchRL's own.
"""

from __future__ import annotations

import torch
from torchrl.data.replay_buffers import PrioritizedSampler


def extension_loads() -> bool:
    """Whether TorchRL's compiled segment trees can be used here."""
    try:
        PrioritizedSampler(max_capacity=2, alpha=0.5, beta=0.5)
    except (RuntimeError, TypeError):  # RuntimeError in 0.14; calling None in older ones
        return False
    return True


class SegmentTree:
    """A complete binary tree of float64 over `capacity` leaves: sums, or minima, of ranges.

    Node 1 is the root and node i has the children 2i and 2i + 1, so every operation on a batch of
    leaves is a few torch operations for each of the log2(capacity) levels.

    Args:
        capacity: leaves.
        minimum: keep minima instead of sums.
    """

    def __init__(self, capacity: int, minimum: bool = False) -> None:
        self.minimum = minimum
        self.levels = max(capacity - 1, 1).bit_length()
        self.size = 1 << self.levels
        self.neutral = float("inf") if minimum else 0.0
        self.nodes = torch.full((2 * self.size,), self.neutral, dtype=torch.float64)

    def __len__(self) -> int:
        return self.size

    def _join(self, left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
        return torch.minimum(left, right) if self.minimum else left + right

    def __getitem__(self, index: int | torch.Tensor) -> torch.Tensor:
        return self.nodes[torch.as_tensor(index) + self.size].float()

    def __setitem__(self, index: int | torch.Tensor, value: float | torch.Tensor) -> None:
        nodes = torch.as_tensor(index).reshape(-1).long() + self.size
        self.nodes[nodes] = (
            torch.as_tensor(value, dtype=torch.float64).reshape(-1).expand(len(nodes))
        )
        for _ in range(self.levels):
            nodes = nodes >> 1
            self.nodes[nodes] = self._join(self.nodes[2 * nodes], self.nodes[2 * nodes + 1])

    def query(self, left: int, right: int) -> float:
        """The sum, or minimum, of the leaves left <= i < right."""
        result = self.neutral
        low, high = left + self.size, right + self.size
        while low < high:
            if low & 1:
                result = self._join2(result, float(self.nodes[low]))
                low += 1
            if high & 1:
                high -= 1
                result = self._join2(result, float(self.nodes[high]))
            low, high = low >> 1, high >> 1
        return result

    def _join2(self, left: float, right: float) -> float:
        return min(left, right) if self.minimum else left + right

    def scan_lower_bound(self, mass: torch.Tensor | float) -> torch.Tensor:
        """The first leaf up to which, itself included, the sum is above `mass`; sums only."""
        left = torch.as_tensor(mass, dtype=torch.float64).clone()
        nodes = torch.ones(left.shape, dtype=torch.int64)
        for _ in range(self.levels):
            nodes = 2 * nodes
            sums = self.nodes[nodes]
            # A right half without any priority is never entered, whatever rounding did to `left`.
            right = (left >= sums) & (self.nodes[nodes + 1] > 0)
            left = torch.where(right, left - sums, left)
            nodes = nodes + right.long()
        return nodes - self.size


class TorchPrioritizedSampler(PrioritizedSampler):
    """TorchRL's sampler over `SegmentTree`s."""

    def _init(self) -> None:
        self._sum_tree = SegmentTree(self._max_capacity)
        self._min_tree = SegmentTree(self._max_capacity, minimum=True)
        self._max_priority = None


def prioritized_sampler(capacity: int, alpha: float, beta: float) -> PrioritizedSampler:
    """The compiled sampler where it loads, else the one over torch trees."""
    form = PrioritizedSampler if extension_loads() else TorchPrioritizedSampler
    return form(max_capacity=capacity, alpha=alpha, beta=beta)
