"""Imports run one way: pursuit <- scripted_agents, curricula <- train; torch only in train."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FORBIDDEN = {
    "pursuit": {"scripted_agents", "curricula", "train"},
    "scripted_agents": {"curricula", "train"},
    "curricula": {"pursuit", "scripted_agents", "train"},
}
TORCH = {"torch", "torchrl", "tensordict"}


def imported_packages(file: Path) -> set[str]:
    packages = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            packages |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: a relative import hides where it leads"
            packages.add((node.module or "").split(".")[0])
    return packages


def run(code: str) -> str:
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports_run_one_way(package: str) -> None:
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for file in files:
        wrong = imported_packages(file) & (FORBIDDEN[package] | TORCH)
        assert not wrong, f"{file} imports {wrong}"


def test_playing_loads_no_torch() -> None:
    code = """
import importlib, pkgutil, sys
import pursuit, scripted_agents, curricula
for package in (pursuit, scripted_agents, curricula):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name != "pursuit.stable_baselines":  # Stable-Baselines3 itself is torch
            importlib.import_module(module.name)
import gymnasium
gymnasium.make("pursuit/Chaser-v0").reset()
print(sorted({"torch", "torchrl", "tensordict", "train", "stable_baselines3"} & {*sys.modules}))
"""
    assert run(code) == "[]\n"


def test_importing_pursuit_is_light() -> None:
    code = """
import sys, pursuit
assert "Simulator" in dir(pursuit) and "scripted_agents" not in sys.modules
print(sorted({"numba", "scipy", "torch", "PIL", "pygame", "matplotlib"} & {*sys.modules}))
pursuit.Simulator
print("numba" in sys.modules)
"""
    assert run(code) == "[]\nTrue\n"


def test_a_missing_name_is_said() -> None:
    code = "import pursuit\ntry: pursuit.Maize\nexcept AttributeError as error: print(error)"
    assert run(code) == "No pursuit attribute Maize\n"


def test_every_public_name_is_there() -> None:
    run("import pursuit\nfor name in pursuit.__all__: getattr(pursuit, name)")
    names = "pursuit.__version__, pursuit.heist_v0.parallel_env().possible_agents"
    assert run(f"import pursuit; print({names})").endswith(" ['chaser_0', 'evader_0']\n")


def test_pettingzoo_without_a_registry_will_do() -> None:
    code = """
import pettingzoo
del pettingzoo.register
from pursuit import chase_v0
print(chase_v0.parallel_env().possible_agents)
"""
    assert run(code) == "['chaser_0', 'evader_0']\n"


def test_gymnasium_ids_work_without_importing_pursuit_first() -> None:
    code = """
import gymnasium
env = gymnasium.make("pursuit:pursuit/Chaser-v0", maze="3x3")
print(env.reset(seed=1)[0].shape)
envs = gymnasium.make_vec("pursuit:pursuit/Maze-v0", num_envs=2, maze="3x3", num_goals=1)
print(type(envs).__name__, envs.reset(seed=1)[0].shape)
"""
    assert run(code) == "(27,)\nSingleAgentVectorEnv (2, 27)\n"
