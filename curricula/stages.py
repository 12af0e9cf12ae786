"""Curricula over stages: scheduled, success-gated, by learning progress, and controls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from curricula.protocol import Change, Outcomes, Resumable, Saved, check_count, check_shares
from curricula.schedules import Progress, Schedule


def checked_stages(values: Sequence[float]) -> NDArray[np.float64]:
    """[stages] float64, from easy to hard.

    Raises:
        ValueError: no stages, equal stages, or values that are not finite.
    """
    stages = np.asarray(values, dtype=np.float64)
    different = stages.ndim == 1 and len(stages) > 0 and len(np.unique(stages)) == len(stages)
    if not different or not np.isfinite(stages).all():
        raise ValueError(
            f"stages={list(values)}; give at least one value, all different and finite"
        )
    return stages


def stage_indices(stages: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.intp]:
    """[n] the index in `stages` of each of `values` [n].

    Raises:
        ValueError: a value that is not a stage.
    """
    order = np.argsort(stages)
    places = np.searchsorted(stages, values, sorter=order)
    indices = order[np.minimum(places, len(stages) - 1)]
    wrong = stages[indices] != values
    if wrong.any():
        raise ValueError(
            f"outcomes of unknown stage {values[wrong][0]:g}; the stages of this curriculum are "
            f"{', '.join(f'{stage:g}' for stage in stages)}: give outcomes of these stages"
        )
    return indices


class OneValue(Resumable):
    """A curriculum that samples its current `value` for all games."""

    value: float

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] the current value for all games."""
        return np.full(num_games, self.value)


class Scheduled(OneValue):
    """One value for all games, given by a schedule.

    Args:
        schedule: the value as a function of progress.
        whole: whether to round to whole numbers.
    """

    KIND, STATE = "a schedule", ("value", "logged")

    def __init__(self, schedule: Schedule, whole: bool = False) -> None:
        self.schedule, self.whole = schedule, whole
        self.value = self._at(Progress())
        self.logged: float | None = None

    def _at(self, progress: Progress) -> float:
        value = self.schedule(progress)
        return float(round(value)) if self.whole else value

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Follow the schedule; log changes of at least half a percent of its range."""
        self.value = self._at(progress)
        schedule = self.schedule
        fine = 0.0 if self.whole else 0.005 * abs(schedule.end - schedule.start)
        before, at_end = self.logged, self.value == schedule.end
        if before is not None and (
            self.value == before or (abs(self.value - before) < fine and not at_end)
        ):
            return []
        self.logged = self.value
        now = getattr(progress, schedule.unit)
        reason = f"{schedule.shape} schedule at {now:.6g} {schedule.unit}"
        return [Change(self.value, self.value, self.value, reason)]


class Uniform(Resumable):
    """Stages drawn uniformly during the whole run: a control experiment.

    Args:
        stages: the values, all equally likely.
    """

    KIND, STATE = "uniform", ("reported",)

    def __init__(self, stages: Sequence[float]) -> None:
        self.stages = checked_stages(stages)
        self.reported = False

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Log the distribution once; it does not change."""
        stage_indices(self.stages, outcomes.stages)
        if self.reported:
            return []
        self.reported = True
        mean, low, high = self.stages.mean(), self.stages.min(), self.stages.max()
        return [Change(float(mean), float(low), float(high), "uniform over all stages")]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] uniformly drawn stages."""
        return rng.choice(self.stages, num_games)


class Shuffled(OneValue):
    """All stages in a random order, then the last (hardest) one: a control experiment.

    Args:
        stages: the values, from easy to hard.
        length: the progress at which all stages have been used.
        unit: the unit of progress.
        seed: the seed of the order.
    """

    KIND, STATE = "shuffled", ("turn", "reported")

    def __init__(
        self, stages: Sequence[float], length: float, unit: str = "share", seed: int = 0
    ) -> None:
        self.stages = checked_stages(stages)
        self.order = np.random.default_rng(seed).permutation(len(self.stages))
        self._turns = Schedule("linear", 0.0, float(len(self.stages)), unit, length)
        self.turn = 0
        self.reported: int | None = None

    @property
    def value(self) -> float:  # type: ignore[override]
        """The current stage."""
        last = self.turn >= len(self.order)
        return float(self.stages[-1] if last else self.stages[self.order[self.turn]])

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Change to the next stage when the progress reaches its start."""
        stage_indices(self.stages, outcomes.stages)
        self.turn = int(self._turns(progress))
        if self.turn == self.reported:
            return []
        self.reported = self.turn
        over = self.turn >= len(self.order)
        reason = "shuffled stages are over" if over else f"shuffled, turn {self.turn + 1}"
        return [Change(self.value, self.value, self.value, reason)]


class SuccessGated(Resumable):
    """One stage for all games; promotion at a high success rate, optional demotion at a low one.

    Episodes that fail by truncation are long, so the first episodes to end are nearly all successes
    (for an evader nearly all failures). To avoid this bias, running episodes count as failures in
    the decision on promotion, and as successes in the decision on demotion.

    Args:
        stages: the values, from easy to hard.
        promote_at: the success rate for promotion to the next stage.
        demote_at: the success rate for demotion; 0 means no demotion.
        window: the number of episodes of a stage that must have ended before a decision.

    Raises:
        ValueError: rates outside [0, 1], `demote_at` not below `promote_at`, or an empty window.
    """

    KIND = "success-gated"
    STATE = ("stage", "counts", "stages", "reported")
    RUNNING_SHARE = 20
    """Counts are reset when this many times more episodes have ended than are running."""

    def __init__(
        self,
        stages: Sequence[float],
        promote_at: float = 0.9,
        demote_at: float = 0.0,
        window: int = 1024,
    ) -> None:
        self.stages: list[float] = checked_stages(stages).tolist()
        if not 0.0 <= demote_at < promote_at <= 1.0:
            raise ValueError(
                f"promote_at={promote_at}, demote_at={demote_at}; give numbers in [0, 1], "
                "demote_at below promote_at"
            )
        check_count("window", window, 1, "episode")
        self.promote_at, self.demote_at, self.window = promote_at, demote_at, window
        self.stage = 0
        self.counts = [0, 0, 0]  # episodes of this stage: started, ended, successful
        self.reported = False

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Count the episodes of this stage, and change the stage if a threshold is reached."""
        current = stage_indices(np.array(self.stages), outcomes.stages) == self.stage
        started, ended, won = self.counts
        ended += int(current.sum())
        won += int(outcomes.successes[current].sum())
        running = max(started - ended, 0)
        reason = "" if self.reported else "first stage"
        self.reported = True
        move = 0
        if ended >= self.window:
            low, high = won / (ended + running), (won + running) / (ended + running)
            if low >= self.promote_at and self.stage < len(self.stages) - 1:
                reason = f"{100 * low:.1f} % success reached {100 * self.promote_at:.0f} %"
                move = 1
            elif self.demote_at > 0 and high <= self.demote_at and self.stage > 0:
                reason = f"{100 * high:.1f} % success fell to {100 * self.demote_at:.0f} %"
                move = -1
            elif ended >= self.RUNNING_SHARE * running:
                started, ended, won = running, 0, 0
        self.stage += move
        self.counts = [0, 0, 0] if move else [started, ended, won]
        value = self.stages[self.stage]
        return [Change(value, value, value, reason)] if reason else []

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] the current stage for all games."""
        self.counts[0] += num_games
        return np.full(num_games, self.stages[self.stage])

    def _check_loaded(self, state: Saved) -> None:
        if state["stages"] != self.stages:
            raise ValueError(
                f"the checkpoint has the stages {state['stages']}, this curriculum {self.stages}; "
                "resume with the settings of the checkpoint"
            )


class LearningProgress(Resumable):
    """A bandit that prefers stages on which the return changes most, up or down.

    Absolute learning progress (Portelas et al., 2019; Matiisen et al., 2017): the difference of two
    moving averages of the return, one `fast` and one `slow`.

    Args:
        stages: the values, from easy to hard.
        fast, slow: the step sizes of the averages, 0 < slow < fast <= 1.
        explore_share: the fraction of games with uniformly drawn stages.

    Raises:
        ValueError: an invalid value.
    """

    KIND, STATE = "learning-progress", ("fast", "slow", "probabilities", "top")

    def __init__(
        self,
        stages: Sequence[float],
        fast: float = 0.1,
        slow: float = 0.02,
        explore_share: float = 0.2,
    ) -> None:
        self.stages = checked_stages(stages)
        if not 0.0 < slow < fast <= 1.0:
            raise ValueError(f"fast={fast}, slow={slow}; give 0 < slow < fast <= 1")
        check_shares(explore_share=explore_share)
        self.fast_rate, self.slow_rate, self.explore_share = fast, slow, explore_share
        count = len(self.stages)
        self.fast, self.slow = np.full(count, np.nan), np.full(count, np.nan)
        self.probabilities = np.full(count, 1.0 / count)
        self.top = -1

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Update the averages of the stages of these episodes, and the probabilities."""
        indices, count = stage_indices(self.stages, outcomes.stages), len(self.stages)
        played = np.bincount(indices, minlength=count)
        sums = np.bincount(indices, weights=outcomes.returns, minlength=count)
        seen = played > 0
        means = sums[seen] / played[seen]
        for average, rate in ((self.fast, self.fast_rate), (self.slow, self.slow_rate)):
            before = np.where(np.isnan(average[seen]), means, average[seen])
            average[seen] = before + rate * (means - before)
        change = np.abs(self.fast - self.slow)
        # A stage without episodes gets the largest change of all stages.
        known = change[~np.isnan(change)]
        change = np.where(np.isnan(change), known.max() if len(known) else 1.0, change)
        total = change.sum()
        share = change / total if total > 0 else np.full(count, 1.0 / count)
        mixed = self.explore_share / count + (1.0 - self.explore_share) * share
        self.probabilities = mixed / mixed.sum()
        top = int(self.probabilities.argmax())
        if top == self.top:
            return []
        self.top = top
        mean = float(self.probabilities @ self.stages)
        reason = f"stage {self.stages[top]:g} changes most: {change[top]:.4g} of return"
        return [Change(mean, float(self.stages.min()), float(self.stages.max()), reason)]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """[num_games] stages drawn by their probabilities."""
        return rng.choice(self.stages, num_games, p=self.probabilities)
