"""The lower ends of pyproject.toml work; the pins of constraints.txt are the upper ones."""

from __future__ import annotations

import os
import re
import subprocess
import sysconfig
import tomllib
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = ("pursuit/rules/test_rules.py", "scripted_agents/exact/duel/test_best_response.py")
"""Tests of rules and solvers, below tests/; the commands test runs."""


def lower_ends() -> list[str]:
    """name==version of what the default installation asks for at least; torch stays as it is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ends = [
        re.fullmatch(r"([\w-]+)>=([\w.]+)(,<\d+)?(; python_version.*)?", each)
        for each in project["dependencies"]
    ]
    assert all(ends), "every dependency has a lower end"
    found = {end[1]: end[2] for end in ends if end}
    del found["torch"]  # gigabytes
    return [f"{name}=={version}" for name, version in found.items()]


@pytest.mark.slow
def test_training_works_at_the_lower_ends(tmp_path: Path) -> None:
    """In an environment of its own, of which torch alone is the installed one."""
    venv.create(tmp_path / "low", with_pip=True)
    python = tmp_path / "low" / "bin" / "python"
    paths = {"base": str(tmp_path / "low"), "platbase": str(tmp_path / "low")}
    fresh = Path(sysconfig.get_paths(vars=paths)["purelib"])
    for part in Path(sysconfig.get_paths()["purelib"]).glob("torch*"):
        if re.fullmatch(r"torch|torchgen|torch-.*\.dist-info", part.name):
            (fresh / part.name).symlink_to(part)
    pip = [python, "-m", "pip", "install", "--quiet", "pytest", "hypothesis", *lower_ends()]
    installed = subprocess.run(pip, capture_output=True, text=True, timeout=1200)
    if installed.returncode:
        pytest.skip(f"cannot be installed here: {installed.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RL_WARNINGS": "0"}
    code = "import torchrl, gymnasium; print(torchrl.__version__, gymnasium.__version__)"
    for algorithm in ("ppo", "dqn"):
        train = ["-m", "train.commands.main", "train", "--task", "chase", "--role", "chaser"]
        how = ["--maze", "3x3", "--algorithm", algorithm, "--frames", "20000"]
        out = ["--out", str(tmp_path / algorithm)]
        done = subprocess.run(
            [python, *train, *how, *out], capture_output=True, text=True, env=environment
        )
        assert done.returncode == 0, done.stderr
    told = subprocess.run([python, "-c", code], capture_output=True, text=True, env=environment)
    versions = dict(each.split("==") for each in lower_ends())
    assert told.stdout.split() == [versions["torchrl"], f"{versions['gymnasium']}.0"]
    core = [python, "-m", "pytest", "-q", *(str(ROOT / "tests" / each) for each in CORE)]
    done = subprocess.run(core, capture_output=True, text=True, env=environment, cwd=ROOT)
    assert done.returncode == 0, done.stdout


def test_every_dependency_has_a_lower_end() -> None:
    assert len(lower_ends()) >= 18
    assert all((ROOT / "tests" / each).exists() for each in CORE)
