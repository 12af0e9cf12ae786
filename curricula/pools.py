"""Prioritised replay of a fixed pool of levels with computed scores (exact regret, learnability).

The caller regularly scores the levels returned by `to_score` with the current policy, and stores
the scores with `note`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from curricula.levels import Ranked
from curricula.protocol import Change, Outcomes, Saved, check_count
from curricula.schedules import Progress

UNKNOWN = -1.0
"""The score of a level that has not been scored yet."""


class PoolReplay(Ranked):
    """Prioritised replay of a pool of levels.

    A fraction of the games replays scored levels, with probabilities by rank and age of the scores
    as in `LevelReplay`. The other games use uniformly drawn levels (domain randomisation).

    Args:
        levels: the number of levels.
        num_scored: the number of levels that are scored at a time.
        replay_share: the fraction of games that replay a level.
        temperature, staleness: as in `LevelReplay`.

    Raises:
        ValueError: an invalid value.

    Attributes:
        scores: [levels] float64; UNKNOWN for levels without a score.
    """

    KIND = "this pool"
    STATE = ("scores", "scored_at", "rounds", "reported")

    def __init__(
        self,
        levels: int,
        num_scored: int = 8,
        replay_share: float = 0.5,
        temperature: float = 0.3,
        staleness: float = 0.1,
    ) -> None:
        check_count("levels", levels, 1, "level")
        check_count("num_scored", num_scored, 1, "level")
        super().__init__(replay_share, temperature, staleness)
        self.num_scored, self.rounds = num_scored, 0
        self.scores = np.full(levels, UNKNOWN)
        self.scored_at = np.zeros(levels, dtype=np.int64)

    @property
    def replayed(self) -> NDArray[np.intp]:
        """The indices of the levels that can be replayed."""
        return np.flatnonzero(self.scores != UNKNOWN)

    def probabilities(self) -> NDArray[np.float64]:
        """[replayed] the probability of each of these levels, given that a game replays one."""
        chosen = self.replayed
        return self.chances(self.scores[chosen], self.rounds - self.scored_at[chosen])

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] float64, indices of levels."""
        levels = rng.choice(len(self.scores), num_games).astype(np.float64)
        known = self.replayed
        if len(known):
            again = rng.random(num_games) < self.replay_share
            levels[again] = rng.choice(known, int(again.sum()), p=self.probabilities())
        return levels

    def to_score(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """[n] distinct levels to score with the current policy: levels without a score first, then
        those with the oldest scores."""
        shuffled = rng.permutation(len(self.scores))
        order = np.argsort(self.scored_at[shuffled], kind="stable")
        return shuffled[order][: self.num_scored]

    def note(self, levels: NDArray[np.int64], scores: NDArray[np.float64]) -> None:
        """Store the scores of levels that were scored together.

        Raises:
            ValueError: an unknown level, or a score that is negative or not finite.
        """
        levels, scores = np.asarray(levels), np.asarray(scores, dtype=np.float64)
        if levels.shape != scores.shape or not (np.isfinite(scores) & (scores >= 0)).all():
            raise ValueError(f"scores={scores!r} of levels {levels!r}; give numbers of at least 0")
        if len(levels) and not 0 <= levels.min() <= levels.max() < len(self.scores):
            raise ValueError(f"levels={levels!r}; give indices from 0 to {len(self.scores) - 1}")
        self.rounds += 1
        self.scores[levels], self.scored_at[levels] = scores, self.rounds

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Log the scores twenty times in a run; outcomes do not change them."""
        what = "{count} levels replayed, mean score {mean:.4g}"
        return self._logged(int(20 * progress.share), self.scores[self.replayed], what)

    def _check_loaded(self, state: Saved) -> None:
        if ((state["scores"] < 0) & (state["scores"] != UNKNOWN)).any():
            raise ValueError("the checkpoint has scores below 0; restore it from a copy")
