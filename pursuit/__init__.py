"""Pursuit: mazes, chasers, evaders and runners, with the exact optimum beside every result."""
