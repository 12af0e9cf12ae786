"""Shortest paths and travelling-salesman paths."""
