"""The budget of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pursuit.compilation.compiler import now_without_compilation
from train.runs.forms import Longer
from train.settings.self_play import WholeSettings


@dataclass(frozen=True)
class Budget:
    """The budget of a run: seconds of training, or frames; and torch's threads.

    A run ends with the iteration that reaches its budget; with `within` before the one that would
    exceed it, if that takes as long as the last one.

    With 0 threads and a budget in seconds, one or all threads are used, whichever is faster.
    Seconds are wall time, or the processor time of this process (`clock` "processor"), which
    depends less on other programs and includes the time of all threads. The compilation of kernels
    does not count: it happens once per machine.

    Schedules extend over `schedule`, in the unit of the budget; None for the whole budget.
    """

    seconds: float | None
    frames: int | None
    threads: int = 0
    clock: str = "wall"
    within: bool = False
    schedule: float | None = None

    @classmethod
    def of(cls, settings: WholeSettings, longer: Sequence[Longer] = ()) -> Budget:
        """The budget in the settings of a run that was extended so often."""
        own = cls(settings.seconds, settings.frames, settings.fixed_threads, settings.clock)
        amounts = [*(each.budget for each in longer), own.amount]
        stretched = [number for number, each in enumerate(longer, 1) if each.stretch]
        return replace(own, schedule=amounts[max(stretched, default=0)])

    @property
    def free_threads(self) -> bool:
        """Whether torch's threads are chosen during the run, for a budget of wall time."""
        return self.seconds is not None and self.threads == 0

    @property
    def amount(self) -> float:
        """The budget in its unit."""
        return float(self.frames or self.seconds or 0.0)

    def now(self) -> float:
        """The current time of the budget's clock, in seconds."""
        return now_without_compilation(self.clock)

    def progress(self, seconds: float, frames: int) -> float:
        """The share of the budget that these are; above 1 if they exceed it."""
        return frames / self.frames if self.frames is not None else seconds / (self.seconds or 1.0)

    def scheduled(self, seconds: float, frames: int) -> float:
        """The share of the schedules that these are; above 1 where they keep their end."""
        if self.schedule is None:
            return min(self.progress(seconds, frames), 1.0)
        return (seconds if self.frames is None else frames) / self.schedule
