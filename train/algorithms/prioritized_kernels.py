"""Compiled kernels of prioritised replay: trees of sums and minima."""

from __future__ import annotations

from typing import Any

from pursuit.compilation.compiled import compiled


@compiled
def set_leaves(sums: Any, minima: Any, index: Any, values: Any) -> None:
    """Write leaves of both trees, and update their ancestors.

    Node 1 is the root, node i has the children 2i and 2i + 1, and the leaves are the second half.

    Args:
        sums, minima: [2 * size] float64.
        index: [n] int64, of the leaves; for repeated ones the last value is used.
        values: [n] float32.
    """
    size = sums.shape[0] // 2
    for number in range(index.shape[0]):
        node = size + index[number]
        sums[node] = values[number]
        minima[node] = values[number]
        node >>= 1
        while node > 0:
            sums[node] = sums[2 * node] + sums[2 * node + 1]
            minima[node] = min(minima[2 * node], minima[2 * node + 1])
            node >>= 1


@compiled
def find_leaves(sums: Any, masses: Any, index: Any) -> None:
    """For each mass, the first leaf at which the cumulative sum exceeds it.

    Args:
        sums: [2 * size] float64.
        masses: [n] float32.
        index: [n] int64, out.
    """
    size = sums.shape[0] // 2
    for number in range(index.shape[0]):
        left, node = float(masses[number]), 1
        while node < size:
            node *= 2
            # A right half without any priority is never entered, even if `left` is rounded.
            if left >= sums[node] and sums[node + 1] > 0.0:
                left -= sums[node]
                node += 1
        index[number] = node - size
