"""Replay of a pool of levels by scores that are computed, not played: exact regret, learnability.

Levels are numbered. Whoever carries this to a world is asked to judge some of them now and then
(`to_judge`), with the learner as it is, and tells the scores (`note`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curricula.levels import Ranked
from curricula.protocol import Change, Outcomes, check_count, check_shares
from curricula.schedules import Progress

BASE, UNKNOWN = -1, -1.0
"""The parent of a level that is no edit of another; the score of one that was never judged."""


class PoolReplay(Ranked):
    """Prioritised replay of a pool of levels, and of edits of them that are harder.

    A share of the games plays levels that were judged, drawn by the rank of their scores mixed with
    how long ago they were judged, as in `LevelReplay`; the others play base levels drawn uniformly,
    which is domain randomisation.

    A level may be an edit of another, its parent. An edit is not played until it was judged and has
    a higher score than its parent: so the pool climbs to where the learner is weakest, edit by edit
    (ACCEL; Parker-Holder et al., 2022). At most `capacity` levels are replayed: of more, those with
    the lowest scores are given up, and may come back when they are judged anew.

    Args:
        parents: for each level the number of the one that it is an edit of, or BASE.
        judged: levels that are judged at a time.
        replay_share: share of games that replay.
        temperature, staleness: as in `LevelReplay`.
        edit_share: of those that are judged, how many are edits, where there are any.
        capacity: levels that are replayed, at most; as many as base levels if None.

    Raises:
        ValueError: a value that is not allowed.

    Attributes:
        scores: [levels] float64; UNKNOWN before a level is judged.
        kept: [levels] bool, whether it may be replayed.
    """

    KIND = "this pool"
    STATE = ("scores", "judged_at", "kept", "rounds", "accepted", "told")

    def __init__(
        self,
        parents: Sequence[int],
        judged: int = 8,
        replay_share: float = 0.5,
        temperature: float = 0.3,
        staleness: float = 0.1,
        edit_share: float = 0.5,
        capacity: int | None = None,
    ) -> None:
        self.parents = np.asarray(parents, dtype=np.int64)
        levels = len(self.parents)
        if not levels or not ((self.parents >= BASE) & (self.parents < np.arange(levels))).all():
            raise ValueError(
                f"parents={parents!r}; of each level the number of one before it, or {BASE}"
            )
        check_count("judged", judged, 1, "level")
        super().__init__(replay_share, temperature, staleness)
        check_shares(edit_share=edit_share)
        self.base = np.flatnonzero(self.parents == BASE)
        if capacity is not None:
            check_count("capacity", capacity, 1, "level")
        self.capacity = len(self.base) if capacity is None else capacity
        self.judged, self.edit_share = judged, edit_share
        self.scores = np.full(levels, UNKNOWN)
        self.judged_at = np.zeros(levels, dtype=np.int64)
        self.kept = np.zeros(levels, dtype=bool)
        self.rounds, self.accepted = 0, 0

    @property
    def replayed(self) -> NDArray[np.intp]:
        """The numbers of the levels that may be replayed."""
        return np.flatnonzero(self.kept)

    def probabilities(self) -> NDArray[np.float64]:
        """[replayed] of being drawn for a game that replays."""
        chosen = self.replayed
        return self.chances(self.scores[chosen], self.rounds - self.judged_at[chosen])

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] float64, numbers of levels."""
        levels = rng.choice(self.base, num_games).astype(np.float64)
        if self.kept.any():
            again = rng.random(num_games) < self.replay_share
            chances = self.probabilities()
            levels[again] = rng.choice(self.replayed, int(again.sum()), p=chances)
        return levels

    def to_judge(self, rng: np.random.Generator) -> NDArray[np.int64]:
        """[n] different levels that are to be judged with the learner as it is now.

        Edits of levels that are replayed, by their chances; for the rest base levels: those that
        never were judged first, then those that were judged longest ago. The parent of an edit is
        judged with it, for the two are compared.
        """
        chosen: dict[int, None] = {}
        edits = round(self.edit_share * self.judged) if (self.parents != BASE).any() else 0
        if edits and self.kept.any():
            parents = rng.choice(self.replayed, edits, p=self.probabilities())
            for parent in parents.tolist():
                children = np.flatnonzero((self.parents == parent) & ~self.kept)
                if len(children):
                    chosen |= {parent: None, int(rng.choice(children)): None}
        known = np.concatenate([self.base, self.replayed])
        shuffled = rng.permutation(np.unique(known))
        never = self.scores[shuffled] == UNKNOWN
        order = np.lexsort((self.judged_at[shuffled], ~never))
        for level in shuffled[order].tolist():
            if len(chosen) >= self.judged:
                break
            chosen[level] = None
        return np.array(list(chosen), dtype=np.int64)

    def note(self, levels: NDArray[np.int64], scores: NDArray[np.float64]) -> None:
        """Take in the scores of levels that were judged together.

        Raises:
            ValueError: a level that is none, or a score that is no number of 0 or more.
        """
        levels, scores = np.asarray(levels), np.asarray(scores, dtype=np.float64)
        if levels.shape != scores.shape or not (np.isfinite(scores) & (scores >= 0)).all():
            raise ValueError(f"scores={scores!r} of levels {levels!r}; a number of 0 or more each")
        if len(levels) and not 0 <= levels.min() <= levels.max() < len(self.parents):
            raise ValueError(f"levels={levels!r}; they are 0 to {len(self.parents) - 1}")
        self.rounds += 1
        self.scores[levels], self.judged_at[levels] = scores, self.rounds
        for level in levels.tolist():
            parent = int(self.parents[level])
            harder = parent == BASE or self.scores[level] > self.scores[parent]
            if harder and not self.kept[level]:
                self.accepted += parent != BASE
                self.kept[level] = True
        chosen = self.replayed
        if len(chosen) > self.capacity:
            weak = np.argsort(self.scores[chosen], kind="stable")[: len(chosen) - self.capacity]
            self.kept[chosen[weak]] = False

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Nothing is learned from episodes; what is replayed is logged twenty times a run."""
        what = "{count} levels replayed, mean score {mean:.4g}"
        if (self.parents != BASE).any():
            edits = int((self.parents[self.replayed] != BASE).sum())
            what += f", {edits} of them edits, {self.accepted} accepted so far"
        return self._logged(int(20 * progress.share), self.scores[self.replayed], what)

    def _check_loaded(self, state: dict[str, Any]) -> None:
        if (state["scores"][state["kept"]] < 0).any():
            raise ValueError(
                "the checkpoint replays levels without a score; restore it from a copy"
            )
