"""Compiled kernels of the first layer on "index": sums of rows, activation and gradient in one."""

from __future__ import annotations

from typing import Any

from pursuit.compiled import compiled


@compiled
def first_layer(observation: Any, rows: Any, table: Any, bias: Any, out: Any) -> None:
    """The bias and the rows that every observation names, summed; then ReLU.

    Args:
        observation: [batch, numbers] of any whole numbers.
        rows: [numbers] int64, the row that each number names; the table's last one is none.
        table: [rows + 1, width] float32.
        bias: [width] float32.
        out: [batch, width] float32.
    """
    width, none = bias.shape[0], table.shape[0] - 1
    for place in range(out.shape[0]):
        for unit in range(width):
            out[place, unit] = bias[unit]
        left = -1  # two rows at a time: half as many loads and stores
        for number in range(observation.shape[1]):
            row = rows[observation[place, number]]
            if row == none:
                continue
            if left < 0:
                left = row
                continue
            for unit in range(width):
                out[place, unit] += table[left, unit] + table[row, unit]
            left = -1
        if left >= 0:
            for unit in range(width):
                out[place, unit] += table[left, unit]
        for unit in range(width):
            if out[place, unit] < 0.0:  # and what is not a number stays so
                out[place, unit] = 0.0


@compiled
def first_layer_gradient(
    observation: Any, rows: Any, first: Any, gradient: Any, of_table: Any, of_bias: Any
) -> None:
    """The gradients of table and bias.

    Args:
        observation, rows: as `first_layer` took them.
        first: [batch, width] float32, what it gave.
        gradient: [batch, width] float32, of that; overwritten by what is left before the ReLU.
        of_table: [rows + 1, width] float32, out; zeros at first.
        of_bias: [width] float32, out; zeros at first.
    """
    width, none = of_bias.shape[0], of_table.shape[0] - 1
    for place in range(gradient.shape[0]):
        for unit in range(width):
            if first[place, unit] <= 0.0:
                gradient[place, unit] = 0.0
            of_bias[unit] += gradient[place, unit]
        for number in range(observation.shape[1]):
            row = rows[observation[place, number]]
            if row != none:
                for unit in range(width):
                    of_table[row, unit] += gradient[place, unit]
