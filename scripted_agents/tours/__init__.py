"""Shortest paths, and shortest tours through several goals."""
