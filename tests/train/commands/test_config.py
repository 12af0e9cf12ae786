"""Settings in files: what --print-config prints, --config reads, and options change."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of, run

from train.commands import self_play, train
from train.commands.config import with_config
from train.commands.main import main
from train.kinds import open_run
from train.runs.folder import read_config
from train.runs.parts import parts_of, settings_of
from train.runs.unused_settings import resolved_settings
from train.settings.self_play import WholeSettings


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--print-config"])
    assert stopped.value.code == 0
    return capsys.readouterr().out


def settings_in(command: str, arguments: list[str]) -> Any:
    if command == "train":
        return with_config(arguments, train.parsed).settings
    return with_config(arguments, self_play.parsed)[1]


def without_auto(settings: WholeSettings) -> Any:
    found = resolved_settings(settings)
    own = {name: value for name, value in found.items() if name in vars(settings.task)}
    rest = {name: value for name, value in found.items() if name not in own}
    return replace(settings, task=replace(settings.task, **own), **rest)


@pytest.mark.parametrize(
    "words",
    [
        "train",
        "train --maze 7x7 --frames 2e5 --seed 3 --line-of-sight --slip evader=0.1 --no-report",
        "train --gamma 0.9 --task maze --algorithm a2c --gamma-end None",
        "train --task maze --maze suite:5x5-train/0-9 --observation planes "
        "--curriculum maze-replay",
        "train --task heist --curriculum success-gated --network mlp --recurrent gru",
        "train --preset sisl-pursuit --frames 1e6",
        "train --preset thesis-dqn --task maze",
        "train --task reacher --joints 3 --algorithm sac --target-entropy -2.5 --frames 1e5",
        "train --game soccer --player B --algorithm q_learning --seconds 5 --clock processor",
        "train --num-chasers 2 --algorithm mappo --critic-observation planes",
        "self-play",
        "self-play --chaser.entropy-coef 0.05 --evader.algorithm dqn --members astar random "
        "--sampling uniform",
        "self-play --chaser astar --evader.no-anneal --frames 1e5",
        "self-play --task escape --view-radius 2",
        "self-play --game soccer --A uniform --gamma 0.9",
    ],
)
def test_a_printed_file_gives_the_same_settings(
    words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, *arguments = words.split()
    path = tmp_path / "run.toml"
    path.write_text(printed(capsys, command, *arguments))
    again = settings_in(command, ["--config", str(path)])
    assert again == without_auto(settings_in(command, arguments))
    second = printed(capsys, command, "--config", str(path))
    assert tomllib.loads(second) == tomllib.loads(path.read_text())


def test_defaults_are_marked(capsys: pytest.CaptureFixture[str]) -> None:
    lines = printed(capsys, "train", "--seed", "3", "--frames", "200000").splitlines()
    assert {"seed = 3", "frames = 200000", "num_games = 128  # default"} <= {*lines}
    assert 'role = "chaser"  # default: auto' in lines and "# gamma_end: None  # default" in lines
    assert not any(name in line for line in lines for name in ("action_std", "out =", "config ="))


def test_options_take_precedence_over_the_file(tmp_path: Path) -> None:
    path = tmp_path / "pair.toml"
    path.write_text(
        "seconds = 5\nwidth = 32\nstay_action = true\n"
        "[chaser]\nentropy_coef = 0.5\nanneal = false\n[evader]\nalgorithm = 'dqn'\n"
    )
    config = ["--config", str(path)]
    found = settings_in("self-play", config)
    assert (found.seconds, found.task.stay_action) == (5.0, True)
    chaser, evader = found.chaser, found.evader
    assert (chaser.hyper.entropy_coef, chaser.hyper.anneal, chaser.hyper.width) == (0.5, False, 32)
    assert (evader.algorithm, evader.hyper.width) == ("dqn", 32)
    more = ["--frames", "1e5", "--no-stay-action", "--entropy-coef", "0.25", "--evader", "astar"]
    found = settings_in("self-play", [*more, *config])
    assert (found.seconds, found.frames, found.task.stay_action) == (None, 100_000, False)
    assert (found.chaser.hyper.entropy_coef, found.chaser.hyper.anneal) == (0.25, False)
    assert found.evader == "astar"


@pytest.mark.parametrize(
    ("text", "more", "words"),
    [
        ("lr = 1", [], "FILE: Unrecognized options: --lr; perhaps you meant --learning-rate"),
        ("num_gamez = 1", [], "FILE: Unrecognized options: --num_gamez; perhaps you meant --num-g"),
        ("num_games = 'x'", [], "FILE: --num-games 'x': give a whole number"),
        ("num_games = -1", [], "FILE: num_games=-1; must be at least 1"),
        ("seed = true", [], "FILE: Missing value for argument '--seed'"),
        ("algorithm = 'pppo'", [], "FILE: unknown algorithm 'pppo' (did you mean 'ppo'?)"),
        ("[hyper]\nclip = 3", [], "FILE: Unrecognized options: --hyper.clip"),
        ("out = 'x'", [], "FILE: out is for the command line; leave it out"),
        ("a = [", [], "FILE: not TOML"),
        (
            "observation = 'evil:Payload'",
            [],
            "FILE: names 'evil:Payload', code that is not part of",
        ),
        ("gamma = 0.9", ["--bogus"], "error: Unrecognized options: --bogus"),
        ("gamma = 0.9", ["--num-games", "-4"], "error: num_games=-4"),
        ("action_std = 2.0", [], "error: action_std=2.0 has no effect: the actions are discrete"),
        (None, [], "FILE: No such file or directory"),
    ],
)
def test_errors_in_files_are_one_line_that_names_them(
    text: str | None,
    more: list[str],
    words: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "run.toml"
    if text is not None:
        path.write_text(text)
    said = error_of(capsys, "train", "--config", path, "--print-config", *more)
    assert words.replace("FILE", str(path)) in said


def test_errors_of_sides_and_of_resumed_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "pair.toml"
    path.write_text("[chaser]\nclipp = 3\n")
    said = error_of(capsys, "self-play", "--config", path)
    assert f"{path}: chaser: Unrecognized options: --clipp; perhaps you meant --clip" in said
    assert "with --config" in error_of(capsys, "train", "--resume", tmp_path, "--config", path)


@pytest.mark.parametrize(
    "own",
    [
        {"maze": "3x3"},
        {"maze": "3x3", "observation": "planes+id"},
        {"maze": "3x3", "observation": "walls"},
        {"maze": "pursuit_v5", "observation": "pursuit_v5", "num_chasers": 2},
        {"task": "maze", "maze": "suite:5x5-train/0-3", "observation": "window:2"},
        {"maze": "suite:5x5-train/0-3", "observation": "planes"},
        {"task": "reacher"},
        {"game": "soccer"},
    ],
)
def test_auto_is_the_network_that_is_built(own: dict[str, Any]) -> None:
    settings = settings_of(**own, frames=9_000_000)
    kinds = {"planes": "convolutions", "grid": "planning", "index": "mlp", "flat": "mlp"}
    named = settings_of(**own, frames=9_000_000, network=resolved_settings(settings)["network"])
    for each in (settings, named):
        assert resolved_settings(settings)["network"] == kinds[parts_of(each).seat.features.kind]


@pytest.mark.filterwarnings("ignore:frames=")
def test_a_run_prints_and_stores_what_auto_means(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = ("--maze", "2x2", "--num-games", "8", "--minibatch-size", "32", "--frames", "256")
    run("train", *tiny, "--no-report", "--episodes", "4", "--out", tmp_path / "run")
    found = json.loads((tmp_path / "run" / "config.json").read_text())
    assert {*found["resolved"]} == {"role", "network", "precision", "threads"}
    assert found["precision"] == "auto" and found["task"]["role"] == "auto"
    line = ", ".join(f"{name} {value}" for name, value in found["resolved"].items())
    assert f"auto: {line}\n" in capsys.readouterr().out
    assert "resolved" not in read_config(tmp_path / "run")[1]
    open_run(tmp_path / "run").lock.release()


def test_lists_stand_for_texts_with_commas(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('task = "escape"\nexits = [3, 5]\nlog = ["tensorboard"]\n')
    settings = settings_in("train", ["--config", str(path)])
    assert (settings.task.exits, settings.log) == ("3,5", "tensorboard")


def test_a_printed_file_with_another_game_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.toml"
    path.write_text(printed(capsys, "train", "--maze", "3x3"))
    text = error_of(capsys, "train", "--config", path, "--task", "reacher", longest=2000)
    assert f"these options do not fit the settings in {path}" in text
    path.write_text("view_radius = { chaser = 2 }\ngame = { a = [1] }\n")
    assert f"{path}: " in error_of(capsys, "train", "--config", path)
