"""Recorded episodes: recorder, files, and HTML viewer."""
