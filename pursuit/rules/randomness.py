"""Random streams of 64-bit words, each a function of (seed, game, stream) only.

SplitMix64 (Steele, Lea and Flood, 2014): a stream is a counter, a number is its mixed value. For
the order of the streams of a game see `layout`.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from pursuit.compilation.compiled import compiled, inlined, subroutine
from pursuit.rules.arrays import Reals, Words
from pursuit.rules.layout import STARTS_STREAM

GOLDEN = 0x9E3779B97F4A7C15
"""2**64 divided by the golden ratio, made odd: the increment of a stream."""


PACKED_BITS = 5
"""Masks with a higher bit, on graphs with more than four neighbors, are not packed."""


def _packed(mask: int) -> int:
    """The actions of a bit mask, one byte each from the lowest, and their number in the highest."""
    actions = [action for action in range(PACKED_BITS) if mask >> action & 1]
    return sum(action << 8 * at for at, action in enumerate(actions)) | len(actions) << 56


PACKED_MASKS = np.array([_packed(mask) for mask in range(1 << PACKED_BITS)], dtype=np.uint64)
"""[32] uint64."""


@inlined
def mix(word: np.uint64) -> np.uint64:
    """The output function of SplitMix64 (Steele, Lea and Flood, 2014)."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@inlined
def next_word(streams: Words, stream: int) -> np.uint64:
    """The next 64 random bits of `streams[stream]`, which advances."""
    streams[stream] += np.uint64(GOLDEN)
    return mix(streams[stream])


@inlined
def next_below(streams: Words, stream: int, bound: int) -> int:
    """A uniform integer from 0 to bound - 1 (bias below bound / 2**32)."""
    return np.int64(
        ((next_word(streams, stream) >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32)
    )


@inlined
def next_uniform(streams: Words, stream: int) -> float:
    """A uniform float64 in [0, 1)."""
    return np.float64(next_word(streams, stream) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inlined
def draw_action(
    greedy: int, every: int, epsilon: float, empty: int, few: bool, streams: Words, stream: int
) -> int:
    """A uniformly random action of the mask `greedy`, or, with probability `epsilon`, of `every`.

    One random word is used for both draws. The action is `empty` if the mask is empty. `few`, a
    constant, promises that no mask has more than PACKED_BITS bits, which is faster.
    """
    # No branch, as it could not be predicted. `at_random` is all ones if the first 32 bits are
    # below epsilon * 2**32, else 0; signed, as the processor does not convert unsigned words.
    word = next_word(streams, stream)
    at_random = (np.int64(word >> np.uint64(32)) - np.int64(ceil(epsilon * 2.0**32))) >> 63
    mask = greedy ^ ((greedy ^ every) & at_random)
    low = word & np.uint64(0xFFFFFFFF)
    if not few and mask >> PACKED_BITS:
        return draw_bit(mask, low)
    packed = PACKED_MASKS[np.uint64(mask)]
    chosen = (low * (packed >> np.uint64(56))) >> np.uint64(32)
    return np.int64((packed >> (chosen << np.uint64(3))) & np.uint64(7)) + empty * (mask == 0)


@subroutine
def draw_bit(mask: int, word: np.uint64) -> int:
    """The index of a bit of `mask`, drawn by a word of 32 random bits."""
    rest, size = mask, 0
    while rest:
        rest &= rest - 1
        size += 1
    for _ in range(np.int64((word * np.uint64(size)) >> np.uint64(32))):
        mask &= mask - 1
    action = 0
    while not mask >> action & 1:
        action += 1
    return action


@compiled
def seed_streams(streams: Words, seed: int | np.uint64, first_game: int) -> None:
    """Set the state of every stream of every game, a function of (seed, game, stream) only."""
    for game in range(streams.shape[0]):
        key = mix(mix(np.uint64(seed)) + np.uint64(first_game + game))
        for stream in range(streams.shape[1]):
            streams[game, stream] = mix(key + mix(np.uint64(stream + 1)))


@compiled
def seed_starts(streams: Words, games: NDArray[np.intp], seeds: Words) -> None:
    """Set the state of the stream of starts of each of `games` by a seed."""
    for i in range(games.shape[0]):
        streams[games[i], STARTS_STREAM] = mix(mix(seeds[i]) + np.uint64(1))


@compiled
def draw_uniform(streams: Words, stream: int, numbers: Reals) -> None:
    """Fill `numbers` [games] with one uniform float64 from `stream` of every game."""
    for game in range(numbers.shape[0]):
        numbers[game] = next_uniform(streams[game], stream)


def uniform_numbers(streams: Words, stream: int) -> Reals:
    """[games] float64 in [0, 1), the next number from `stream` of every game."""
    numbers = np.empty(len(streams))
    draw_uniform(streams, stream, numbers)
    return numbers
