"""The task of a run with its policies, and contests without a run."""

from __future__ import annotations

from train.evaluation.scores import AnyContest
from train.families import family_of
from train.families.family import TaskWorld
from train.runs.opponents import SAVED
from train.settings.checks import evaluation_seed
from train.settings.task_form import TaskForm


def task_world_of(settings: TaskForm, team: bool = False) -> TaskWorld:
    """The task of these settings with its policies; `team` as of `TaskWorld`."""
    return family_of(settings).world(settings, team, SAVED)


def contest_of(settings: TaskForm, episodes: int, seed: int = 0, team: bool = False) -> AnyContest:
    """The contest of a task, without a run; `seed` is a seed of evaluations."""
    return task_world_of(settings, team).contest(episodes, evaluation_seed(seed))
