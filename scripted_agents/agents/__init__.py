"""Scripted epsilon-greedy agents: A*, runners, agents with limited views, and tables."""
