"""Compiled kernels of the cross-entropy method: networks of all candidates, and draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compilation.compiled import merged_sums, summing
from train.networks.fused_kernels import powers


@merged_sums
def activate(hidden: Any, tanh: bool) -> None:
    """tanh or ReLU of `hidden` [width], in place; `np.tanh` would take three times as long."""
    for unit in range(hidden.shape[0]):
        if tanh:
            power = np.exp(np.float32(2.0) * hidden[unit])
            hidden[unit] = np.float32(1.0) - np.float32(2.0) / (power + np.float32(1.0))
        elif hidden[unit] < 0.0:
            hidden[unit] = 0.0


@summing
def outputs_of(
    observed: Any, rows: Any, running: Any, layers: Any, tanh: bool, hidden: Any, out: Any
) -> None:
    """Outputs of the running games, each by the network of its own candidate.

    Args:
        observed: [games, numbers], observations of "index", or any other ones, scaled.
        rows: [numbers] int64, the row of the first layer that each number selects; the last one
            selects none. None if the observation is no "index".
        running: [n] int64, the running games; equal numbers of games in turn belong to a candidate.
        layers: weight and bias [population, units] of three layers in turn; the weights of the
            first two are [population, inputs, units], of the last [population, units, inputs].
        tanh: or ReLU.
        hidden: [2, width] float32, for intermediate results.
        out: [n, outputs] float32.
    """
    first, first_bias, second, second_bias, last, last_bias = layers
    each, width = observed.shape[0] // first.shape[0], hidden.shape[1]
    for place in range(running.shape[0]):
        game = running[place]
        own = game // each
        for unit in range(width):
            hidden[0, unit], hidden[1, unit] = first_bias[own, unit], second_bias[own, unit]
        for number in range(observed.shape[1]):
            if rows is None:
                value = observed[game, number]
                if value != 0.0:
                    for unit in range(width):
                        hidden[0, unit] += value * first[own, number, unit]
            else:
                row = rows[observed[game, number]]
                if row != rows[-1]:
                    for unit in range(width):
                        hidden[0, unit] += first[own, row, unit]
        activate(hidden[0], tanh)
        for inner in range(width):
            for unit in range(width):
                hidden[1, unit] += hidden[0, inner] * second[own, inner, unit]
        activate(hidden[1], tanh)
        for output in range(out.shape[1]):
            total = last_bias[own, output]
            for unit in range(width):
                total += hidden[1, unit] * last[own, output, unit]
            out[place, output] = total


@summing
def draw_actions(logits: Any, chances: Any, running: Any, actions: Any) -> None:
    """Write a draw from softmax(`logits` [n, actions]) to `actions` [games] of each running game.

    `chances` [n] are uniform in [0, 1), `running` is as in `outputs_of`; `logits` are overwritten.
    """
    for place in range(running.shape[0]):
        _, total = powers(logits, place, logits[place])
        left, chosen = chances[place] * total, 0
        while chosen < logits.shape[1] - 1 and left >= logits[place, chosen]:
            left -= logits[place, chosen]
            chosen += 1
        actions[running[place]] = chosen
