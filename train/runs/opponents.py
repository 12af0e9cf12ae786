"""The policies of saved runs, and policies by name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pursuit.plugins import reading
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import as_path, check, check_bool, need
from train.algorithms.registry import entry
from train.families import family_of, maze_policies
from train.families.policies import Fixed, policy_named
from train.runs.folder import (
    CONFIG,
    MISFITS,
    SELF_PLAY,
    check_learned,
    load_checkpoint,
    misfit,
    read_config,
)
from train.runs.saved import learning_seat, load_settings
from train.runs.stable_baselines import load_stable_baselines
from train.settings.run import AgentSettings
from train.settings.self_play import sides_in
from train.settings.task_form import TaskForm
from train.tensors import own_defaults


@own_defaults()
def load_policy(folder: Path | str, greedy: bool = True) -> Any:
    """The policy of a run, from its last checkpoint, on the CPU: a `Policy` of its role.

    Of a small game it is a `StatePolicy`: `policy.table(policy.task)` are its probabilities in all
    states, as `SmallGame.table` and the solvers take them.

    Args:
        folder: of the run; for self-play its `chaser` or `evader`, or a player of the small game.
        greedy: the most probable action; False draws from the learned distribution.

    Raises:
        ValueError: no run, a damaged one, one without a distribution if `greedy` is False; or
            `greedy` is not a bool.
    """
    folder, greedy = as_path("folder", folder), check_bool("greedy", greedy)
    settings, state = load_settings(folder), load_checkpoint(folder)
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
            return algorithm.load(settings.hyper, seat, state["trainee"]["learner"], greedy)
        except MISFITS as error:
            raise misfit(folder, error) from None


class _SavedRuns:
    """As of `train.families.policies.SavedRuns`."""

    def settings(self, folder: Path) -> AgentSettings:
        return load_settings(folder)

    def policy(self, folder: Path, greedy: bool) -> Any:
        return load_policy(folder, greedy)

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

    def model(self, path: Path, greedy: bool | None, **trained: Any) -> Any:
        return load_stable_baselines(path, greedy, **trained)


SAVED = _SavedRuns()
"""What families read saved policies with."""


def policy_of(settings: TaskForm, name: str, task: Any, agent: str, *how: Any) -> Any:
    """The policy of this name for an agent or role of a task; as of `policy_named`."""
    return policy_named(need(family_of(settings).policies), SAVED, name, task, agent, *how)


def opponents_of(task: Task, agent: str, opponent: str | None, *how: Any) -> dict[str, Policy]:
    """The policy of every role of a task in mazes; as of `families.maze_policies`."""
    return maze_policies.opponents_of(SAVED, task, agent, opponent, *how)


def is_self_play(folder: Path) -> bool:
    """Whether a folder contains a run of self-play."""
    return os.path.exists(folder / CONFIG) and read_config(folder)[0] == SELF_PLAY
