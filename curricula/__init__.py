"""Curricula: they choose the stages and levels of training. No imports of `pursuit` or torch."""

from curricula.levels import LevelReplay
from curricula.pools import PoolReplay
from curricula.protocol import Change, Curriculum, Outcomes
from curricula.schedules import (
    Progress,
    Schedule,
    constant,
    cosine,
    exponential,
    linear,
    piecewise,
    step,
)
from curricula.stages import LearningProgress, Scheduled, Shuffled, SuccessGated, Uniform

__all__ = [
    "Change",
    "Curriculum",
    "LearningProgress",
    "LevelReplay",
    "Outcomes",
    "PoolReplay",
    "Progress",
    "Schedule",
    "Scheduled",
    "Shuffled",
    "SuccessGated",
    "Uniform",
    "constant",
    "cosine",
    "exponential",
    "linear",
    "piecewise",
    "step",
]
