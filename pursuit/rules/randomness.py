"""Random numbers: streams of 64-bit words, each a function of (seed, game, stream) alone.

SplitMix64 (Steele, Lea and Flood, 2014): a stream is a counter, a number is its mixed value. The
order of the streams of a game is drawn in `layout`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.compiled import compiled, inlined
from pursuit.rules.layout import STARTS_STREAM, STAY

GOLDEN = 0x9E3779B97F4A7C15
"""2**64 divided by the golden ratio, made odd: how far a stream moves on."""


_MASKS = [[action for action in range(5) if mask >> action & 1] for mask in range(32)]
MASK_SIZE = np.array([len(actions) for actions in _MASKS])
MASK_ITEM = np.array([actions + [0] * (5 - len(actions)) for actions in _MASKS])


@inlined
def mix(word: Any) -> Any:
    """The output function of SplitMix64 (Steele, Lea and Flood, 2014)."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@inlined
def next_word(streams: Any, stream: int) -> Any:
    """The next 64 random bits of `streams[stream]`, which moves on."""
    streams[stream] += np.uint64(GOLDEN)
    return mix(streams[stream])


@inlined
def next_below(streams: Any, stream: int, bound: int) -> int:
    """A uniform integer from 0 to bound - 1 (bias below bound / 2**32)."""
    return np.int64(
        ((next_word(streams, stream) >> np.uint64(32)) * np.uint64(bound)) >> np.uint64(32)
    )


@inlined
def next_uniform(streams: Any, stream: int) -> float:
    """A uniform float64 in [0, 1)."""
    return np.float64(next_word(streams, stream) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inlined
def draw_action(
    greedy: int, every: int, epsilon: float, stay_action: bool, streams: Any, stream: int
) -> int:
    """A uniformly random action of the mask `greedy`, or, with probability `epsilon`, of `every`.

    One random word serves both draws. Staying, or a bump, where the mask is empty.
    """
    word = next_word(streams, stream)
    mask = greedy
    # Signed: the processor has no conversion of unsigned words.
    if np.float64(np.int64(word >> np.uint64(32))) * 2.0**-32 < epsilon:
        mask = every
    if mask == 0:
        return STAY if stay_action else 0
    number = np.uint64(mask)
    chosen = ((word & np.uint64(0xFFFFFFFF)) * np.uint64(MASK_SIZE[number])) >> np.uint64(32)
    return np.int64(MASK_ITEM[number, chosen])


@compiled
def seed_streams(streams: Any, seed: int, first_game: int) -> None:
    """Give every stream of every game its own state, a function of (seed, game, stream) alone."""
    for game in range(streams.shape[0]):
        key = mix(mix(np.uint64(seed)) + np.uint64(first_game + game))
        for stream in range(streams.shape[1]):
            streams[game, stream] = mix(key + mix(np.uint64(stream + 1)))


@compiled
def seed_starts(streams: Any, games: Any, seeds: Any) -> None:
    """Give the stream of starts of each of `games` the state that belongs to a seed."""
    for i in range(games.shape[0]):
        streams[games[i], STARTS_STREAM] = mix(mix(seeds[i]) + np.uint64(1))


@compiled
def draw_uniform(streams: Any, stream: int, numbers: Any) -> None:
    """Fill `numbers` [games] with one uniform float64 from `stream` of every game."""
    for game in range(numbers.shape[0]):
        numbers[game] = next_uniform(streams[game], stream)
