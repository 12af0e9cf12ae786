"""The examples of the README run as they stand, one after the other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

README = Path(__file__).parents[1] / "README.md"


def test_the_python_examples_run_in_order() -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 6
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(README), "exec"), names)
    # The last simulator played the exact best response against the evader it was solved for.
    assert names["simulator"].episode_lengths.mean() < 40


def test_every_command_of_the_readme_exists() -> None:
    from train.commands.main import COMMANDS

    text = README.read_text(encoding="utf-8")
    commands = set(re.findall(r"^pursuit ([\w-]+)|`pursuit ([\w-]+)", text, re.MULTILINE))
    assert {first or second for first, second in commands} <= set(COMMANDS)


def test_the_pictures_of_the_readme_exist() -> None:
    for path in re.findall(r'src="([^"]+)"', README.read_text(encoding="utf-8")):
        assert (README.parent / path).is_file(), path
