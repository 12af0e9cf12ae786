"""Prioritised replay (Schaul et al., 2016): sampling probabilities and importance weights.

A transition with error e has the priority (|e| + EPSILON) ** alpha, is drawn in proportion to it,
and has the weight (priority / smallest priority) ** -beta in the loss. These are the formulas of
TorchRL's `PrioritizedSampler`, with the same draws for the same random numbers. Its trees need a
compiled extension that does not load with every version of torch; ours are compiled by Numba.
"""

from __future__ import annotations

import torch

from train.algorithms.prioritized_kernels import find_leaves, set_leaves

EPSILON = 1e-8


def priority(errors: torch.Tensor, alpha: float) -> torch.Tensor:
    """[n] priorities of absolute errors [n]."""
    return (errors + EPSILON) ** alpha


class Priorities:
    """The priorities of the rows of a replay buffer, in two complete binary trees: sums and minima.

    Args:
        capacity: rows.
        alpha: exponent of the priorities; 0 draws uniformly.

    Attributes:
        largest: the largest |error| so far, which new rows start with; None before the first row.
    """

    def __init__(self, capacity: int, alpha: float) -> None:
        size = 1 << max(capacity - 1, 1).bit_length()
        self.alpha, self.size = alpha, size
        self.sums = torch.zeros(2 * size, dtype=torch.float64)
        self.minima = torch.full_like(self.sums, float("inf"))
        self.largest: torch.Tensor | None = None

    def begin(self, index: torch.Tensor) -> None:
        """Give new rows [n] int64 the priority of the largest error."""
        if self.largest is None:
            self.largest = torch.ones(())
        self._set(index, priority(self.largest, self.alpha).expand(len(index)))

    def update(self, index: torch.Tensor, errors: torch.Tensor) -> None:
        """Set the absolute errors [n] float32 of rows [n] int64."""
        most = errors.max()
        self.largest = most if self.largest is None else torch.maximum(self.largest, most)
        self._set(index, priority(errors, self.alpha))

    def draw(
        self, count: int, rows: int, beta: float, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Rows [count] int64 and their weights [count] float32.

        Args:
            count: number of draws.
            rows: number of rows in the buffer.
            beta: the exponent of the weights.
            generator: of random numbers.
        """
        masses = torch.rand(count, generator=generator) * float(self.sums[1])
        index = torch.empty(count, dtype=torch.int64)
        find_leaves(self.sums.numpy(), masses.numpy(), index.numpy())
        index.clamp_(max=rows - 1)
        drawn = self.sums[self.size :].index_select(0, index).float()
        return index, (drawn / float(self.minima[1])) ** -beta

    def read(self, rows: int) -> torch.Tensor:
        """[rows] float32 priorities."""
        return self.sums[self.size : self.size + rows].float()

    def write(self, values: torch.Tensor) -> None:
        """Set the priorities of the first rows, [n] float32."""
        self._set(torch.arange(len(values)), values)

    def _set(self, index: torch.Tensor, values: torch.Tensor) -> None:
        arrays = (self.sums, self.minima, index, values.contiguous())
        set_leaves(*(array.numpy() for array in arrays))
