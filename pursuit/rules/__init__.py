"""The rules of the games: their memory layout, their starts and their steps.

layout        constants, names and shapes of everything
randomness    streams of random numbers
distances     tables and searches
lookups       moves towards or away from the nearest of several cells, by tables
starts        start placements of episodes
captures      when a chaser captures an evader
step          the rules of one step of one game
visibility    which cells an agent sees
batches       the compiled functions over batches of games
"""

from pursuit.rules.batches import start_games, step_games_of
from pursuit.rules.captures import captured
from pursuit.rules.distances import (
    all_distances,
    breadth_first,
    longest_distance,
)
from pursuit.rules.layout import (
    CAPTURED,
    CHASER,
    COLLECTED,
    EAST,
    EVADER,
    NORTH,
    RUNNER,
    SOUTH,
    STAY,
    UNREACHABLE,
    WAS_CAPTURED,
    WEST,
    Games,
)
from pursuit.rules.randomness import draw_uniform, next_below, next_uniform, seed_streams

__all__ = [
    "CAPTURED",
    "CHASER",
    "COLLECTED",
    "EAST",
    "EVADER",
    "NORTH",
    "RUNNER",
    "SOUTH",
    "STAY",
    "UNREACHABLE",
    "WAS_CAPTURED",
    "WEST",
    "Games",
    "all_distances",
    "breadth_first",
    "captured",
    "draw_uniform",
    "longest_distance",
    "next_below",
    "next_uniform",
    "seed_streams",
    "start_games",
    "step_games_of",
]
