"""Prioritised level replay: levels with high scores are repeated more often."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from curricula.protocol import Change, Outcomes, Resumable, Saved, check_count, check_shares
from curricula.schedules import Progress

SCORES = ("regret", "value_loss", "learnability")
MAX_SEED = 2**53
"""Upper bound of level seeds, which float64 represents exactly."""


class Ranked(Resumable):
    """The sampling distribution of prioritised level replay (Jiang et al., 2021).

    P = (1 - staleness) * P_score + staleness * P_stale, P_score proportional to
    (1 / rank)^(1 / temperature) of the scores, rank 1 the highest, and P_stale to the ages.

    Args:
        replay_share: the fraction of games that replay a level.
        temperature: above 0; lower values put more weight on the highest scores.
        staleness: in [0, 1].

    Raises:
        ValueError: an invalid value.
    """

    def __init__(self, replay_share: float, temperature: float, staleness: float) -> None:
        if not 0.0 < temperature < np.inf:
            raise ValueError(f"temperature={temperature}; give a number above 0")
        check_shares(replay_share=replay_share, staleness=staleness)
        self.replay_share, self.temperature, self.staleness = replay_share, temperature, staleness
        self.reported = -1

    def chances(self, scores: NDArray[np.float64], ages: NDArray[np.int64]) -> NDArray[np.float64]:
        """[levels], sampling probabilities of levels with these scores and ages (at least 0)."""
        by_score = np.empty(len(scores))
        ranks = np.arange(1.0, len(scores) + 1.0)
        by_score[np.argsort(-scores, kind="stable")] = ranks ** (-1.0 / self.temperature)
        by_age = ages.astype(np.float64) if ages.sum() > 0 else np.ones(len(ages))
        mixed = (1.0 - self.staleness) * by_score / by_score.sum()
        return mixed + self.staleness * by_age / by_age.sum()

    def _logged(self, mark: int, scores: NDArray[np.float64], what: str) -> list[Change]:
        """The change to log; none if `mark` is the same as at the last log."""
        if mark == self.reported or not len(scores):
            return []
        self.reported = mark
        mean, low, high = float(scores.mean()), float(scores.min()), float(scores.max())
        return [Change(mean, low, high, what.format(count=len(scores), mean=mean))]


class LevelReplay(Ranked):
    """Prioritised level replay (Jiang et al., 2021) over seeds of levels.

    A fraction of the games replays levels of a buffer; the other games get new levels. The
    probability of a level depends on the rank of its score and on its age in updates (see
    `Ranked`). A new level replaces the least probable one if its score is higher.

    Args:
        score: "regret" (shortfall of the last episode from the exact optimum), "value_loss"
            (mean positive advantage of the last episode) or "learnability" (p(1 - p), where p is
            the posterior mean of the level's success rate under a uniform prior; Rutherford et
            al., 2024).
        capacity: the size of the buffer in levels.
        replay_share: the fraction of games that replay a level, once the buffer is half full.
        temperature: above 0; lower values put more weight on the highest scores.
        staleness: in [0, 1].

    Raises:
        ValueError: an invalid value.
    """

    KIND = "level replay"
    GROWING = ("seeds", "scores", "played", "counts", "cumulative")
    STATE = (*GROWING, "updates", "reported")

    def __init__(
        self,
        score: str = "regret",
        capacity: int = 2048,
        replay_share: float = 0.5,
        temperature: float = 0.3,
        staleness: float = 0.1,
    ) -> None:
        if score not in SCORES:
            raise ValueError(f"unknown level score {score!r}; one of {', '.join(SCORES)}")
        check_count("capacity", capacity, 2, "levels")
        super().__init__(replay_share, temperature, staleness)
        self.score, self.capacity = score, capacity
        self.seeds = np.zeros(0)
        self.scores = np.zeros(0)
        self.played = np.zeros(0, dtype=np.int64)
        self.counts = np.zeros((2, 0), dtype=np.int64)
        self.updates = 0
        self.cumulative = np.zeros(0)

    @property
    def replays(self) -> bool:
        """Whether the buffer is full enough to replay levels."""
        return 2 * len(self.seeds) >= self.capacity

    def probabilities(self) -> NDArray[np.float64]:
        """[levels] the probability of each level of the buffer, given that a game replays one."""
        return self.chances(self.scores, self.updates - self.played)

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Score the levels of these episodes, and keep those with the highest scores."""
        self.updates += 1
        if len(outcomes):
            self._note(outcomes)
        if len(self.seeds):
            self.cumulative = self.probabilities().cumsum()
        what = f"{{count}} levels, mean {self.score} {{mean:.4g}}"
        what += "" if self.replays else ", no replay yet"
        return self._logged(int(self.replays) + int(20 * progress.share), self.scores, what)

    def _note(self, outcomes: Outcomes) -> None:
        seeds = outcomes.stages
        wrong = ~((seeds >= 0) & (seeds < MAX_SEED) & (seeds % 1 == 0))  # also NaN
        if wrong.any():
            raise ValueError(
                f"outcomes of level {seeds[wrong][0]:g}; seeds are whole numbers from 0 to "
                f"{MAX_SEED - 1}: give outcomes of levels of this curriculum"
            )
        # Scores use the last episode of each level, success rates all of them.
        levels, back, of_level = np.unique(seeds[::-1], return_index=True, return_inverse=True)
        last = len(seeds) - 1 - back
        plays = np.bincount(of_level)
        wins = np.bincount(of_level, weights=outcomes.successes[::-1]).astype(np.int64)
        counts = np.stack([wins, plays])
        _, slots, known = np.intersect1d(
            self.seeds, levels, assume_unique=True, return_indices=True
        )
        self.counts[:, slots] += counts[:, known]
        counts[:, known] = self.counts[:, slots]
        scores = self._scores(outcomes, last, counts)
        self.scores[slots], self.played[slots] = scores[known], self.updates
        new = np.ones(len(levels), dtype=bool)
        new[known] = False
        self._insert(levels[new], scores[new], counts[:, new])

    def _scores(
        self, outcomes: Outcomes, last: NDArray[np.intp], counts: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        if self.score == "learnability":
            rate = (counts[0] + 1.0) / (counts[1] + 2.0)
            return np.asarray(rate * (1.0 - rate))
        values = outcomes.regrets if self.score == "regret" else outcomes.errors
        if np.isnan(values).any():
            raise ValueError(
                f"level score {self.score!r} needs "
                + (
                    "the exact optimum, which is not known for this task"
                    if self.score == "regret"
                    else "advantages, which this learner does not compute"
                )
                + '; use score="learnability" (--level-score learnability)'
            )
        return values[last]

    def _insert(
        self, seeds: NDArray[np.float64], scores: NDArray[np.float64], counts: NDArray[np.int64]
    ) -> None:
        free = min(self.capacity - len(self.seeds), len(seeds))
        self.seeds = np.concatenate([self.seeds, seeds[:free]])
        self.scores = np.concatenate([self.scores, scores[:free]])
        self.played = np.concatenate([self.played, np.full(free, self.updates)])
        self.counts = np.concatenate([self.counts, counts[:, :free]], axis=1)
        seeds, scores, counts = seeds[free:], scores[free:], counts[:, free:]
        # Pair the best new levels with the least probable old ones. A new level with a score below
        # all old scores replaces none.
        best = np.argsort(-scores, kind="stable")
        best = best[: min(np.count_nonzero(scores > self.scores.min()), len(self.scores))]
        if not len(best):
            return
        weak = np.argsort(self.probabilities(), kind="stable")[: len(best)]
        better = scores[best] > self.scores[weak]
        into, new = weak[better], best[better]
        self.seeds[into], self.scores[into] = seeds[new], scores[new]
        self.played[into], self.counts[:, into] = self.updates, counts[:, new]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] seeds of levels, some from the buffer and the others new."""
        seeds = rng.integers(0, MAX_SEED, num_games).astype(np.float64)
        if self.replays and len(self.cumulative):
            again = (rng.random(num_games) < self.replay_share).nonzero()[0]
            draws = rng.random(len(again)) * self.cumulative[-1]
            chosen = self.cumulative.searchsorted(draws, side="right")
            seeds[again] = self.seeds[np.minimum(chosen, len(self.seeds) - 1)]
        return seeds

    def _check_loaded(self, state: Saved) -> None:
        rows = {state[name].shape[-1] for name in ("seeds", "scores", "played", "counts")}
        seeds = state["seeds"]
        if (
            len(rows) > 1
            or len(state["cumulative"]) > len(seeds)
            or not ((seeds >= 0) & (seeds < MAX_SEED) & (seeds % 1 == 0)).all()
        ):
            raise ValueError(
                "the checkpoint needs one seed, score and count for each level; restore it from a "
                "copy"
            )
