"""The policies of saved runs, and policies by name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pursuit.plugins import reading
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import as_path, check, check_bool, need
from train.algorithms.registry import entry
from train.families import family_of, maze_policies
from train.families.policies import Fixed, SavedRuns, policy_named
from train.runs.folder import (
    CONFIG,
    MISFITS,
    SELF_PLAY,
    check_learned,
    load_checkpoint,
    misfit,
    read_config,
)
from train.runs.onnx_policy import load_onnx
from train.runs.saved import learning_seat, load_settings, trains_team
from train.runs.stable_baselines import load_stable_baselines
from train.settings.run import AgentSettings
from train.settings.self_play import sides_in
from train.settings.task_form import TaskForm
from train.tensors import own_defaults


@own_defaults()
def load_policy(folder: Path | str, greedy: bool = True, at: int | str | None = None) -> Any:
    """The policy of a run, by default from its last checkpoint, on the CPU: a `Policy` of its role.

    Of a small game it is a `StatePolicy`: `policy.table(policy.task)` are its probabilities in all
    states, as `SmallGame.table` and the solvers take them.

    Args:
        folder: of the run; for self-play its `chaser` or `evader`, or a player of the small game.
        greedy: the most probable action; False draws from the learned distribution.
        at: the frames of a policy that the run kept (setting `checkpoints`, and the snapshots of
            self-play), or "best": that with the best evaluation during training.

    Raises:
        ValueError: no run, a damaged one, one without a distribution if `greedy` is False; nothing
            kept at these frames; or `greedy` is not a bool.
    """
    folder, greedy = as_path("folder", folder), check_bool("greedy", greedy)
    settings, state = load_settings(folder), load_checkpoint(folder, at)
    algorithm = entry(settings.algorithm)
    _ = algorithm.library  # it is installed
    check(
        greedy or algorithm.learns_distribution,
        f"{folder}: {settings.algorithm} learns no distribution over actions; use greedy=True",
    )
    with reading(folder / CONFIG):
        seat = learning_seat(settings)
        try:
            check_learned(algorithm.name, state["trainee"], seat)
            policy: Any = algorithm.load(settings.hyper, seat, state["trainee"]["learner"], greedy)
        except MISFITS as error:
            raise misfit(folder, error) from None
    if hasattr(policy, "seat"):  # for its export
        policy.learned = algorithm.learns_distribution, trains_team(folder)
    return policy


@dataclass(frozen=True)
class _SavedRuns:
    """As of `train.families.policies.SavedRuns`; policies are of the time `at` of `load_policy`."""

    at: int | str | None = None

    def settings(self, folder: Path) -> AgentSettings:
        return load_settings(folder)

    def policy(self, folder: Path, greedy: bool) -> Any:
        return load_policy(folder, greedy, self.at)

    def has_distribution(self, folder: Path) -> bool:
        return entry(load_settings(folder).algorithm).learns_distribution

    def sides(self, folder: Path) -> Mapping[str, Fixed | None] | None:
        if not is_self_play(folder):
            return None
        plain = read_config(folder)[1]
        how = [plain["task"].get(name) for name in ("opponent_epsilon", "opponent_policy")]
        return {
            role: Fixed(own, how[0] or 0.0, how[1] or "sampled") if isinstance(own, str) else None
            for role, own in sides_in(plain).items()
        }

    def model(self, path: Path, greedy: bool | None, form: Any, **trained: Any) -> Any:
        if path.suffix == ".onnx":
            own = [trained.pop(name, None) or "" for name in ("task", "agent", "observation")]
            return load_onnx(path, greedy, form(*own, **trained))
        return load_stable_baselines(path, greedy, **trained)


SAVED = _SavedRuns()
"""What families read saved policies with."""


def saved_at(at: int | str | None) -> SavedRuns:
    """What families read policies with as they were at a time of training; as of `load_policy`."""
    return _SavedRuns(at)


def policy_of(settings: TaskForm, name: str, *how: Any, at: int | str | None = None) -> Any:
    """The policy of this name for an agent or role of a task; `how` as of `policy_named`, from the
    task on, and `at` as of `load_policy`."""
    return policy_named(need(family_of(settings).policies), saved_at(at), name, *how)


def opponents_of(task: Task, agent: str, opponent: str | None, *how: Any) -> dict[str, Policy]:
    """The policy of every role of a task in mazes; as of `families.maze_policies`."""
    return maze_policies.opponents_of(SAVED, task, agent, opponent, *how)


def is_self_play(folder: Path) -> bool:
    """Whether a folder contains a run of self-play."""
    return os.path.exists(folder / CONFIG) and read_config(folder)[0] == SELF_PLAY
