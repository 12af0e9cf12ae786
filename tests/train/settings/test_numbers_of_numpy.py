"""Every numeric setting as a number of NumPy, and whole numbers as 1e6, also as options."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from command_errors import error_of

from pursuit.validation import field_rules
from train.commands.parse import parse
from train.experiments.library_runs import LibraryRunSettings, library_settings_of
from train.kinds import start
from train.runs.folder import CONFIG, RUN, load_results
from train.runs.parts import settings_of
from train.self_play.parts import self_play_settings_of
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.checks import Settings
from train.settings.curricula import CURRICULA
from train.settings.reading import names_of, plain_settings, typed
from train.settings.run import TrainSettings
from train.settings.self_play import GameSelfPlay, SelfPlaySettings
from train.settings.task import ReacherSettings, SmallGameSettings, TaskSettings

OF_TASKS = (TaskSettings, ReacherSettings, SmallGameSettings)
OF_RUNS = (TrainSettings, SelfPlaySettings, GameSelfPlay)
FORMS = dict.fromkeys([*OF_TASKS, *OF_RUNS, *HYPERPARAMETERS.values(), *CURRICULA.values()])
SCALARS: dict[type, list[Any]] = {
    int: [np.int64(3), np.int32(3), np.uint8(3), 3.0, np.float64(3.0), np.float32(3.0)],
    float: [np.float64(0.5), np.float32(0.5)],
    bool: [np.True_],
}
TINY: dict[str, Any] = {"maze": "3x3", "frames": 1024, "num_games": 16, "minibatch_size": 64}


def kinds_of(form: type[Any]) -> dict[str, list[type]]:
    """The types of the fields with numbers or flags, by name."""
    hints = get_type_hints(form)
    found = {
        name: [t for t in (hints[name], *get_args(hints[name])) if t in SCALARS]
        for name in names_of(form)
    }
    return {name: kinds for name, kinds in found.items() if kinds}


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_every_numeric_setting_takes_numbers_of_numpy(form: type[Any]) -> None:
    """They are stored as those of Python: files are written with them."""
    for name, kinds in kinds_of(form).items():
        for kind in kinds:
            for given in SCALARS[kind]:
                if kind is int and float in kinds and type(given) is not int:
                    continue  # stays a float
                (found,) = typed(form, plain_settings({name: given})).values()
                assert type(found) is kind and found == kind(given), name
    if any(kinds == [int] for kinds in kinds_of(form).values()):
        name = next(name for name, kinds in kinds_of(form).items() if kinds == [int])
        for wrong in (2.5, np.float64(2.5), "3", np.True_, float("nan"), float("inf")):
            with pytest.raises(ValueError, match=f"{name}=.*; give a whole number"):
                typed(form, plain_settings({name: wrong}))


def test_settings_made_directly_hold_numbers_of_python() -> None:
    rules = [name for name in field_rules(TaskSettings) if name in kinds_of(TaskSettings)]
    assert "max_steps" in rules
    made = TaskSettings(
        max_steps=np.int64(7), opponent_epsilon=np.float32(0.5), stay_action=np.True_
    )  # type: ignore[arg-type]
    json.dumps(asdict(made))
    assert made == TaskSettings(max_steps=7, opponent_epsilon=0.5, stay_action=True)


def test_runs_are_the_same_whatever_the_numbers(tmp_path: Path) -> None:
    """Also the defaults that depend on the budget, tables of sides, and what is written."""
    numbers: dict[str, Any] = {
        "frames": np.float64(1e3),
        "seed": np.int64(3),
        "width": np.uint8(32),
    }
    plain = {"frames": 1000, "seed": 3, "width": 32}
    for make in (settings_of, self_play_settings_of):
        assert make(maze="3x3", **numbers) == make(maze="3x3", **plain)
    assert settings_of(task="reacher", **numbers) == settings_of(task="reacher", **plain)
    sides = [{"evader": {"learning_rate": rate}} for rate in (np.float32(0.5), 0.5)]
    assert self_play_settings_of(maze="3x3", frames=1000, **sides[0]) == self_play_settings_of(
        maze="3x3", frames=1000, **sides[1]
    )
    own = {"contestant": "ours", "task": "chase", "role": "chaser", "maze": "3x3"}
    given = [
        library_settings_of(**own, **each) for each in ({"frames": np.int64(64)}, {"frames": 64})
    ]
    assert given[0] == given[1] and isinstance(given[0], LibraryRunSettings)
    run = start(RUN, settings_of(**TINY, max_steps=np.int64(9), threads=np.int32(1)), tmp_path)
    run.train()
    run.results(np.int64(8))  # type: ignore[arg-type]
    assert load_results(tmp_path)["evaluation"]["episodes"] == 8
    assert json.loads((tmp_path / CONFIG).read_text())["task"]["max_steps"] == 9


@dataclass(frozen=True)
class Options(Settings):
    """Options with whole numbers of all kinds."""

    count: int = 1
    """One."""
    perhaps: int | None = None
    """One, or none."""
    several: tuple[int, ...] = ()
    """Several."""
    share: float = 0.0
    """No whole number."""


def test_options_take_whole_numbers_as_powers_of_ten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--count", "1e6", "--perhaps=2e3", "--several", "1e1", "20", "--share", "1e-3"]
    assert parse(Options, given, "example") == Options(1_000_000, 2000, (10, 20), 1e-3)
    for text in ("1.5", "1e-1", "1e999", "nan", "ten", ""):
        with pytest.raises(ValueError, match=r"--count .*: give a whole number"):
            parse(Options, ["--count", text], "example")
    for command in ("train", "self-play"):
        said = error_of(capsys, command, "--frames", "1.5e0", "--out", tmp_path / "run")
        assert "--frames '1.5e0': give a whole number" in said
