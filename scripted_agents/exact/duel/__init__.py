"""Exact solutions of duels (one chaser, one evader): best responses and values."""
