"""Exact solvers: optima, equilibria and bounds, the limits of their sizes, and references."""
