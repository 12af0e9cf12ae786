"""The examples of the README run as they stand, one after the other."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest

from pursuit import parts
from pursuit.rewards import REWARDS
from train.commands.main import COMMANDS, main

README = Path(__file__).parents[1] / "README.md"
OWN_PARTS = README.parent / "docs" / "own_parts.md"
REACHER = README.parent / "docs" / "reacher.md"
VIEWER = README.parent / "docs" / "viewer.md"


def test_the_python_examples_run_in_order() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 6
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(README), "exec"), names)
    # The last simulator played the exact best response against the evader it was solved for.
    assert names["simulator"].episode_lengths.mean() < 40


def test_every_command_of_the_readme_exists() -> None:
    text = README.read_text(encoding="utf-8")
    commands = set(re.findall(r"^pursuit ([\w-]+)|`pursuit ([\w-]+)", text, re.MULTILINE))
    assert {first or second for first, second in commands} <= set(COMMANDS)


def test_the_pictures_of_the_readme_exist() -> None:
    for path in re.findall(r'src="([^"]+)"', README.read_text(encoding="utf-8")):
        assert (README.parent / path).is_file(), path


def test_the_python_examples_of_the_arm_run_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", REACHER.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 8
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(REACHER), "exec"), names)
    assert names["observed"].shape == (4096, 7) and (tmp_path / "arm.gif").is_file()
    assert names["rollout"]["next", "observation"].shape == (16, 50, 7)
    assert names["lower"] == names["upper"] and names["policy"].method == "cyclic"


def test_the_python_examples_of_the_viewer_run_in_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", VIEWER.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(VIEWER), "exec"), names)
    assert len(names["replay"].episodes) == 3 and "my games" in names["html"]


@pytest.fixture
def own_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The page on users' own parts, its `my_parts.py` written down where we are."""
    page = OWN_PARTS.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n# my_parts.py\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 5
    (tmp_path / "my_parts.py").write_text("\n\n".join(blocks), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(parts, "_allowed", set())
    monkeypatch.setattr(parts, "_resolved", set())
    monkeypatch.setattr(parts, "_folders", [])
    monkeypatch.setitem(sys.modules, "my_parts", None)  # what comes after is as it was before
    del sys.modules["my_parts"]
    return page


def test_the_python_examples_of_own_parts_run_in_order(own_parts: str) -> None:
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(?!# my_parts)(.*?)```", own_parts, re.DOTALL):
        exec(compile(block, str(OWN_PARTS), "exec"), names)
    assert names["simulator"].rewards.any() and parts.allowed() == ("my_parts",)
    REWARDS.remove("lazy")


@pytest.mark.slow
def test_the_commands_of_own_parts_run_in_order(own_parts: str) -> None:
    commands = re.findall(r"^pursuit .*$", own_parts, re.MULTILINE)
    assert len(commands) == 12
    for command in commands:
        main(shlex.split(command)[1:])
        if "--allow" in command:  # each is a process of its own
            parts._allowed.clear()
