"""The training loop, run folders, and the objects that are built from settings."""
