"""Compiled kernels of small networks: first layer for "index", heads, and the loss of PPO.

`fused.py` and `fused_actor_critic.py` call them.
"""

from __future__ import annotations

import math
from typing import Any

from pursuit.compilation.compiled import compiled, merged_sums, summing


@compiled
def first_layer(observation: Any, rows: Any, table: Any, bias: Any, out: Any) -> None:
    """ReLU of the bias plus the rows that each observation selects.

    Args:
        observation: [batch, numbers] of any whole numbers.
        rows: [numbers] int64, the row that each number selects; the last row selects none.
        table: [rows + 1, width] float32.
        bias: [width] float32.
        out: [batch, width] float32.
    """
    width, none = bias.shape[0], table.shape[0] - 1
    for place in range(out.shape[0]):
        for unit in range(width):
            out[place, unit] = bias[unit]
        left = -1  # adds two rows at a time: half as many loads and stores
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
            if out[place, unit] < 0.0:  # NaN stays NaN
                out[place, unit] = 0.0


@compiled
def first_layer_gradient(
    observation: Any, rows: Any, first: Any, gradient: Any, of_table: Any, of_bias: Any
) -> None:
    """The gradients of table and bias.

    Args:
        observation, rows: as in `first_layer`.
        first: [batch, width] float32, the result of `first_layer`.
        gradient: [batch, width] float32, of that result; overwritten by the gradient before ReLU.
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


@merged_sums
def heads(hidden: Any, weight: Any, bias: Any, place: Any, out: Any) -> None:
    """Logits and value of one row, written to out[place]; four outputs per read of the row."""
    outputs, width = weight.shape
    fours = outputs - outputs % 4
    for output in range(0, fours, 4):
        first, second = bias[output], bias[output + 1]
        third, fourth = bias[output + 2], bias[output + 3]
        for unit in range(width):
            one = hidden[place, unit]
            first += one * weight[output, unit]
            second += one * weight[output + 1, unit]
            third += one * weight[output + 2, unit]
            fourth += one * weight[output + 3, unit]
        out[place, output], out[place, output + 1] = first, second
        out[place, output + 2], out[place, output + 3] = third, fourth
    for output in range(fours, outputs):
        total = bias[output]
        for unit in range(width):
            total += hidden[place, unit] * weight[output, unit]
        out[place, output] = total


@merged_sums
def powers(logits: Any, place: Any, room: Any) -> tuple[Any, Any]:
    """exp(logit - maximum) of each action, written to `room`; returns the maximum and the sum."""
    most, whole = logits[place, 0], 0.0
    for output in range(1, room.shape[0]):
        most = max(most, logits[place, output])
    for output in range(room.shape[0]):
        room[output] = math.exp(logits[place, output] - most)
        whole += room[output]
    return most, whole


@summing
def draw_actions(
    hidden: Any, weight: Any, bias: Any, chance: Any, logits: Any, action: Any, log_prob: Any,
    room: Any,
) -> None:  # fmt: skip
    """An action for every row, drawn from the softmax of the logits; and the value.

    Args:
        hidden: [batch, width] float32.
        weight: [actions + 1, width] float32; the last row is the value's.
        bias: [actions + 1] float32.
        chance: [batch] float32, uniform draws in [0, 1).
        logits: [batch, actions + 1] float32, out; the last is the value.
        action: [batch] int64, out.
        log_prob: [batch] float32, out, of the action.
        room: [actions] float32, scratch memory.
    """
    actions = weight.shape[0] - 1
    for place in range(hidden.shape[0]):
        heads(hidden, weight, bias, place, logits)
        most, whole = powers(logits, place, room)
        left, drawn = chance[place] * whole, actions - 1
        for output in range(actions):
            left -= room[output]
            if left < 0.0:
                drawn = output
                break
        action[place] = drawn
        log_prob[place] = logits[place, drawn] - most - math.log(whole)


@summing
def clipped_loss(
    hidden: Any, weight: Any, bias: Any, action: Any, before: Any, advantage: Any, target: Any,
    coefficients: Any, slopes: Any, sums: Any, room: Any,
) -> None:  # fmt: skip
    """The loss of `train.algorithms.ppo.ppo_loss`, and its gradients for logits and value.

    Args:
        hidden, weight, bias: as in `draw_actions`.
        action: [batch] int64, the drawn actions.
        before: [batch] float32, their log-probability in the collecting policy.
        advantage: [batch] float32.
        target: [batch] float32, of the values.
        coefficients: [4] float64: clipping range, value and entropy coefficients, and 1 if
            advantages are standardised, else 0; a single row is not.
        slopes: [batch, actions + 1] float32, out; the last column is the value's.
        sums: [6] float64, out; zeros at first. Sums over the batch: objective, squared errors of
            the value, entropy, clipped rows, differences of log-probabilities, and
            log-probabilities times advantages.
        room: [actions] float32, scratch memory.
    """
    batch, actions = slopes.shape[0], slopes.shape[1] - 1
    clip, value_coef, entropy_coef = coefficients[0], coefficients[1], coefficients[2]
    mean, scale = 0.0, 1.0
    if coefficients[3] != 0.0 and batch > 1:
        for place in range(batch):
            mean += advantage[place]
        mean /= batch
        square = 0.0
        for place in range(batch):
            square += (advantage[place] - mean) ** 2
        scale = 1.0 / max(math.sqrt(square / (batch - 1)), 1e-6)
    for place in range(batch):
        heads(hidden, weight, bias, place, slopes)
        most, whole = powers(slopes, place, room)
        below, entropy = most + math.log(whole), 0.0
        for output in range(actions):
            room[output] /= whole
            slopes[place, output] -= below
            entropy -= room[output] * slopes[place, output]
        drawn = action[place]
        gain = (advantage[place] - mean) * scale
        change = slopes[place, drawn] - before[place]
        ratio = math.exp(change)
        kept = min(max(ratio, 1.0 - clip), 1.0 + clip)
        error = slopes[place, actions] - target[place]
        sums[0] -= min(ratio * gain, kept * gain)
        sums[1] += error * error
        sums[2] += entropy
        sums[3] += ratio != kept
        sums[4] += change
        sums[5] += slopes[place, drawn] * gain
        of_drawn = 0.0 if kept * gain < ratio * gain else -ratio * gain / batch
        for output in range(actions):
            push = entropy_coef / batch * (slopes[place, output] + entropy) - of_drawn
            slope = push * room[output]
            slopes[place, output] = slope + of_drawn if output == drawn else slope
        slopes[place, actions] = 2.0 * value_coef / batch * error


@summing
def below_heads(hidden: Any, weight: Any, slopes: Any, out: Any) -> None:
    """The gradient before the ReLU with result `hidden`.

    Args:
        hidden, weight: as in `draw_actions`.
        slopes: [batch, actions + 1] float32, the gradient of the outputs of the heads.
        out: [batch, width] float32.
    """
    for place in range(out.shape[0]):
        for unit in range(out.shape[1]):
            out[place, unit] = 0.0
        for output in range(weight.shape[0]):
            slope = slopes[place, output]
            for unit in range(out.shape[1]):
                out[place, unit] += slope * weight[output, unit]
        for unit in range(out.shape[1]):
            if hidden[place, unit] <= 0.0:
                out[place, unit] = 0.0
