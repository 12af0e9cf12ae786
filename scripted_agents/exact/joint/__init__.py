"""Whole games over their joint states: teams, races, heists, and zero-sum equilibria."""
