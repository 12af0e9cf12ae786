"""Claims, decided by runs: what was claimed, by which rule, and what came of it."""
