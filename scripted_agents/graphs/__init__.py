"""Cops and robbers, worst-case search, and the difficulty of mazes."""
