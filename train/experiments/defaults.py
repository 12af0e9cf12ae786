"""The settings that a run has where nobody sets any: what a methods paragraph compares with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pursuit.plugins import is_reference
from train.runs.folder import SELF_PLAY
from train.runs.tasks import setting_of
from train.self_play.learners import hyper_of
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.curricula import curriculum_form
from train.settings.presets import hyperparameters, lessons_for
from train.settings.run import TrainSettings
from train.settings.self_play import ROLES, SelfPlaySettings
from train.settings.task import TaskSettings, task_form


def defaults_of(kind: str, plain: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that a run of this task, algorithm and curriculum has where nobody sets any.

    Nothing of a user's is imported for it: the settings of a user's own algorithm or curriculum
    have no defaults here.
    """
    if kind == SELF_PLAY:
        return self_play_defaults(plain)
    form = task_form(plain["task"]["task"])
    task = form(**{n: v for n, v in plain["task"].items() if not is_reference(v)})
    algorithm, curriculum = plain["algorithm"], plain["curriculum"]
    hyper: dict[str, Any] = {}
    lessons: dict[str, Any] = {}
    usual = "none"
    if not is_reference(curriculum):
        lessons = asdict(curriculum_form(curriculum)())
    if algorithm in HYPERPARAMETERS:
        setting = setting_of(task)
        hyper = asdict(hyperparameters(algorithm, setting))
        usual = lessons_for(algorithm, setting)[0]
        if curriculum == usual:
            lessons = asdict(lessons_for(algorithm, setting)[1])
    own = asdict(TrainSettings(form(), frames=1))
    own |= {"task": asdict(form()), "hyper": hyper, "lessons": lessons}
    return own | {"algorithm": algorithm, "curriculum": usual}


def self_play_defaults(plain: Mapping[str, Any]) -> dict[str, Any]:
    """The same of self-play, with the settings of sides that learn by other algorithms than PPO."""
    found = asdict(SelfPlaySettings(frames=1))
    task = TaskSettings(**{n: v for n, v in plain["task"].items() if not is_reference(v)})
    for role in ROLES:
        name = f"{role}_algorithm"
        if plain.get(f"{role}_hyper") is not None and plain[name] in HYPERPARAMETERS:
            settings = SelfPlaySettings(task, frames=1, **{name: plain[name]})
            found[f"{role}_hyper"] = asdict(hyper_of(settings, role))
    return found
