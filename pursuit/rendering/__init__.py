"""Rendering of games as text, images, animations and windows."""
