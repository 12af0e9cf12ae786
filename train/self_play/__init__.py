"""Two sides that learn from each other: pools, leagues, ratings."""
