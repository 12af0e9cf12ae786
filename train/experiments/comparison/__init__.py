"""Comparison of learners of several libraries on the same tasks, tuned with equally many runs."""
