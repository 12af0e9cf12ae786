"""Settings by their names, as the command line and sweep files give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from difflib import get_close_matches
from typing import Any, TypeVar

from pursuit.rewards import rewards_text
from pursuit.sight import chosen_text, kept_chosen, kept_radius, radius_text
from train.runs.parts import parts_of
from train.runs.tasks import setting_of
from train.settings.checks import check
from train.settings.presets import TUNED, hyperparameters, lessons_for, preset_algorithm
from train.settings.run import TrainSettings
from train.settings.task import task_form

Form = TypeVar("Form")


def settings_of(**flat: Any) -> TrainSettings[Any]:
    """Settings by their names on the command line, with `preset` for what is left out.

    `settings_of(algorithm="dqn", maze="7x7", task="maze", seconds=60, learning_rate=1e-3)`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    given = dict(flat)
    preset = given.pop("preset", TUNED)
    algorithm = given.get("algorithm", preset_algorithm(preset) or "ppo")
    task = picked(task_form(given.get("task")), given)
    setting = replace(setting_of(task), recurrent=given.get("recurrent") is not None)
    hyper = hyperparameters(algorithm, setting, preset, "gamma" in given)
    curriculum, lessons = lessons_for(algorithm, setting, preset, given.get("curriculum"))
    check_names(
        given,
        (type(task), hyper, lessons, TrainSettings),
        {"preset"},
        f" for algorithm {algorithm!r} and curriculum {curriculum!r}",
    )
    settings: TrainSettings[Any] = TrainSettings(
        **{
            **typed(TrainSettings, {k: v for k, v in given.items() if k not in INNER}),
            "task": task,
            "hyper": picked(type(hyper), given, asdict(hyper)),
            "lessons": picked(type(lessons), given, asdict(lessons)),
            "algorithm": algorithm,
            "curriculum": curriculum,
        }
    )
    parts_of(settings)
    return settings


WORDS = {
    "tuple": "a list of texts",
    "bool": "true or false",
    "int": "a whole number",
    "float": "a number",
    "str": "a text",
}
"""The types of settings, as messages call them; the first that fits."""
INNER = frozenset({"task", "hyper", "lessons", "chaser_hyper", "evader_hyper"})


# -- what settings of every kind are read with -----------------------------------------------------


def check_names(
    given: Mapping[str, Any], forms: tuple[Any, ...], others: set[str], where: str
) -> None:
    """ValueError for a name that none of the dataclasses `forms` has, with the nearest that is."""
    known = sorted({f.name for form in forms for f in fields(form)} - INNER | {"task"} | others)
    for name in given:
        close = get_close_matches(name, known, 1)
        check(
            name in known,
            f"unknown setting {name!r}{where}"
            + (f"; did you mean {close[0]!r}?" if close else f"; one of {', '.join(known)}"),
        )


def picked(form: type[Form], given: Mapping[str, Any], default: Mapping[str, Any] = {}) -> Form:
    """A `form` of those of `given` that it has, over `default`."""
    names = {field.name for field in fields(form)}  # type: ignore[arg-type]
    return form(**{**default, **typed(form, {k: v for k, v in given.items() if k in names})})


def typed(form: type[Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of `form` in `given`, with whole numbers made floats where a float is meant.

    Raises:
        ValueError: a value of another type.
    """
    wanted = {field.name: str(field.type) for field in fields(form)}
    result: dict[str, Any] = {}
    for name, value in given.items():
        kind = wanted.get(name)
        if kind is None:
            continue
        if "float" in kind and type(value) is int:
            value = float(value)
        if name == "rewards" and isinstance(value, Mapping):
            value = rewards_text(value)
        if name == "view_radius" and (type(value) is int or isinstance(value, Mapping)):
            value = radius_text(kept_radius(name, value))
        if name in ("line_of_sight", "unknown_maze") and isinstance(value, bool | list | tuple):
            value = chosen_text(kept_chosen(name, value))
        kinds = {"bool": bool, "int": int, "float": float, "str": str}
        if "tuple" in kind and isinstance(value, list | tuple):
            value, fits = tuple(value), all(isinstance(item, str) for item in value)
        else:
            fits = any(word in kind and type(value) is known for word, known in kinds.items())
        check(
            fits or ("None" in kind and value is None),
            f"{name}={value!r}; {next(w for t, w in WORDS.items() if t in kind)} is needed",
        )
        result[name] = value
    return result
