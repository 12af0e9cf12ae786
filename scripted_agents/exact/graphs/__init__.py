"""The game of cops and robbers."""
