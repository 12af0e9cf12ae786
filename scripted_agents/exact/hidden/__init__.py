"""Partial observability: certified bounds of the optimum, and beliefs."""
