"""The help of commands: short and in groups, with the values that would be used."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import Any

import pytest
from command_errors import error_of

from train.commands.main import COMMANDS, main
from train.commands.self_play import SelfPlayCommand
from train.commands.train import TrainCommand
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.curricula import CURRICULA
from train.settings.groups import GROUPS, OTHER_NAMES, group_of
from train.settings.reading import INNER, check_names
from train.settings.run import TrainSettings
from train.settings.self_play import GameSelfPlay, SelfPlaySettings
from train.settings.task import ReacherSettings, SmallGameSettings, TaskSettings

COMMON: tuple[Any, ...] = (
    *(TrainCommand, SelfPlayCommand, TrainSettings, SelfPlaySettings, GameSelfPlay),
    *(TaskSettings, ReacherSettings, SmallGameSettings),
)
LEARNERS: tuple[Any, ...] = (*HYPERPARAMETERS.values(), *CURRICULA.values())
CHASE = "train"
GAMES = [
    CHASE,
    "train --task maze --algorithm dqn",
    "train --task heist --curriculum uniform --frames 200000",
    "train --task escape --algorithm ippo",
    "train --task reacher --algorithm td3",
    "train --game soccer --algorithm q_learning",
    "self-play",
    "self-play --evader.algorithm dqn",
    "self-play --game soccer",
]


def shown(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main([word for argument in arguments for word in argument.split()])
    assert stopped.value.code == 0
    return capsys.readouterr().out


def options(text: str) -> set[str]:
    return {*re.findall(r"^  --([\w-]+)", text, re.MULTILINE)}


def test_every_setting_has_one_group() -> None:
    """A new setting needs a line in `help.toml`; hyperparameters and curricula do not."""
    names = {name for group in GROUPS.values() for name in group}
    assert sum(map(len, GROUPS.values())) == len(names)
    own = {each.name for form in COMMON for each in fields(form)}
    own -= {*INNER - {"task"}, "settings", "other_algorithm"}
    assert not own - names
    learned = {each.name for form in LEARNERS for each in fields(form)}
    assert not names - own - learned - {"algorithm"}
    assert all(group_of(form, each.name) == "Learner" for form in LEARNERS for each in fields(form))


@pytest.mark.parametrize("command", GAMES)
def test_the_short_help_fits_a_screen(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = shown(capsys, command, "--help").splitlines()
    assert len(lines) <= 45 and max(map(len, lines)) <= 80
    titles = [line for line in lines if line in GROUPS]
    assert titles == [title for title in GROUPS if title in titles] and "Learner" in titles
    assert lines[-1].endswith(f"pursuit {command.split()[0]} --help-all")
    short, whole = options("\n".join(lines)), options(shown(capsys, command, "--help-all"))
    assert short < whole and {"frames", "algorithm", "config"} <= short


@pytest.mark.parametrize("command", COMMANDS)
def test_types_are_words(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = shown(capsys, command, "--help")
    assert "None}" not in text and "{" not in text
    if "--out" in text:
        assert "--out PATH" in text


def test_values_are_those_that_the_command_would_use(capsys: pytest.CaptureFixture[str]) -> None:
    assert re.search(r"--num-games INT .*\[1024\]", shown(capsys, "train --help"))
    small = shown(capsys, "train --frames 200000 --help")
    assert re.search(r"--num-games INT .*\[128\]", small)
    assert re.search(r"--frames INT .*\[200000\]", small)
    assert not re.search(r"--seconds FLOAT.*\[", small)
    assert re.search(r"--curriculum STR .*\[start-distance\]", shown(capsys, "train --maze 7x7 -h"))


@pytest.mark.parametrize(
    ("command", "without", "there"),
    [
        (CHASE, {"action-std", "joints", "game"}, {"first-std", "capture", "opponent"}),
        ("train --observation planes", {"action-std"}, {"network"}),
        ("train --task maze", {"opponent", "opponent-epsilon", "capture", "exits"}, {"num-goals"}),
        ("train --task reacher", {"first-std", "capture", "maze"}, {"action-std", "joints"}),
        ("train --algorithm q_learning", {"network", "precision"}, {"optimism"}),
        ("self-play", {"action-std", "role", "opponent"}, {"sampling", "chaser", "evader"}),
        ("self-play --game soccer", {"action-std", "player", "maze"}, {"A", "B", "game"}),
    ],
)
def test_options_of_other_games_are_left_out(
    command: str, without: set[str], there: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    found = options(shown(capsys, command, "--help-all"))
    assert not found & without and there <= found


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("train --lr 3e-4", "learning-rate"),
        ("train --total-timesteps=1e6", "frames"),
        ("train --timesteps 5", "frames"),
        ("train --batch_size 64", "minibatch-size"),
        ("train --n-envs 8", "num-games"),
        ("train --algorithm dqn --num-envs 8", "num-games"),
        ("train --ent-coef 0.1", "entropy-coef"),
        ("train --n-epochs 4", "epochs"),
        ("train --learning_rat 4", "learning-rate"),
        ("self-play --n-steps 5", "rollout-steps"),
        ("self-play --chaser.lr 5", "learning-rate"),
    ],
)
def test_an_option_of_another_library_suggests_ours(
    given: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"; perhaps you meant --{meant} (see" in error_of(capsys, *given.split())


def test_other_names_are_of_settings_and_of_python() -> None:
    names = {each.name for form in (*COMMON, *LEARNERS) for each in fields(form)}
    assert {*OTHER_NAMES.values()} <= names
    with pytest.raises(ValueError, match="unknown setting 'lr'; give learning_rate"):
        check_names(["lr"], ["learning_rate", "clip"])
