"""Learning, evaluation and experiments; the only package that imports torch."""
