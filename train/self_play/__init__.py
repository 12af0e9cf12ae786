"""Self-play of two sides: opponent pools, leagues, ratings."""
