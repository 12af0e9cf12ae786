"""Tuned hyperparameters by algorithm and task, and those of the thesis for comparison."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from pursuit.validation import check, one_of
from train.files import Plain
from train.settings.algorithms import (
    HYPERPARAMETERS,
    TUNED_AS,
    ActorCriticSettings,
    Hyperparameters,
    NetworkSettings,
    PPOSettings,
    hyperparameter_form,
)
from train.settings.curricula import CurriculumSettings, ScheduleSettings, curriculum_form
from train.settings.profile import TaskProfile
from train.settings.task_form import TaskForm


def _content_of(name: str) -> Plain:
    """The content of a TOML file beside this module."""
    return tomllib.loads(Path(__file__).with_name(name).read_text("utf-8"))


TUNED = "tuned"
SIZE_SETTINGS = ("num_games", "rollout_steps", "minibatch_size")
"""The budget does not change the defaults where the user gives one of these."""
ITERATIONS, FEWEST_GAMES = 90, 64
"""Budgets for fewer iterations lower PPO's number of games to a power of two of at least 64."""
CURRICULUM_EPISODES, LONGEST = 3.0, 0.5
"""The preset's curriculum then lasts so many episodes, but at most this share of the budget."""


def between(near: float, far: float, share: float) -> float:
    """Geometric interpolation between two positive numbers."""
    return float(f"{near * (far / near) ** share:.3g}")


def towards(near: Any, far: Any, share: float, discount: bool) -> Any:
    """Interpolation between two values of a setting: discounts by their horizons, whole numbers in
    multiples of 256."""
    if share == 1.0:
        return far
    if discount:
        return 1.0 - between(1.0 - near, 1.0 - far, share)
    value = between(near, far, share)
    return round(value / 256) * 256 if isinstance(near, int) else value


TUNED_RULES, _THESIS = _content_of("tuned.toml"), _content_of("thesis.toml")
THESIS_ALGORITHMS: dict[str, str] = {name: own.pop("algorithm") for name, own in _THESIS.items()}
THESIS: dict[str, Hyperparameters] = {
    name: HYPERPARAMETERS[THESIS_ALGORITHMS[name]](**own) for name, own in _THESIS.items()
}
TASK_PRESETS: dict[str, Plain] = {"sisl-pursuit": _content_of("sisl_pursuit.toml")}
"""Presets of whole runs by name: the settings of the task and of the run, and hyperparameters by
algorithm, of which the first is the default."""
PRESETS = (TUNED, *THESIS, *TASK_PRESETS)


def preset_task(preset: str, form: type[TaskForm], task: object = None) -> Plain:
    """The settings of the task of a preset; {} for one of any task.

    Args:
        preset: by name.
        form: the class of the task that the user chose.
        task: its name, if the user gave it.

    Raises:
        ValueError: a preset of a game with another task.
    """
    if preset not in TASK_PRESETS:
        return {}
    own = dict(TASK_PRESETS[preset]["task"])
    check(
        {each.name for each in fields(form)} >= set(own) and task in (None, own["task"]),
        f"preset={preset!r} is a game of task {own['task']!r}; leave out the task, or the preset",
    )
    return own


def preset_run(preset: str) -> Plain:
    """The settings of a run besides task and hyperparameters that a preset changes."""
    return dict(TASK_PRESETS.get(preset, {}).get("run", {}))


def preset_algorithm(preset: str) -> str | None:
    """The algorithm of a preset, or its default; None for `tuned`, which applies to all.

    Raises:
        ValueError: an unknown preset.
    """
    one_of("preset", preset, PRESETS)
    if preset in TASK_PRESETS:
        return str(next(iter(TASK_PRESETS[preset]["hyper"])))
    return None if preset == TUNED else THESIS_ALGORITHMS[preset]


def hyperparameters(
    algorithm: str, setting: TaskProfile, preset: str = TUNED, own_gamma: bool = False
) -> Hyperparameters:
    """The hyperparameters of `algorithm` for a task.

    With `own_gamma` the user sets the discount, so that no annealing of it is configured.

    Raises:
        ValueError: an unknown algorithm or preset, or a preset of another algorithm.
    """
    form, owner = hyperparameter_form(algorithm), preset_algorithm(preset)
    own: Plain = TASK_PRESETS.get(preset, {}).get("hyper", {owner: {}})
    check(
        owner is None or algorithm in own,
        f"preset={preset!r} is for algorithm {' or '.join(map(repr, own))}, not {algorithm!r}; "
        "leave one of them out",
    )
    if preset in TASK_PRESETS:
        hyper = form(**own[algorithm])
    else:
        hyper = tuned(algorithm, setting) if owner is None else THESIS[preset]
    if own_gamma and isinstance(hyper, ActorCriticSettings):
        return replace(hyper, gamma_end=None)
    return hyper


def tuned(algorithm: str, setting: TaskProfile) -> Hyperparameters:
    """Our tuned hyperparameters: the defaults of each class, changed by the rules of `tuned.toml`.

    See `curriculum_for` for the curriculum.
    """
    hyper = hyperparameter_form(algorithm)()
    if algorithm not in HYPERPARAMETERS or hyper.SELF_PLAY_ONLY:  # their defaults are used
        return hyper
    algorithm = TUNED_AS.get(algorithm, algorithm)
    unseen = setting.unseen_mazes and algorithm == "ppo"
    for rule in TUNED_RULES["unseen_mazes" if unseen else setting.tuned]:
        applies = (
            algorithm in rule["algorithms"]
            and setting.task in rule.get("tasks", [setting.task])
            and setting.role in rule.get("roles", [setting.role])
        )
        share = float(getattr(setting, rule["share"])) if "share" in rule else 1.0
        if applies and share > 0.0:
            changed = {}
            for name, far in rule["values"].items():
                near = getattr(hyper, name)
                near = hyper.gamma if near is None else near  # of gamma_end
                changed[name] = towards(near, far, share, name.startswith("gamma"))
            hyper = replace(hyper, **changed)
    return hyper


def for_budget(hyper: Hyperparameters, frames: int) -> Hyperparameters:
    """For a budget in frames: fewer games, and as many minibatches, where few iterations fit."""
    if not isinstance(hyper, PPOSettings):
        return hyper
    most = max(frames // (ITERATIONS * hyper.rollout_steps), FEWEST_GAMES)
    if hyper.num_games <= most:
        return hyper
    games = 2 ** (most.bit_length() - 1)  # the largest power of two
    size = hyper.minibatch_size * games // hyper.num_games
    return replace(hyper, num_games=games, minibatch_size=size)


def for_episodes(own: CurriculumSettings, episodes: float) -> CurriculumSettings:
    """A scheduled curriculum for a budget of so many episodes of `max_steps` in every game: games
    take new values at the start of an episode only."""
    if not isinstance(own, ScheduleSettings):
        return own
    least = min(CURRICULUM_EPISODES / episodes, LONGEST)
    return replace(own, schedule_length=max(own.schedule_length, least))


def curriculum_for(
    algorithm: str, setting: TaskProfile, preset: str = TUNED, curriculum: str | None = None
) -> tuple[str, CurriculumSettings]:
    """The named curriculum and its settings, or the curriculum of the preset.

    The curriculum of the preset starts episodes near their end, as in large mazes random actions
    rarely reach goals or evaders. On 9x9 runners have a smaller gap with it after 4 million
    frames; after 12 million no difference is shown. That of chasers was not compared with none.

    ValueError for an unknown one.
    """
    if curriculum is not None:
        return curriculum, curriculum_form(curriculum)()
    if preset == TUNED and issubclass(hyperparameter_form(algorithm), NetworkSettings):
        if setting.far_evader and setting.duel:
            length = between(0.01, 0.2, setting.far_evader)
            return "start-distance", ScheduleSettings(schedule_length=length)
        if setting.unseen_mazes:
            return "goal-spread-start", ScheduleSettings(schedule_length=0.3)
        if setting.far_goals:
            length = between(0.01, 0.5, setting.far_goals)
            return "goal-spread-start", ScheduleSettings(schedule_length=length)
    return "none", CurriculumSettings()
