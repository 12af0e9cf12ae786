"""Scripted epsilon-greedy agents: A*, runners, searchers, tables."""
