"""Applies the curricula of `curricula` to training games."""
