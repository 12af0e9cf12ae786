"""Batches of games: the simulator, its saved states, and what policies see of it."""
