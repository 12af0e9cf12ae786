"""The overhead of every curriculum: its share of PPO's training time with 1024 games.

    python tools/benchmarks/bench_curricula.py [--seconds 6] [--maze 5x5]

The time of the teacher is measured: sampling stages, configuring games, recording outcomes, and
updates. Restarts of games by the simulator are not included, as they also happen without a
curriculum.
"""

from __future__ import annotations

import argparse
import tempfile
from time import perf_counter
from typing import Any

from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import settings_of

CASES: dict[str, dict[str, Any]] = {
    "goal-spread-start": {},
    "num-goals": {},
    "loops": {},
    "success-gated": {},
    "learning-progress": {},
    "uniform": {},
    "level-replay": {},
    "level-replay, value loss": {"level_score": "value_loss"},
    "learnability": {},
}


class Stopwatch:
    """Adds up the time spent in calls."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def wrap(self, owner: Any, name: str) -> None:
        """Time every call of `owner.name`."""
        function = getattr(owner, name)

        def timed(*arguments: Any, **named: Any) -> Any:
            began = perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                self.seconds += perf_counter() - began

        setattr(owner, name, timed)


def share(curriculum: str, maze: str, seconds: float, more: dict[str, Any]) -> tuple[float, float]:
    """The teacher's share of the training time, and episodes a second."""
    settings = settings_of(
        task="maze", maze=maze, num_goals=3, seconds=seconds, threads=1, num_games=1024,
        curriculum=curriculum, **more,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        run = start(RUN, settings, folder)
        teacher = run.trainee.teacher
        inside = Stopwatch()
        for name in ("before_restart", "after_restart", "episode_ended", "update"):
            inside.wrap(teacher, name)
        inside.wrap(teacher, "note_advantages")
        run.trainee.learner.iterate(0.0)
        inside.seconds = total = 0.0
        episodes = teacher.episodes
        while total < seconds:
            began = perf_counter()
            teacher.update(total / seconds, run.trainee.learner.frames, total)
            run.trainee.learner.iterate(total / seconds)
            total += perf_counter() - began
        run.trainee.learner.close()
    return inside.seconds / total, (teacher.episodes - episodes) / total


def main() -> None:
    """Print one line per curriculum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0, help="duration per curriculum")
    parser.add_argument("--maze", default="5x5", help="episodes are shorter in small ones")
    given = parser.parse_args()
    print(f"{'curriculum':<26}{'share of training':>18}{'episodes/s':>12}")
    for name, more in CASES.items():
        spent, rate = share(name.split(",")[0], given.maze, given.seconds, more)
        print(f"{name:<26}{100 * spent:>16.2f} %{rate:>12,.0f}", flush=True)


if __name__ == "__main__":
    main()
