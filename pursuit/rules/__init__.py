"""The rule book: how games lie in memory, how they begin, and how they move by a step.

layout        constants, names and shapes of everything
randomness    streams of random numbers
distances     tables and searches
lookups       what an agent does about the nearest of some cells, by tables
starts        where an episode begins
captures      when a chaser captures an evader
step          one step of one game: the rules themselves
batches       the compiled entries over thousands of games
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
