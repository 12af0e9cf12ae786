"""Cops and robbers."""
