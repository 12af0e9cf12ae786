"""Replay of a pool of levels by scores that are computed, not played: exact regret, learnability.

Levels are numbered. Whoever carries this to a world is asked to judge some of them now and then
(`to_judge`), with the learner as it is, and tells the scores (`note`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from curricula.levels import Ranked
from curricula.protocol import Change, Outcomes, check_count
from curricula.schedules import Progress

UNKNOWN = -1.0
"""The score of a level that was never judged."""


class PoolReplay(Ranked):
    """Prioritised replay of a pool of levels.

    A share of the games plays levels that were judged, drawn by the rank of their scores mixed with
    how long ago they were judged, as in `LevelReplay`; the others play levels drawn uniformly,
    which is domain randomisation.

    Args:
        levels: how many there are.
        judged: levels that are judged at a time.
        replay_share: share of games that replay.
        temperature, staleness: as in `LevelReplay`.

    Raises:
        ValueError: a value that is not allowed.

    Attributes:
        scores: [levels] float64; UNKNOWN before a level is judged.
    """

    KIND = "this pool"
    STATE = ("scores", "judged_at", "rounds", "told")

    def __init__(
        self,
        levels: int,
        judged: int = 8,
        replay_share: float = 0.5,
        temperature: float = 0.3,
        staleness: float = 0.1,
    ) -> None:
        check_count("levels", levels, 1, "level")
        check_count("judged", judged, 1, "level")
        super().__init__(replay_share, temperature, staleness)
        self.judged, self.rounds = judged, 0
        self.scores = np.full(levels, UNKNOWN)
        self.judged_at = np.zeros(levels, dtype=np.int64)

    @property
    def replayed(self) -> NDArray[np.intp]:
        """The numbers of the levels that may be replayed."""
        return np.flatnonzero(self.scores != UNKNOWN)

    def probabilities(self) -> NDArray[np.float64]:
        """[replayed] of being drawn for a game that replays."""
        chosen = self.replayed
        return self.chances(self.scores[chosen], self.rounds - self.judged_at[chosen])

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] float64, numbers of levels."""
        levels = rng.choice(len(self.scores), num_games).astype(np.float64)
        known = self.replayed
        if len(known):
            again = rng.random(num_games) < self.replay_share
            levels[again] = rng.choice(known, int(again.sum()), p=self.probabilities())
        return levels

    def to_judge(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """[n] different levels that are to be judged with the learner as it is now: those that
        never were judged first, then those that were judged longest ago."""
        shuffled = rng.permutation(len(self.scores))
        order = np.argsort(self.judged_at[shuffled], kind="stable")
        return shuffled[order][: self.judged]

    def note(self, levels: NDArray[np.int64], scores: NDArray[np.float64]) -> None:
        """Take in the scores of levels that were judged together.

        Raises:
            ValueError: a level that is none, or a score that is no number of 0 or more.
        """
        levels, scores = np.asarray(levels), np.asarray(scores, dtype=np.float64)
        if levels.shape != scores.shape or not (np.isfinite(scores) & (scores >= 0)).all():
            raise ValueError(f"scores={scores!r} of levels {levels!r}; a number of 0 or more each")
        if len(levels) and not 0 <= levels.min() <= levels.max() < len(self.scores):
            raise ValueError(f"levels={levels!r}; they are 0 to {len(self.scores) - 1}")
        self.rounds += 1
        self.scores[levels], self.judged_at[levels] = scores, self.rounds

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Nothing is learned from episodes; what is replayed is logged twenty times a run."""
        what = "{count} levels replayed, mean score {mean:.4g}"
        return self._logged(int(20 * progress.share), self.scores[self.replayed], what)

    def _check_loaded(self, state: dict[str, Any]) -> None:
        if ((state["scores"] < 0) & (state["scores"] != UNKNOWN)).any():
            raise ValueError("the checkpoint has scores below 0; restore it from a copy")
