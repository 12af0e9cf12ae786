"""The default settings of runs, which depend on the task."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from train.files import Plain
from train.settings.presets import (
    TUNED,
    curriculum_for,
    for_budget,
    for_episodes,
    hyperparameters,
    preset_algorithm,
    preset_run,
)

DEFAULTS_BY = ("algorithm", "curriculum", "recurrent", "gamma", "frames")
"""Settings of a run that the defaults of others depend on, besides `SIZES`."""


def default_settings(
    task: Any,
    algorithm: str | None = None,
    preset: str = TUNED,
    curriculum: str | None = None,
    recurrent: str | None = None,
    gamma: float | None = None,
    frames: int | None = None,
    **sizes: int | None,
) -> Plain:
    """The default settings of a run: task, hyper, curriculum_settings, algorithm and curriculum,
    and those of the run that the preset changes.

    Args:
        task: its settings.
        algorithm, curriculum: by name; by default those of the preset.
        preset: by name.
        recurrent, gamma: the user's values, which the defaults depend on.
        frames: the budget, which tuned defaults in one maze depend on; None for one in seconds.
        **sizes: the user's values of `SIZES`; if there is one, the budget changes nothing.

    Raises:
        ValueError: an unknown name, settings that the task does not allow, or a preset of another
            algorithm.
    """
    algorithm = algorithm or preset_algorithm(preset) or "ppo"
    setting = replace(task.profile(), recurrent=recurrent is not None)
    hyper = hyperparameters(algorithm, setting, preset, gamma is not None)
    if gamma is None and task.discount is not None:
        constant: Plain = {"gamma_end": None} if hasattr(hyper, "gamma_end") else {}
        hyper = replace(hyper, gamma=task.discount, **constant)
    of_preset = curriculum is None
    curriculum, curriculum_settings = curriculum_for(algorithm, setting, preset, curriculum)
    one_maze = preset == TUNED and not setting.many_mazes and setting.cells > 0
    if one_maze and isinstance(frames, int) and frames > 0 and not any(sizes.values()):
        usual, hyper = hyper, for_budget(hyper, frames)
        if hyper != usual and of_preset:
            episodes = frames / (hyper.num_games * task.max_steps)
            curriculum_settings = for_episodes(curriculum_settings, episodes)
    return {
        **preset_run(preset),
        "task": task,
        "hyper": hyper,
        "curriculum_settings": curriculum_settings,
        "algorithm": algorithm,
        "curriculum": curriculum,
    }
