"""Applies a curriculum to the training games and reports their outcomes to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from curricula import Change, Outcomes, Progress
from pursuit.rules.arrays import Array
from pursuit.simulator.policy import Policy
from pursuit.validation import as_array, check
from train.environments.hooks import EpisodeHook
from train.files import Plain
from train.settings.curricula import MazeReplaySettings
from train.teaching.plan import Plan

LEVELS = "levels"
CURRICULUM_LOG = "curriculum.csv"
CURRICULUM_COLUMNS = ("frames", "episodes", "seconds", "progress", "mean", "low", "high", "reason")
"""Columns of `curriculum.csv`: the sampled values over time, with the reason of each change."""


NO_OUTCOMES = tuple(np.zeros(0, dtype) for dtype in (float, bool, float, np.int64, float))
"""Values, successes, returns, lengths and regrets of no episodes."""


@dataclass(frozen=True)
class EpisodeMetrics:
    """Functions that read the outcomes of the learner's episodes from the simulator.

    Attributes:
        won: (simulator) -> [num_games] bool, valid for games that have just ended.
        returns: (simulator) -> [num_games], the returns of the current episodes.
        few_steps_are_good: whether the learner minimises steps; False for an evader.
    """

    won: Callable[[Any], NDArray[np.bool_]]
    returns: Callable[[Any], NDArray[np.float64]]
    few_steps_are_good: bool = True


class Teacher(EpisodeHook):
    """Samples a value from the curriculum for each new episode, and reports the outcomes to it.

    Args:
        plan: of the curriculum.
        simulator: of the training games, made from the plan's task with `auto_restart=False`.
        metrics: reads the outcomes of episodes.

    Attributes:
        curriculum, axis: of the plan.
        playing: [num_games] float64, the value of the current episode.
        episodes: number of ended episodes.
        rows: of `curriculum.csv`.
        scored_policy: the learner's current policy, for the scores of mazes; set by the run.
    """

    def __init__(self, plan: Plan, simulator: Any, metrics: EpisodeMetrics) -> None:
        self.name, self.axis = plan.name, plan.axis
        self.curriculum, self.simulator, self.metrics = plan.curriculum(), simulator, metrics
        self.solved_within = plan.settings.solved_within
        self.scorer, self.score_every = plan.scorer, 0
        self.scored_policy: Policy | None = None
        if isinstance(plan.settings, MazeReplaySettings):
            self.score_every = plan.settings.score_every
        self.wants_advantages = plan.settings.needs_advantages
        self.rng = np.random.default_rng([plan.seed, 0xC0551])
        games = simulator.num_games
        self.episodes = 0
        self.playing = np.zeros(games)
        # The starts of the current episodes, and their optima where they have been computed.
        self.optimum, self._optima = plan.optimum, np.full(games, np.nan)
        self._starts: tuple[Array, ...] = ()
        if self.optimum is not None:
            self._starts = self.optimum.starts(simulator, np.arange(games))
        self.applied = np.full(games, np.nan)
        self.error_sums, self.error_counts = np.zeros(games), np.zeros(games)
        self.rows: list[Plain] = []
        self._clear()
        self._played: list[NDArray[np.float64]] = []
        self._won: list[NDArray[np.bool_]] = []

    def _clear(self) -> None:
        self._ended: list[tuple[Array, ...]] = []
        self._outcomes: list[tuple[Array, ...]] = []
        self._errors: list[NDArray[np.float64]] = []

    @property
    def describes(self) -> str:
        """The name of the axis, for labels of figures."""
        return self.axis.name if self.axis is not None else LEVELS

    def before_restart(self, games: NDArray[np.intp]) -> None:
        """Set the value of the next episode of each of `games`."""
        rule = f"sampled by the curriculum; return {len(games)} finite numbers, one for each game"
        values = as_array("values", self.curriculum.sample(len(games), self.rng), "biuf", rule)
        if values.shape != games.shape or not np.isfinite(values).all():
            raise ValueError(f"values={values.tolist()}; {rule}")
        if self.axis is None:
            self.simulator.seed_starts(games, values.astype(np.int64))
        else:
            # Settings persist across episodes, so only changed values are applied.
            if (self.applied[games] != values).any():
                self.axis.apply(self.simulator, games, values)
                self.applied[games] = values
        self.playing[games] = values

    def after_restart(self, games: NDArray[np.intp]) -> None:
        """Record the starts of `games`, for their optima."""
        if self.optimum is not None:
            self._optima[games] = np.nan
            found = self.optimum.starts(self.simulator, games)
            for starts, new in zip(self._starts, found, strict=True):
                starts[games] = new

    def episode_ended(self, games: NDArray[np.bool_]) -> None:
        """Record the outcomes of the episodes in the mask, which have just ended."""
        simulator, metrics = self.simulator, self.metrics
        chosen = games.nonzero()[0]
        won, returns = metrics.won(simulator)[chosen], metrics.returns(simulator)[chosen]
        rounds = -(-simulator.steps[chosen] // simulator.task.steps_per_round)
        outcome = (self.playing[chosen], won, returns, rounds)
        starts = (part[chosen] for part in self._starts)
        self._ended.append((*outcome, self._optima[chosen], *starts))

    @property
    def optima(self) -> NDArray[np.float64]:
        """[num_games] float64, the least steps of the current episodes; NaN where unknown."""
        self._optima = self._with_optima(self._optima, self._starts)
        return self._optima

    def _with_optima(
        self, optima: NDArray[np.float64], starts: Sequence[Array]
    ) -> NDArray[np.float64]:
        """`optima` [n] with those of `starts` [n, ...] where they are NaN, solved together."""
        missing = np.isnan(optima)
        if self.optimum is not None and missing.any():
            optima[missing] = self.optimum.steps(*(part[missing] for part in starts))
        return optima

    def _collect(self) -> None:
        """Convert the recorded episodes to outcomes, all together for speed."""
        if not self._ended:
            return
        columns = map(np.concatenate, zip(*self._ended, strict=True))
        values, won, returns, steps, optima, *starts = columns
        self._ended = []
        lengths, optima = steps.astype(np.int64), self._with_optima(optima, starts)
        if not self.metrics.few_steps_are_good:
            regrets = np.maximum(1.0 - lengths / optima, 0.0)
            near = lengths * self.solved_within >= optima
        else:
            regrets = np.maximum(lengths / optima - 1.0, 0.0)
            near = lengths <= self.solved_within * optima
        if self.solved_within:
            won = won & near
        self._outcomes.append((values, won, returns, lengths, regrets))
        self._played.append(np.stack([values, lengths]))
        self._won.append(won)

    def note_advantages(self, advantages: Array, done: NDArray[np.bool_]) -> None:
        """Record the mean positive advantage of each episode that ended in a rollout, in order.

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
        """Report the outcomes since the last update to the curriculum, and log its changes.

        Mazes that are due for scoring are scored first, with `scored_policy`.
        """
        if self.scorer is not None and self.scored_policy is not None:
            pool: Any = self.curriculum
            if frames >= pool.rounds * self.score_every:
                mazes = pool.to_score(self.rng)
                pool.note(mazes, self.scorer.scores(self.scored_policy, mazes))
        self._collect()
        columns = map(np.concatenate, zip(NO_OUTCOMES, *self._outcomes, strict=True))
        values, won, returns, lengths, regrets = columns
        errors = np.concatenate(self._errors) if self._errors else np.full(len(values), np.nan)
        self._clear()
        self.episodes += len(values)
        progress = Progress(share, frames, self.episodes, seconds)
        outcomes = Outcomes(values, won, returns, lengths, regrets, errors)
        for change in self.curriculum.update(outcomes, progress):
            self.rows.append(change_row(change, progress))

    def figures(self) -> dict[str, float]:
        """Means over the episodes since `forget_episodes`, for `metrics.csv`."""
        self._collect()
        if not self._played:
            return {}
        (values, lengths), won = np.hstack(self._played), np.concatenate(self._won)
        figures = {"training_success": float(won.mean())}
        if self.axis is None or not self.axis.ordered:
            return figures
        hardest = float(np.average(np.isclose(values, self.axis.hardest), weights=lengths))
        return {"stage": float(values.mean()), "on_hardest": hardest, **figures}

    def forget_episodes(self) -> None:
        """Start new means for `figures`."""
        self._collect()
        self._played, self._won = [], []

    def state_dict(self) -> Plain:
        """Tensors and plain values: everything needed to resume exactly."""
        self._collect()
        names = ("playing", "optima", "error_sums", "error_counts")
        state: Plain = {
            "name": self.name,
            "curriculum": self.curriculum.state_dict(),
            "arrays": {name: getattr(self, name) for name in names},
            "episodes": self.episodes,
            "rows": self.rows,
            # Checkpoints cannot hold integers of 128 bits.
            "rng": converted(self.rng.bit_generator.state, int, str),
            "played": self._played,
            "won": self._won,
            "outcomes": self._outcomes,
            "errors": self._errors,
        }
        return converted(state, np.ndarray, lambda array: torch.from_numpy(array.copy()))

    def load_state_dict(self, state: Plain) -> None:
        """Restore the state.

        Raises:
            ValueError: a checkpoint of another curriculum.
        """
        check(
            state["name"] == self.name,
            f"the checkpoint has curriculum {state['name']!r}, the settings have {self.name!r}; "
            "resume with the settings of the checkpoint",
        )
        state = converted(state, torch.Tensor, torch.Tensor.numpy)
        self.curriculum.load_state_dict(state["curriculum"])
        for name, array in state["arrays"].items():
            own = self._optima if name == "optima" else getattr(self, name)
            own[:] = array
        self.episodes, self.rows = state["episodes"], state["rows"]
        self.rng.bit_generator.state = converted(
            state["rng"], str, lambda text: int(text) if text.isdigit() else text
        )
        self._played, self._won = state["played"], state["won"]
        self._outcomes, self._errors = state["outcomes"], state["errors"]


def converted(value: Any, kind: type, convert: Callable[[Any], Any]) -> Any:
    """A copy of nested dicts, lists and tuples, with every value of this type converted."""
    if isinstance(value, kind):
        return convert(value)
    if isinstance(value, dict):
        return {name: converted(part, kind, convert) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(converted(part, kind, convert) for part in value)
    return value


def change_row(change: Change, progress: Progress) -> Plain:
    """One row of `curriculum.csv`."""
    return {
        "frames": int(progress.frames),
        "episodes": int(progress.episodes),
        "seconds": round(progress.seconds, 3),
        "progress": round(progress.share, 6),
        **vars(change),
    }
