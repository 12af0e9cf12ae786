"""The command in unusual shells: closed streams, a deleted folder, other encodings and names."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of

from pursuit import load_maze
from train.commands.help import described
from train.commands.main import COMMANDS, main
from train.files import read_json
from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import settings_of
from train.runs.provenance import allow_options

ROOT = Path(__file__).parents[3]
TINY = "--maze 2x2 --num-games 16 --rollout-steps 8 --minibatch-size 64 --width 8 --threads 1"


def shell(text: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """A line of a shell, in which `pursuit` is the command."""
    command = f"{sys.executable} -m train.commands.main"
    return subprocess.run(
        ["sh", "-c", text.replace("pursuit", command)],
        capture_output=True,
        text=True,
        errors="replace",
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        timeout=120,
    )


@pytest.mark.slow
def test_a_closed_standard_output_is_written_to_in_vain(tmp_path: Path) -> None:
    options = f"{TINY} --frames 512 --episodes 2 --no-report"
    done = shell(f"pursuit train {options} --out run >&-", tmp_path)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "Traceback" not in done.stderr and (tmp_path / "run" / "results.json").exists()
    assert shell("pursuit maze 2x2 >&- 2>&- <&-", tmp_path).returncode == 0


def test_a_current_folder_that_is_deleted_is_refused(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    done = shell('rmdir "$PWD"; pursuit maze 2x2', tmp_path / "gone")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "the current folder cannot be read" in done.stderr


@pytest.mark.slow
def test_what_a_terminal_cannot_show_is_escaped(tmp_path: Path) -> None:
    maze = tmp_path / "mäze.txt"
    maze.write_text("+-+-+\n|S G|\n+-+-+", encoding="utf-8")
    command = "pursuit baseline --task maze --num-goals 1 --episodes 2 --maze mäze.txt"
    done = shell(command, tmp_path, PYTHONIOENCODING="ascii", PYTHONUTF8="1")
    assert done.returncode == 0 and "m\\xe4ze" in done.stdout, done.stderr


def test_help_ends_in_a_narrow_terminal(tmp_path: Path) -> None:
    done = shell("pursuit maze --help", tmp_path, COLUMNS="5")
    assert done.returncode == 0 and "--generate" in done.stdout, done.stderr


def test_names_that_are_not_utf_8_are_refused(tmp_path: Path) -> None:
    for text, variables in (
        ("printf '%b' 'r\\0377' | xargs -I NAME pursuit train --maze 2x2 --out NAME", {}),
        (
            "pursuit train --maze 2x2 --out rün",
            {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        ),
    ):
        done = shell(text, tmp_path, **variables)
        assert "not UTF-8; rename it" in done.stderr and done.stderr.count("\n") == 1
    with pytest.raises(ValueError, match="not UTF-8"):
        start(RUN, settings_of(maze="2x2", frames=512), tmp_path / os.fsdecode(b"r\xff"))
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore:frames=")
def test_byte_order_marks_are_passed_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In all text files that commands read: some editors write them."""
    folder, mark = tmp_path / "run", b"\xef\xbb\xbf"
    words = [*TINY.split(), "--max-steps", "9", "--episodes", "4"]
    main(["train", *words, "--frames", "256", "--out", str(folder)])
    sweep = tmp_path / "tiny.toml"
    sweep.write_text('[settings]\ntask = "maze"\nmaze = "2x2"\nframes = 64\n[short]\nseeds = [0]\n')
    maze = tmp_path / "own.txt"
    maze.write_text(load_maze("3x3").to_text())
    texts = [*folder.glob("*.json"), folder / "metrics.csv", sweep, maze]
    assert len(texts) >= 6
    for path in texts:
        path.write_bytes(mark + path.read_bytes())
    for command in (
        ["evaluate", folder, "--episodes", "4"],
        ["report", folder, "--out", tmp_path / "report"],
        ["view", folder, folder / "replays.json", "--out", tmp_path / "page.html"],
        ["sweep", sweep, "--dry-run", "--out", tmp_path / "sweep"],
        ["maze", maze],
    ):
        main([str(word) for word in command])
    assert "warning" not in capsys.readouterr().err.replace("warning: frames=", "")


def test_options_of_paths_refuse_an_empty_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """For `Path` it is the present folder."""
    monkeypatch.chdir(tmp_path)
    seen = 0
    for command in COMMANDS:
        with pytest.raises(SystemExit):
            main([command, "--help"])
        for name in re.findall(r"(--[a-z-]+) PATH", capsys.readouterr().out):
            for given in ([name, ""], [f"{name}="]):
                said = error_of(capsys, command, *shlex.split(COMMANDS[command]), *given)
                assert f"{name} '': give a path" in said
            seen += 1
    for command in ("view", "report"):
        assert "error: '': give a path (see" in error_of(capsys, command, "a", "")
    assert "error: '': give the folder of a run" in error_of(capsys, "league", "")
    assert seen > 12 and not [*tmp_path.iterdir()]


def test_without_docstrings_a_help_has_no_signature() -> None:
    """As with python -OO: Python then puts the signature of a dataclass in the place."""

    @dataclass
    class Bare:
        count: int = 1

    assert str(Bare.__doc__).startswith("Bare(count")
    assert described(Bare) == ""


@pytest.mark.slow
def test_without_compilation_nothing_is_warned_of(tmp_path: Path) -> None:
    """NumPy warns of the overflows on which random numbers rest."""
    line = (
        f"NUMBA_DISABLE_JIT=1 pursuit train --task heist {TINY} --num-goals 1 --max-steps 5 "
        "--frames 256 --episodes 4 --no-report --out run"
    )
    done = shell(line, tmp_path, PYTHONWARNINGS="error::RuntimeWarning")
    assert done.returncode == 0, done.stderr
    assert "overflow" not in done.stderr and "RuntimeWarning" not in done.stderr


def test_half_characters_in_json_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(r'["\ud83d\ude00", "\\ud800 is text"]')
    assert read_json(path) == ["\U0001f600", "\\ud800 is text"]
    path.write_text(r'{"task": {"maze": "\ud800"}}')
    with pytest.raises(ValueError, match="damaged, not JSON"):
        read_json(path)


@pytest.mark.parametrize("name", ["os:system", "os:getcwd"])
def test_a_function_of_other_arguments_is_no_reward(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = error_of(capsys, "train", "--maze=2x2", "--rewards", name, "--out", tmp_path / "run")
    assert "must be a function (before, actions, after)" in said


@pytest.mark.parametrize("parts", [{"rewards": {}}, {"rewards": {"name": None, "sha256": ""}}])
def test_parts_of_another_form_are_damage(parts: Any, tmp_path: Path) -> None:
    config = tmp_path / "config.json"
    config.write_text(json.dumps({"parts": parts}))
    with pytest.raises(ValueError, match=r"config\.json, parts: .*restore it from a copy"):
        allow_options(config)
