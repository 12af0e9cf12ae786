"""Evaluation of policies against exact references."""

from train.evaluation.exploitability import Exploitability, exploitability, team_exploitability

__all__ = ["Exploitability", "exploitability", "team_exploitability"]
