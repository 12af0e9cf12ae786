"""How a move is drawn from a random word: against the definition, in whole numbers."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from pursuit.compilation.compiled import compiled
from pursuit.rules.randomness import GOLDEN, draw_action


def test_a_move_is_drawn_from_the_upper_and_the_lower_half_of_one_word() -> None:
    """By the definition, in whole numbers: random where upper < epsilon * 2**32, and which move."""
    scaled = [0, 1, 2**31 - 1, 2**31, 858_993_459, 2**32 - 1, 2**32]
    shares = [0.2, 1 / 3, 1e-12, *(part / 2**32 for part in scaled)]
    streams = np.zeros(1, dtype=np.uint64)
    random = np.random.default_rng(0)
    wide = (32, 0b101_0000, 2**31 - 1, 2**30 + 5, 0b1111_1110_0000)  # of graphs
    for greedy, every, empty in product((*range(32), *wide), (0, 1, 6, 15, *wide), (0, 4, 31)):
        for epsilon in shares:
            streams[0] = state = random.integers(2**64, dtype=np.uint64)
            drawn = drawn_action(greedy, every, epsilon, empty, streams)
            word = int(mix((int(state) + GOLDEN) % 2**64))
            mask = every if Fraction(word >> 32, 2**32) < Fraction(epsilon) else greedy
            moves = [action for action in range(31) if mask >> action & 1] or [empty]
            assert drawn == moves[(word % 2**32) * len(moves) >> 32]


@compiled
def drawn_action(greedy: int, every: int, epsilon: float, empty: int, streams: Any) -> int:
    return draw_action(greedy, every, epsilon, empty, False, streams, 0)


def mix(word: int) -> int:
    """SplitMix64's output, in Python's numbers."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        word = (word ^ word >> shift) * factor % 2**64
    return word ^ word >> 31
