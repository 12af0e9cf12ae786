"""Shortest paths, shortest tours through several goals, and the agent that follows them."""
