"""Recorded games: files, and the page that shows them."""
