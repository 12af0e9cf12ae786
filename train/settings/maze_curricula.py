"""The settings of curricula that choose among mazes by exact scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from train.settings.curriculum_form import CurriculumSettings, check_counts, check_temperature


@dataclass(frozen=True)
class MazeReplaySettings(CurriculumSettings):
    """Mazes of a suite by their exact regret: those where the policy, as it is, falls short of the
    optimum most are played most; the other games are in mazes drawn uniformly."""

    SCORE: ClassVar[str] = "regret"
    replay_share: float = 0.5
    """Share of games in mazes that were judged; the others are in mazes drawn uniformly."""
    level_temperature: float = 0.3
    """The lower, the more only the highest scores count."""
    staleness: float = 0.1
    """Weight of mazes that were not judged for long."""
    judged: int = 8
    """Mazes whose scores are computed at a time: from all starts, without playing."""
    judge_every: int = 25_000
    """Frames from one time to the next."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, judged=1, judge_every=1)
        check_temperature(self.level_temperature)


@dataclass(frozen=True)
class MazeLearnabilitySettings(MazeReplaySettings):
    """The same by exact learnability: the mean over starts of p(1 - p), p the chance to win."""

    SCORE: ClassVar[str] = "learnability"


@dataclass(frozen=True)
class MazeEditingSettings(MazeReplaySettings):
    """The same by exact regret, over a pool that is edited: an edit of a maze is taken in where its
    regret is higher (after ACCEL; Parker-Holder et al., 2022). Edits are made before the run."""

    edit_share: float = 0.5
    """Share of edits among the mazes that are judged."""
    edit_children: int = 3
    """Edits that are made of each maze, and of each of those."""
    edit_depth: int = 2
    """Generations of edits."""
    edit_walls: int = 3
    """Inner walls that an edit opens or closes, drawn uniformly; the maze stays in one part."""
    edit_seed: int = 0
    """Of the edits."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self, edit_children=1, edit_depth=1, edit_walls=1, edit_seed=0)
