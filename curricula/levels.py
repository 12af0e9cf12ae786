"""Prioritised level replay: levels that teach are kept and played again."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curricula.protocol import Change, Outcomes, check_count, check_state
from curricula.schedules import Progress

SCORES = ("regret", "value_loss", "learnability")
MAX_SEED = 2**53
"""Seeds of levels lie below: a float64 holds them exactly."""


def rank_probabilities(
    scores: NDArray[np.float64], ages: NDArray[np.float64], temperature: float, staleness: float
) -> NDArray[np.float64]:
    """[levels], the chances with which prioritised level replay draws them (Jiang et al., 2021).

    Args:
        scores: [levels]; (1 / rank)^(1 / temperature) counts of them, rank 1 the highest.
        ages: [levels], at least 0; their share counts with a weight of `staleness`.
        temperature, staleness: as in `LevelReplay`.
    """
    by_score = np.empty(len(scores))
    by_score[np.argsort(-scores, kind="stable")] = _rank_weights(len(scores), temperature)
    by_age = ages if ages.sum() > 0 else np.ones(len(ages))
    mixed = (1.0 - staleness) * by_score / by_score.sum()
    return mixed + staleness * by_age / by_age.sum()


@lru_cache(maxsize=8)
def _rank_weights(count: int, temperature: float) -> NDArray[np.float64]:
    """[count] (1 / rank)^(1 / temperature) of ranks 1, 2, ..."""
    return np.arange(1.0, count + 1.0) ** (-1.0 / temperature)


def least(values: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """[count] places of the least of `values`, from the least on; of equal ones the first."""
    if count >= len(values):
        return np.argsort(values, kind="stable")
    near = np.flatnonzero(values <= np.partition(values, count - 1)[count - 1])
    return near[np.argsort(values[near], kind="stable")][:count]


class LevelReplay:
    """Prioritised level replay (Jiang et al., 2021) over seeds of levels.

    A share of the games plays levels of a buffer again, the others new ones. A level of the buffer
    is drawn by the rank of its score, mixed with how long ago it was last played:
    P = (1 - staleness) * P_score + staleness * P_stale, P_score proportional to
    (1 / rank)^(1 / temperature), P_stale to the updates since. A new level replaces the one that is
    least likely, if its score is higher.

    Args:
        score: "regret" (how far the last episode fell short of the exact optimum), "value_loss"
            (mean positive advantage of the last episode) or "learnability" (p(1 - p), p the mean of
            the posterior of the level's success rate under a uniform prior; Rutherford et al.,
            2024).
        capacity: of the buffer.
        replay_share: share of games that replay, once the buffer is half full.
        temperature: above 0; the lower, the more only the highest scores count.
        staleness: in [0, 1].

    Raises:
        ValueError: a value that is not allowed.
    """

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
        if not 0.0 < temperature < np.inf:
            raise ValueError(f"temperature={temperature}; it is above 0")
        for name, share in (("replay_share", replay_share), ("staleness", staleness)):
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name}={share}; a share lies in [0, 1]")
        self.score, self.capacity, self.replay_share = score, capacity, replay_share
        self.temperature, self.staleness = temperature, staleness
        self.seeds = np.zeros(0)
        self.scores = np.zeros(0)
        self.played = np.zeros(0, dtype=np.int64)
        self.counts = np.zeros((2, 0), dtype=np.int64)
        self.updates = 0
        self._cumulative = np.zeros(0)
        self._told = -1

    @property
    def replays(self) -> bool:
        """Whether the buffer is full enough to be played from."""
        return 2 * len(self.seeds) >= self.capacity

    def probabilities(self) -> NDArray[np.float64]:
        """[levels] of the buffer being drawn for a game that replays."""
        ages = (self.updates - self.played).astype(np.float64)
        return rank_probabilities(self.scores, ages, self.temperature, self.staleness)

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Score the levels that were played, and keep the better ones."""
        self.updates += 1
        if len(outcomes):
            self._note(outcomes)
        if len(self.seeds):
            self._cumulative = self.probabilities().cumsum()
        mark = int(self.replays) + int(20 * progress.share)
        if mark == self._told or not len(self.seeds):
            return []
        self._told = mark
        mean = float(self.scores.mean())
        what = f"{len(self.seeds)} levels, mean {self.score} {mean:.4g}"
        low, high = float(self.scores.min()), float(self.scores.max())
        return [Change(mean, low, high, what + ("" if self.replays else ", no replay yet"))]

    def _note(self, outcomes: Outcomes) -> None:
        seeds = outcomes.lessons
        wrong = ~((seeds >= 0) & (seeds < MAX_SEED) & (seeds % 1 == 0))  # NaN is wrong, too
        if wrong.any():
            raise ValueError(
                f"outcomes of lesson {seeds[wrong][0]:g}, which is no seed of a level: those are "
                f"whole numbers from 0 to {MAX_SEED - 1}; give outcomes of its own lessons"
            )
        # The last episode of each level counts; successes of all of them do.
        levels, back, of_level = np.unique(seeds[::-1], return_index=True, return_inverse=True)
        last = len(seeds) - 1 - back
        plays = np.bincount(of_level)
        wins = np.bincount(of_level, weights=outcomes.successes[::-1]).astype(np.int64)
        counts = np.stack([wins, plays])
        order = np.argsort(self.seeds)
        places = np.searchsorted(self.seeds[order], levels)
        slots = order[np.minimum(places, len(order) - 1)] if len(order) else np.zeros(0, np.intp)
        known = np.zeros(len(levels), dtype=bool)
        if len(order):
            known = self.seeds[slots] == levels
            self.counts[:, slots[known]] += counts[:, known]
            counts[:, known] = self.counts[:, slots[known]]
        scores = self._scores(outcomes, last, counts)
        if known.any():
            self.scores[slots[known]] = scores[known]
            self.played[slots[known]] = self.updates
        self._insert(levels[~known], scores[~known], counts[:, ~known])

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
                    else "advantages, which this learner has not"
                )
                + "; take learnability"
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
        if not len(seeds):
            return
        # The best of the new ones against the least likely of the old ones, pair by pair. One that
        # is below all of the old ones, and whatever is worse, replaces none.
        best = np.argsort(-scores, kind="stable")
        best = best[: min(np.count_nonzero(scores > self.scores.min()), len(self.scores))]
        if not len(best):
            return
        weak = least(self.probabilities(), len(best))
        better = scores[best] > self.scores[weak]
        into, new = weak[better], best[better]
        self.seeds[into], self.scores[into] = seeds[new], scores[new]
        self.played[into], self.counts[:, into] = self.updates, counts[:, new]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Seeds of levels: some of the buffer, the others new."""
        # A float64 has 53 random bits, so these are whole, and every seed is as likely. They are
        # those of `rng.integers(0, MAX_SEED, num_games)`, without what that makes sure of.
        seeds = rng.random(num_games) * MAX_SEED
        if self.replays and len(self._cumulative):
            again = (rng.random(num_games) < self.replay_share).nonzero()[0]
            draws = rng.random(len(again)) * self._cumulative[-1]
            chosen = self._cumulative.searchsorted(draws, side="right")
            seeds[again] = self.seeds[np.minimum(chosen, len(self.seeds) - 1)]
        return seeds

    def best(self, count: int) -> list[tuple[int, float, int, int]]:
        """(seed, score, successes, episodes) of the levels with the highest scores."""
        order = np.argsort(-self.scores, kind="stable")[:count]
        wins, plays = self.counts
        return [
            (int(self.seeds[i]), float(self.scores[i]), int(wins[i]), int(plays[i])) for i in order
        ]

    def state_dict(self) -> dict[str, Any]:
        """The buffer."""
        return {
            "seeds": self.seeds,
            "scores": self.scores,
            "played": self.played,
            "counts": self.counts,
            "updates": self.updates,
            "cumulative": self._cumulative,
            "told": self._told,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it back; ValueError where it is that of something else."""
        check_state("level replay", state, set(self.state_dict()))
        rows = {np.shape(state[name])[-1] for name in ("seeds", "scores", "played", "counts")}
        seeds, cumulative = np.asarray(state["seeds"]), np.asarray(state["cumulative"])
        if (
            len(rows) > 1
            or len(cumulative) > len(seeds)
            or not ((seeds >= 0) & (seeds < MAX_SEED) & (seeds % 1 == 0)).all()
        ):
            raise ValueError(
                "the levels of the checkpoint have not one seed, score and count each; restore it "
                "from a copy"
            )
        self.seeds, self.scores = np.array(state["seeds"]), np.array(state["scores"])
        self.played, self.counts = np.array(state["played"]), np.array(state["counts"])
        self._cumulative = np.array(state["cumulative"])
        self.updates, self._told = state["updates"], state["told"]
