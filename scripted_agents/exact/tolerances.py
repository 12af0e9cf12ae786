"""When iterations have converged, and when numbers count as equal: the tolerances of solvers."""

TIE = 1e-12
"""Relative difference below which a solver counts two options as equally good."""

EQUAL_VALUES = 1e-9
"""The same for solved values, which have the error of their solver."""

SUM_TOLERANCE = 1e-9
"""Largest difference from 1 of a sum of probabilities that a user gives."""

NETWORK_SUM_TOLERANCE = 1e-4
"""Largest difference from 1 of a sum of probabilities that a network computes."""

DUEL_TOLERANCE = 1e-9
"""Error of a fixed point of a duel, relative to the largest value."""

JOINT_TOLERANCE = 1e-10
"""Error of a converged state of a joint game, relative to the largest value of its set."""

SMALL_GAME_TOLERANCE = 1e-11
"""Error of values of small games without a horizon, relative to the largest; 1e-15 / (1 - discount)
if larger."""

MAX_SWEEPS = 100_000
"""Sweeps over a joint game after which an iteration without a horizon gives up."""

MAX_DUEL_SWEEPS, MAX_DUEL_UPDATES = 200_000, 20_000_000_000
"""The same in a duel: sweeps, and sweeps times values (some minutes)."""

SWEEP_WINDOW = 9
"""Number of consecutive changes from which their rate of decrease is estimated."""

MAX_THREADS = 8
"""Threads of one sweep."""
