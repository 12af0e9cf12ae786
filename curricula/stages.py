"""Curricula along one axis of difficulty: scheduled, gated, by learning progress; and controls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from curricula.protocol import Change, Outcomes, check_count, check_state
from curricula.schedules import Progress, Schedule


def checked_stages(values: Sequence[float]) -> NDArray[np.float64]:
    """[stages] float64, from easy to hard.

    Raises:
        ValueError: none, two that are equal, or one that is not finite.
    """
    stages = np.asarray(values, dtype=np.float64)
    different = stages.ndim == 1 and len(stages) > 0 and len(np.unique(stages)) == len(stages)
    if not different or not np.isfinite(stages).all():
        raise ValueError(
            f"stages={list(values)}; give at least one value, all different and finite"
        )
    return stages


def stage_numbers(stages: NDArray[np.float64], lessons: NDArray[np.float64]) -> NDArray[np.intp]:
    """[n] the stage that each lesson belongs to.

    Raises:
        ValueError: a lesson that is no stage.
    """
    if len(lessons) == 0:
        return np.zeros(0, dtype=np.intp)
    order = np.argsort(stages)
    places = np.minimum(np.searchsorted(stages[order], lessons), len(stages) - 1)
    numbers = order[places]
    wrong = stages[numbers] != lessons
    if wrong.any():
        raise ValueError(
            f"outcomes of lesson {lessons[wrong][0]:g}, which this curriculum never gave; its "
            f"stages are {', '.join(f'{value:g}' for value in stages)}. Outcomes of another task?"
        )
    return numbers


class Scheduled:
    """Every game gets the value of a schedule.

    Args:
        schedule: from progress to the value.
        whole: round to whole numbers.
    """

    def __init__(self, schedule: Schedule, whole: bool = False) -> None:
        self.schedule, self.whole = schedule, whole
        self.value = self._at(Progress())
        self._logged: float | None = None

    def _at(self, progress: Progress) -> float:
        value = self.schedule(progress)
        return float(round(value)) if self.whole else value

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Follow the schedule. Changes below half a per cent of its range are told together."""
        self.value = self._at(progress)
        schedule = self.schedule
        fine = 0.0 if self.whole else 0.005 * abs(schedule.end - schedule.start)
        before, at_end = self._logged, self.value == schedule.end
        if before is not None and (
            self.value == before or (abs(self.value - before) < fine and not at_end)
        ):
            return []
        self._logged = self.value
        now = getattr(progress, schedule.unit)
        reason = f"{schedule.shape} schedule at {now:.6g} {schedule.unit}"
        return [Change(self.value, self.value, self.value, reason)]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """The same for all."""
        return np.full(num_games, self.value)

    def state_dict(self) -> dict[str, Any]:
        """The value."""
        return {"value": self.value, "logged": self._logged}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it back."""
        check_state("a schedule", state, {"value", "logged"})
        self.value, self._logged = state["value"], state["logged"]


class Uniform:
    """A control: all difficulties at once, from beginning to end.

    Args:
        stages: the values, each as likely.
    """

    def __init__(self, stages: Sequence[float]) -> None:
        self.stages = checked_stages(stages)
        self._told = False

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Nothing ever changes."""
        stage_numbers(self.stages, outcomes.lessons)
        if self._told:
            return []
        self._told = True
        mean, low, high = self.stages.mean(), self.stages.min(), self.stages.max()
        return [Change(float(mean), float(low), float(high), "uniform over all stages")]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Any."""
        # What `rng.choice` draws, without what it makes sure of at every call.
        return self.stages[rng.integers(0, len(self.stages), num_games)]

    def state_dict(self) -> dict[str, Any]:
        """Whether it is in the log."""
        return {"uniform": self._told}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it back."""
        check_state("uniform", state, {"uniform"})
        self._told = state["uniform"]


class Shuffled:
    """A control: the stages one after the other in a random order, then the last one.

    Args:
        stages: the values, from easy to hard.
        length: progress in which every stage has had its turn.
        unit: of that progress.
        seed: of the order.
    """

    def __init__(
        self, stages: Sequence[float], length: float, unit: str = "share", seed: int = 0
    ) -> None:
        self.stages = checked_stages(stages)
        self.order = np.random.default_rng(seed).permutation(len(self.stages))
        self.turn = Schedule("linear", 0.0, float(len(self.stages)), unit, length)
        self.number = 0
        self._told: int | None = None

    @property
    def value(self) -> float:
        """What is played."""
        last = self.number >= len(self.order)
        return float(self.stages[-1] if last else self.stages[self.order[self.number]])

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """The next stage when its time has come."""
        stage_numbers(self.stages, outcomes.lessons)
        self.number = int(self.turn(progress))
        if self.number == self._told:
            return []
        self._told = self.number
        over = self.number >= len(self.order)
        reason = "shuffled stages are over" if over else f"shuffled, turn {self.number + 1}"
        return [Change(self.value, self.value, self.value, reason)]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """The same for all."""
        return np.full(num_games, self.value)

    def state_dict(self) -> dict[str, Any]:
        """The turn."""
        return {"turn": self.number, "told": self._told}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take it back."""
        check_state("shuffled", state, {"turn", "told"})
        self.number, self._told = state["turn"], state["told"]


class SuccessGated:
    """One stage for all games; up when it is mastered and, if wanted, down when it is not.

    Whoever fails by running out of time ends late, so the first episodes to end are nearly all
    successes (and an evader's nearly all failures). Episodes that still run therefore count as
    failures on the way up, and as successes on the way down.

    Args:
        stages: the values, from easy to hard.
        promote_at: share of successes among the episodes of the stage that leads up.
        demote_at: at most this share leads back; 0 never does.
        window: episodes that must have ended before anything is decided.

    Raises:
        ValueError: shares outside [0, 1], `demote_at` not below `promote_at`, or an empty window.
    """

    RUNNING_SHARE = 20
    """Counting begins anew when this many times more episodes have ended than still run."""

    def __init__(
        self,
        stages: Sequence[float],
        promote_at: float = 0.9,
        demote_at: float = 0.0,
        window: int = 1024,
    ) -> None:
        self.stages = checked_stages(stages)
        if not 0.0 <= demote_at < promote_at <= 1.0:
            raise ValueError(
                f"promote_at={promote_at}, demote_at={demote_at}; both lie in [0, 1], and "
                "demote_at below promote_at"
            )
        check_count("window", window, 1, "episode")
        self.promote_at, self.demote_at, self.window = promote_at, demote_at, window
        self.number = self.begun = self.ended = self.won = 0
        self._told = False

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Count the episodes of this stage; those of stages before are over with."""
        own = stage_numbers(self.stages, outcomes.lessons) == self.number
        self.ended += int(own.sum())
        self.won += int(outcomes.successes[own].sum())
        running = max(self.begun - self.ended, 0)
        reason = "" if self._told else "first stage"
        self._told = True
        if self.ended >= self.window:
            low, high = (n / (self.ended + running) for n in (self.won, self.won + running))
            if low >= self.promote_at and self.number < len(self.stages) - 1:
                reason = f"{100 * low:.1f} % success reached {100 * self.promote_at:.0f} %"
                self.number += 1
                self.begun = self.ended = self.won = 0
            elif self.demote_at > 0 and high <= self.demote_at and self.number > 0:
                reason = f"{100 * high:.1f} % success fell to {100 * self.demote_at:.0f} %"
                self.number -= 1
                self.begun = self.ended = self.won = 0
            elif self.ended >= self.RUNNING_SHARE * running:
                self.begun, self.ended, self.won = running, 0, 0
        value = float(self.stages[self.number])
        return [Change(value, value, value, reason)] if reason else []

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """The stage, for all."""
        self.begun += num_games
        return np.full(num_games, self.stages[self.number])

    def state_dict(self) -> dict[str, Any]:
        """The stage, its episodes, and the stages there are."""
        return {
            "stage": self.number,
            "counts": [self.begun, self.ended, self.won],
            "stages": self.stages.tolist(),
            "told": self._told,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        check_state("success-gated", state, {"stage", "counts", "stages", "told"})
        if not np.array_equal(state["stages"], self.stages):
            raise ValueError(
                f"the checkpoint has the stages {state['stages']}, and these are "
                f"{self.stages.tolist()}; resume with the settings that it was made with"
            )
        self.number, self._told = state["stage"], state["told"]
        self.begun, self.ended, self.won = state["counts"]


class LearningProgress:
    """A bandit over stages: those where the return changes most, up or down, are played most.

    Absolute learning progress (Portelas et al., 2019; Matiisen et al., 2017): the distance of two
    moving averages of the return, one `fast` and one `slow`.

    Args:
        stages: the values, from easy to hard.
        fast, slow: shares by which each average moves at an update, 0 < slow < fast <= 1.
        explore_share: share of games in stages drawn uniformly.

    Raises:
        ValueError: shares that are not allowed.
    """

    def __init__(
        self,
        stages: Sequence[float],
        fast: float = 0.1,
        slow: float = 0.02,
        explore_share: float = 0.2,
    ) -> None:
        self.stages = checked_stages(stages)
        if not 0.0 < slow < fast <= 1.0:
            raise ValueError(f"fast={fast}, slow={slow}; 0 < slow < fast <= 1")
        if not 0.0 <= explore_share <= 1.0:
            raise ValueError(f"explore_share={explore_share}; a share lies in [0, 1]")
        self.fast_rate, self.slow_rate, self.explore_share = fast, slow, explore_share
        count = len(self.stages)
        self.fast, self.slow = np.full(count, np.nan), np.full(count, np.nan)
        self.probabilities = np.full(count, 1.0 / count)
        self._sums, self._summed_of = np.zeros(0), np.zeros(0)
        self._top = -1

    def update(self, outcomes: Outcomes, progress: Progress) -> list[Change]:
        """Move the averages of the stages that were played, and weigh the stages anew."""
        numbers, count = stage_numbers(self.stages, outcomes.lessons), len(self.stages)
        played = np.bincount(numbers, minlength=count)
        sums = np.bincount(numbers, weights=outcomes.returns, minlength=count)
        seen = played > 0
        means = sums[seen] / played[seen]
        for average, rate in ((self.fast, self.fast_rate), (self.slow, self.slow_rate)):
            before = np.where(np.isnan(average[seen]), means, average[seen])
            average[seen] = before + rate * (means - before)
        change = np.abs(self.fast - self.slow)
        # What was never played may teach as much as what teaches most.
        known = change[~np.isnan(change)]
        change = np.where(np.isnan(change), known.max() if len(known) else 1.0, change)
        total = change.sum()
        share = change / total if total > 0 else np.full(count, 1.0 / count)
        mixed = self.explore_share / count + (1.0 - self.explore_share) * share
        self.probabilities = mixed / mixed.sum()
        top = int(self.probabilities.argmax())
        if top == self._top:
            return []
        self._top = top
        mean = float(self.probabilities @ self.stages)
        reason = f"stage {self.stages[top]:g} changes most: {change[top]:.4g} of return"
        return [Change(mean, float(self.stages.min()), float(self.stages.max()), reason)]

    def sample(self, num_games: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Stages by their probabilities."""
        # What `rng.choice` draws of them, without what it makes sure of at every call.
        draws = rng.random(num_games)
        return self.stages[self._cumulative().searchsorted(draws, side="right")]

    def _cumulative(self) -> NDArray[np.float64]:
        """[stages], the chances of each stage or one before it."""
        if self._summed_of is not self.probabilities:
            sums = self.probabilities.cumsum()
            self._sums, self._summed_of = sums / sums[-1], self.probabilities
        return self._sums

    def state_dict(self) -> dict[str, Any]:
        """The averages."""
        names = ("fast", "slow", "probabilities")
        return {name: getattr(self, name).copy() for name in names} | {"top": self._top}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        check_state("learning-progress", state, {"fast", "slow", "probabilities", "top"})
        for name in ("fast", "slow", "probabilities"):
            array = np.asarray(state[name], dtype=np.float64)
            if array.shape != self.stages.shape:
                raise ValueError(
                    f"the checkpoint has {len(array)} stages, this curriculum {len(self.stages)}"
                )
            setattr(self, name, array.copy())
        self._top = state["top"]
