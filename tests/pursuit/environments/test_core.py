"""Environments, scripted agents, solvers and curricula need no dependency of training."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest

import pursuit

ROOT = Path(__file__).parents[3]
BLOCKED = (
    "torch",
    "torchrl",
    "tensordict",
    "tyro",
    "pyarrow",
    "matplotlib",
    "tensorboard",
    "networkx",
    "supersuit",
    "stable_baselines3",
    "pandas",
    "rich",
    "filelock",
    "pyspiel",
)
"""Packages that are not of the core: of the default installation and of extras."""
EXTRAS = (
    "pursuit.environments.stable_baselines",
    "scripted_agents.games.openspiel",
    "scripted_agents.games.openspiel_games",
    "scripted_agents.games.openspiel_loading",
)
"""Modules for those who have the package of an extra."""

USE = """
import sys
for name in {blocked!r}:
    sys.modules[name] = None  # to import it is an ImportError from here on

import importlib, pkgutil
import numpy as np
import curricula, pursuit, scripted_agents
for package in (pursuit, scripted_agents, curricula):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if module.name not in {extras!r}:
            importlib.import_module(module.name)
for module, names in pursuit._names.items():
    for name in names if module.partition(".")[0] != "train" else ():
        getattr(pursuit, name)

import gymnasium
from pettingzoo.test import parallel_api_test
from scripted_agents import *

for name in ("Chaser", "Evader", "Maze", "Reacher"):
    env = gymnasium.make(f"pursuit/{{name}}-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    assert env.render().ndim == 3
    envs = gymnasium.make_vec(f"pursuit/{{name}}-v0", 3)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
parallel_api_test(pursuit.chase_v0.parallel_env(maze="3x3", num_evaders=2), num_cycles=50)
parallel_api_test(pursuit.reacher_v0.parallel_env(max_steps=20), num_cycles=50)

maze = pursuit.load_maze("3x3")
evader = AStarEvader(epsilon=0.2).action_probabilities(maze)
best = best_response("chaser", maze, evader, horizon=50)
chaser = AStarChaser().action_probabilities(maze)
a_star = evaluate_exactly(maze, chaser, evader, horizon=50)
assert mean_over_starts(best.values, maze) <= mean_over_starts(a_star, maze)
assert tour_length(maze, 0, [4, 8]) >= 4 and expected_tour_length(maze, 2) > 0
assert solve_chase(maze).values.shape == (9, 9) and cop_number(maze) in (1, 2)
assert len(shortest_path(maze, 0, 8)) >= 2
assert least_steps([0.0, 0.0], [0.0, 1.0])[0] > 0
task = pursuit.make_task("chase", maze="2x2", num_chasers=2)
pair = {{"chaser": AStarChaser(0.1), "evader": AStarEvader(0.2)}}
assert mean_over_team_starts(evaluate_team(task, pair), task) > 0
simulator = pursuit.Simulator(pursuit.make_task("chase", maze=maze), 64, seed=0)
actions = np.zeros((64, 2), dtype=np.int32)
for _ in range(20):
    simulator.act([OptimalChaser(), AStarEvader(0.2)], actions)
    simulator.step(actions)
value = curricula.linear(1.0, 0.0, 0.5)
print(value, sorted(name for name in {blocked!r} if sys.modules.get(name)))
"""


def requirements(lines: list[str]) -> dict[str, str]:
    """The version ranges by project."""
    bare = [line.split("#")[0].strip() for line in lines]
    found = [re.fullmatch(r"([\w-]+)(\[\w+\])?(.*)", line) for line in bare if line]
    return {match[1].lower(): match[3] for match in found if match}


def test_it_is_used_with_all_of_training_blocked() -> None:
    """Without compilation, which takes a minute in a new process and imports nothing of ours."""
    process = subprocess.run(
        [sys.executable, "-c", USE.format(blocked=BLOCKED, extras=EXTRAS)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        timeout=300,
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines()[-1] == "0.5 []"  # after lines of PettingZoo


@pytest.mark.slow
def test_it_is_installed_by_one_command(tmp_path: Path) -> None:
    """In an environment of its own, from a copy, since pip builds in the folder."""
    for name in ("core", "pursuit", "scripted_agents", "curricula"):
        ignored = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, symlinks=True, ignore=ignored)
    venv.create(tmp_path / "env", with_pip=True)
    python = str(tmp_path / "env" / "bin" / "python")
    pip = [python, "-m", "pip", "install", "--quiet", "--no-compile", str(tmp_path / "core")]
    installed = subprocess.run(pip, capture_output=True, text=True, timeout=600)
    if installed.returncode:
        pytest.skip(f"cannot be installed here: {installed.stderr.strip().splitlines()[-1]}")
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    environment.pop("PYTHONPATH", None)
    use = "import pursuit; print(pursuit.__file__)" + USE.format(blocked=(), extras=EXTRAS)
    for command in (["-m", "pip", "check"], ["-c", use]):
        done = subprocess.run(
            [python, *command],
            capture_output=True,
            text=True,
            cwd=tmp_path / "env",
            env=environment,
        )
        assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith(str(tmp_path / "env")) and lines[-1] == "0.5 []"
    found = [*(tmp_path / "env").glob("lib/*/site-packages/*")]
    files = {re.split(r"-\d|\.", each.name)[0].lower() for each in found}
    assert "numba" in files and not files & {*BLOCKED, "train"}


def test_the_core_asks_for_what_the_default_installation_does_and_for_less() -> None:
    """And both are of one version, license and range of Python, with the same files."""
    files = (ROOT / "pyproject.toml", ROOT / "core" / "pyproject.toml")
    whole, core = (tomllib.loads(each.read_text(encoding="utf-8"))["project"] for each in files)
    assert all(core[key] == whole[key] for key in ("license", "requires-python"))
    assert core["dynamic"] == ["version"] and whole["version"] == pursuit.__version__
    needed, less = requirements(whole["dependencies"]), requirements(core["dependencies"])
    assert less.items() <= needed.items() and len(less) == 8
    assert not {*less} & {*BLOCKED}
    links = {each.name: each.resolve() for each in (ROOT / "core").iterdir() if each.is_symlink()}
    names = ("pursuit", "scripted_agents", "curricula", "LICENSE")
    assert links == {name: ROOT / name for name in names}
