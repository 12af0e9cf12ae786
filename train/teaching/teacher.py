"""Teacher: carries lessons of a curriculum to the games, and outcomes back."""

from __future__ import annotations

import csv
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from curricula import (
    Change,
    Curriculum,
    LearningProgress,
    LevelReplay,
    Outcomes,
    Progress,
    Scheduled,
    Shuffled,
    SuccessGated,
    Uniform,
)
from curricula.schedules import Schedule
from pursuit.policy import TabularPolicy
from pursuit.simulator import Simulator
from pursuit.task import Task
from scripted_agents import best_response, tour_lengths
from train.evaluation.contest import MAX_EXACT_CELLS, won_by
from train.runs.folder import write_beside
from train.settings.algorithms import check
from train.settings.curricula import (
    AxisSettings,
    LearningProgressSettings,
    LevelReplaySettings,
    ReversedSettings,
    ScheduleSettings,
    ShuffledSettings,
    StagedSettings,
    SuccessGatedSettings,
)
from train.settings.run import TrainSettings
from train.teaching.axes import Axis, axis_of

LOG = "curriculum.csv"
LEVELS = "levels"


def axis_of_run(settings: TrainSettings[Any]) -> Axis | None:
    """What the curriculum of a run turns; None where it chooses levels, or there is none."""
    lessons = settings.lessons
    if not isinstance(lessons, AxisSettings):
        return None
    name = lessons.axis if isinstance(lessons, StagedSettings) else settings.curriculum
    return axis_of(name, settings.task, lessons)


def training_task(settings: TrainSettings[Any]) -> Task:
    """The task of the training games: that of the run, with the mazes of the curriculum."""
    task, axis = settings.task.build(), axis_of_run(settings)
    return replace(task, maze=axis.mazes) if axis is not None and axis.mazes else task


def make_curriculum(settings: TrainSettings[Any], axis: Axis | None) -> Curriculum | None:
    """The curriculum of a run; None for "none"."""
    given = settings.lessons
    if isinstance(given, LevelReplaySettings):
        return LevelReplay(
            given.level_score,
            given.level_buffer,
            given.replay_share,
            given.level_temperature,
            given.staleness,
        )
    if axis is None:
        return None
    if isinstance(given, ScheduleSettings):
        return Scheduled(given.build(axis.easiest, axis.hardest), axis.whole)
    assert isinstance(given, StagedSettings)
    stages = axis.stages(given.num_stages)
    if isinstance(given, SuccessGatedSettings):
        return SuccessGated(stages, given.promote_at, given.demote_at, given.window)
    if isinstance(given, LearningProgressSettings):
        return LearningProgress(stages, given.average_fast, given.average_slow, given.explore_share)
    if isinstance(given, ShuffledSettings):
        return Shuffled(stages, given.schedule_length, given.schedule_unit, settings.seed)
    if isinstance(given, ReversedSettings):
        # In the last moment of its length it jumps from the easiest back to the hardest.
        length = given.schedule_length
        points = ((0.0, axis.hardest), (0.999 * length, axis.easiest), (length, axis.hardest))
        return Scheduled(
            Schedule(
                "piecewise" if length else "constant",
                axis.hardest,
                axis.hardest,
                given.schedule_unit,
                points=points if length else (),
            ),
            axis.whole,
        )
    return Uniform(stages)


@dataclass(frozen=True)
class Optimum:
    """The exact optimum of any start of a task, where it is known.

    Attributes:
        values: for each maze [chaser cell, evader cell], one against one; None for a lone runner.
    """

    values: tuple[NDArray[np.float64], ...] | None

    def __call__(self, simulator: Simulator, games: NDArray[np.intp]) -> NDArray[np.float64]:
        """[n] float64, steps of the best play from where `games` begin."""
        steps = np.empty(len(games))
        mazes = simulator.maze_index[games]
        for number, maze in enumerate(simulator.task.mazes):
            here = games[mazes == number]
            if not len(here):
                continue
            cells = simulator.positions[here]
            if self.values is None:
                found: Any = tour_lengths(maze, cells[:, 0], simulator.goals[here])
            else:
                found = self.values[number][cells[:, 0], cells[:, 1]]
            steps[mazes == number] = np.minimum(found, simulator.task.max_steps)
        return steps


def optimum_of(settings: TrainSettings[Any], axis: Axis | None) -> Optimum | None:
    """The exact optimum of the training games; None where it is not known.

    Known for one runner alone, and for one chaser against one evader whose policy stays the same.
    """
    task = training_task(settings)
    if (task.num_agents, task.num_runners) == (1, 1):
        return Optimum(None)
    opponents = settings.task.opponents()
    fixed = axis is None or axis.name != "opponent-epsilon"
    if not (task.is_duel and fixed and task.max_cells <= MAX_EXACT_CELLS):
        return None
    role = task.seat_roles[task.seat(settings.task.agent)]
    policy = opponents["evader" if role == "chaser" else "chaser"]
    if not isinstance(policy, TabularPolicy):
        return None
    return Optimum(
        tuple(
            best_response(
                role,  # type: ignore[arg-type]
                maze,
                policy.action_probabilities(maze, task.stay_action),
                horizon=task.max_steps,
                stay_action=task.stay_action,
                move_order=task.move_order,  # type: ignore[arg-type]
            ).values
            for maze in task.mazes
        )
    )


def check_curriculum(settings: TrainSettings[Any]) -> None:
    """What of a curriculum can be checked before a run begins.

    Raises:
        ValueError: it asks for what the task or the learner has not.
    """
    lessons, task = settings.lessons, settings.task.build()
    axis = axis_of_run(settings)
    make_curriculum(settings, axis)
    if isinstance(lessons, ScheduleSettings):
        for _, value in lessons.points():  # each must be possible, as the ends must
            axis_of(settings.curriculum, settings.task, replace(lessons, easiest=value))
    if axis is not None and axis.mazes:
        check(
            settings.algorithm != "q_learning",
            f"curriculum={settings.curriculum!r} plays several mazes, and q_learning has a table "
            "for one; take a learner with a network",
        )
        training_task(settings)
    if isinstance(lessons, LevelReplaySettings):
        check(
            task.start == "random",
            f"curriculum={settings.curriculum!r} replays random starts; leave out start='marks'",
        )
        check(
            lessons.level_score != "value_loss" or settings.algorithm in ("ppo", "a2c"),
            f"level_score='value_loss' needs advantages, which algorithm={settings.algorithm!r} "
            "has not; take regret or learnability, or ppo or a2c",
        )
    needs = getattr(lessons, "solved_within", 0.0) > 0
    needs |= getattr(lessons, "level_score", "") == "regret"
    check(
        not needs or optimum_of(settings, axis) is not None,
        f"curriculum={settings.curriculum!r} as set needs the exact optimum of every start, which "
        f"is not known for task {task.name!r} with these agents (or while the opponent's epsilon "
        "changes); set solved_within=0 and, for levels, level_score='learnability'",
    )


class Teacher:
    """Asks the curriculum for a lesson whenever a game begins anew, and tells it how that went.

    Args:
        settings: of the run; its curriculum is not "none".
        simulator: the training games, with `auto_restart=False`.
        seat: the learner's.

    Attributes:
        curriculum, axis: what is taught.
        playing: [num_games] float64, the lesson of the episode in play.
        episodes: ended so far.
        copies: games i, i + n/copies, ... always get the same lessons (for learners that compare
            candidates on the same starts).
        rows: of `curriculum.csv`.
    """

    def __init__(self, settings: TrainSettings[Any], simulator: Simulator, seat: int) -> None:
        self.axis = axis_of_run(settings)
        curriculum = make_curriculum(settings, self.axis)
        assert curriculum is not None
        self.curriculum, self.simulator, self.seat = curriculum, simulator, seat
        self.name = settings.curriculum
        lessons = settings.lessons
        self.solved_within = float(getattr(lessons, "solved_within", 0.0))
        score = getattr(lessons, "level_score", "")
        wants_optimum = self.solved_within > 0 or score == "regret"
        self._optimum = optimum_of(settings, self.axis) if wants_optimum else None
        self.wants_errors = score == "value_loss"
        self.rng = np.random.default_rng([settings.seed, 0xC0551])
        games = simulator.num_games
        self.copies, self.episodes = 1, 0
        self.playing, self.optima = np.zeros(games), np.full(games, np.nan)
        self.applied = np.full(games, np.nan)
        self.error_sums, self.error_counts = np.zeros(games), np.zeros(games)
        self.rows: list[dict[str, Any]] = []
        self._clear()
        task = simulator.task
        role = task.seat_roles[seat]
        self._evading = role == "evader" and not task.num_goals
        self._played: list[NDArray[np.float64]] = []
        self._won: list[NDArray[np.bool_]] = []

    def _clear(self) -> None:
        self._outcomes: list[tuple[NDArray[Any], ...]] = []
        self._errors: list[NDArray[np.float64]] = []

    @property
    def describes(self) -> str:
        """What the lessons are, for axes of pictures."""
        return self.axis.name if self.axis is not None else LEVELS

    def restart(self, games: NDArray[np.bool_] | None) -> None:
        """Begin new episodes in the games of the mask, or in all, each with a lesson."""
        simulator = self.simulator
        chosen = np.arange(simulator.num_games) if games is None else np.flatnonzero(games)
        if not len(chosen):
            return
        if self.copies == 1:
            lessons = self.curriculum.sample(len(chosen), self.rng)
        else:
            each = simulator.num_games // self.copies
            lessons = self.curriculum.sample(each, self.rng)[chosen % each]
        if self.axis is None:
            simulator.seed_starts(chosen, lessons.astype(np.int64))
        else:
            # A game keeps its settings, so only those with another lesson than before need any.
            new = self.applied[chosen] != lessons
            if new.any():
                self.axis.apply(simulator, chosen[new], lessons[new])
                self.applied[chosen] = lessons
        self.playing[chosen] = lessons
        simulator.reset(games=games)
        if self._optimum is not None:
            self.optima[chosen] = self._optimum(simulator, chosen)

    def finish(self, games: NDArray[np.bool_]) -> None:
        """Note the outcomes of the games of the mask, whose episodes have just ended."""
        simulator, seat = self.simulator, self.seat
        chosen = np.flatnonzero(games)
        won = won_by(simulator, seat)[chosen]
        lengths = simulator.steps[chosen].astype(np.int64)
        optima = self.optima[chosen]
        if self._evading:
            regrets = np.maximum(1.0 - lengths / optima, 0.0)
            near = lengths * self.solved_within >= optima
        else:
            regrets = np.maximum(lengths / optima - 1.0, 0.0)
            near = lengths <= self.solved_within * optima
        if self.solved_within:
            won = won & near
        lessons = self.playing[chosen]
        returns = simulator.returns[chosen, seat]
        self._outcomes.append((lessons, won, returns, lengths, regrets))
        self._played.append(lessons)
        self._won.append(won)

    def note_advantages(self, advantages: NDArray[np.float32], done: NDArray[np.bool_]) -> None:
        """The positive advantages of the episodes that ended in a rollout, in their order.

        Args:
            advantages, done: [num_games, steps].
        """
        positive = np.maximum(advantages, 0.0)
        for step in range(done.shape[1]):
            self.error_sums += positive[:, step]
            self.error_counts += 1
            ended = done[:, step]
            if ended.any():
                self._errors.append(self.error_sums[ended] / self.error_counts[ended])
                self.error_sums[ended] = self.error_counts[ended] = 0

    def update(self, share: float, frames: int, seconds: float) -> None:
        """Hand the outcomes since the last update over, and log what changes by them."""
        if self._outcomes:
            lessons, won, returns, lengths, regrets = map(
                np.concatenate, zip(*self._outcomes, strict=True)
            )
        else:
            lessons = returns = regrets = np.zeros(0)
            won, lengths = np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64)
        errors = np.concatenate(self._errors) if self._errors else np.full(len(lessons), np.nan)
        self._clear()
        self.episodes += len(lessons)
        progress = Progress(share, frames, self.episodes, seconds)
        outcomes = Outcomes(lessons, won, returns, lengths, regrets, errors)
        for change in self.curriculum.update(outcomes, progress):
            self.rows.append(_row(change, progress))

    def figures(self) -> dict[str, float]:
        """Means over the episodes since the last call, for `metrics.csv`."""
        if not self._played:
            return {}
        lessons, won = np.concatenate(self._played), np.concatenate(self._won)
        self._played, self._won = [], []
        figures = {"training_success": float(won.mean())}
        return figures if self.axis is None else {"lesson": float(lessons.mean()), **figures}

    def write_log(self, folder: Path) -> None:
        """Write `curriculum.csv`."""
        names = ("frames", "episodes", "seconds", "progress", "mean", "low", "high", "reason")

        def write(path: Path) -> None:
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(file, names)
                writer.writeheader()
                writer.writerows(self.rows)

        write_beside(folder / LOG, write)

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values: what a resumed run needs to go on exactly."""
        names = ("playing", "optima", "error_sums", "error_counts")
        curriculum = {
            name: torch.from_numpy(value.copy()) if isinstance(value, np.ndarray) else value
            for name, value in self.curriculum.state_dict().items()
        }
        return {
            "name": self.name,
            "curriculum": curriculum,
            "arrays": {name: torch.from_numpy(getattr(self, name).copy()) for name in names},
            "episodes": self.episodes,
            "rows": [dict(row) for row in self.rows],
            "rng": _plain(self.rng.bit_generator.state),
            "played": [torch.from_numpy(array) for array in self._played],
            "won": [torch.from_numpy(array) for array in self._won],
            "outcomes": [[torch.from_numpy(part) for part in parts] for parts in self._outcomes],
            "errors": [torch.from_numpy(array) for array in self._errors],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there.

        Raises:
            ValueError: the checkpoint of another curriculum.
        """
        check(
            state["name"] == self.name,
            f"the checkpoint is of curriculum {state['name']!r}, and the settings say "
            f"{self.name!r}; resume with the settings that it was made with",
        )
        self.curriculum.load_state_dict(
            {
                name: value.numpy() if isinstance(value, torch.Tensor) else value
                for name, value in state["curriculum"].items()
            }
        )
        for name, tensor in state["arrays"].items():
            getattr(self, name)[:] = tensor.numpy()
        self.episodes = state["episodes"]
        self.rows = [dict(row) for row in state["rows"]]
        self.rng.bit_generator.state = _whole(state["rng"])
        self._played = [tensor.numpy() for tensor in state["played"]]
        self._won = [tensor.numpy() for tensor in state["won"]]
        self._outcomes = [tuple(part.numpy() for part in parts) for parts in state["outcomes"]]
        self._errors = [tensor.numpy() for tensor in state["errors"]]


def _row(change: Change, progress: Progress) -> dict[str, Any]:
    return {
        "frames": int(progress.frames),
        "episodes": int(progress.episodes),
        "seconds": round(progress.seconds, 3),
        "progress": round(progress.share, 6),
        "mean": change.mean,
        "low": change.low,
        "high": change.high,
        "reason": change.reason,
    }


def _plain(state: Any) -> Any:
    """A generator's state with its 128-bit integers as text, which checkpoints can hold."""
    if isinstance(state, dict):
        return {name: _plain(value) for name, value in state.items()}
    return str(state) if isinstance(state, int) else state


def _whole(state: Any) -> Any:
    if isinstance(state, dict):
        return {name: _whole(value) for name, value in state.items()}
    return int(state) if isinstance(state, str) and state.isdigit() else state


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The rows of `curriculum.csv`; none where a run has no curriculum."""
    path = folder / LOG
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {name: text if name == "reason" else float(text) for name, text in row.items()}
            for row in csv.DictReader(file)
        ]
