"""Carries the lessons of `curricula` to the games."""
