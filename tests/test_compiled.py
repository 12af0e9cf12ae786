"""Compiled kernels are kept on disk, and thrown away when the rules that they inline change."""

import importlib
import os
import pkgutil
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import pursuit
import scripted_agents
from pursuit import compiled, encodings, kernel_cache
from scripted_agents import kernels

KERNEL = """
from pursuit.compiled import compiled
from pursuit.rules.pay import pay


@compiled
def total(steps):
    paid = 0
    for _ in range(steps):
        paid = pay(paid)
    return paid
"""
PAY = """
from pursuit.compiled import inlined
from pursuit.rules.amounts import raised


@inlined
def pay(paid):
    return raised(paid)
"""
RULES = """
from pursuit.compiled import subroutine


@subroutine
def raised(paid):
    return paid + {reward}
"""
ANNOUNCEMENT = "pursuit: compiling kernels, once, for some seconds ...\n"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package named `pursuit` that really compiles, with rules of one line in two files."""
    package = tmp_path / "pursuit"
    package.mkdir()
    (package / "__init__.py").touch()
    for module in (compiled, kernel_cache):
        shutil.copy(str(module.__file__), package)
    (package / "kernel.py").write_text(KERNEL)
    (package / "rules").mkdir()
    (package / "rules" / "__init__.py").touch()
    (package / "rules" / "pay.py").write_text(PAY)
    (package / "rules" / "amounts.py").write_text(RULES.format(reward=1))
    return package


def run(package: Path) -> tuple[int, str]:
    """What total(10) is, and what is said on stderr, in a process of its own."""
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    code = "from pursuit.kernel import total; print(total(10))"
    process = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=package.parent,
        env={**environment, "PYTHONPATH": str(package.parent)},
        timeout=120,
    )
    assert process.returncode == 0, process.stderr
    return int(process.stdout), process.stderr


def test_a_change_of_the_rules_reaches_the_kernels_of_other_files(package: Path) -> None:
    assert run(package) == (10, ANNOUNCEMENT)
    assert list(package.glob("__pycache__/kernel.total-*.nbc"))
    assert run(package) == (10, "")
    (package / "rules" / "amounts.py").write_text(RULES.format(reward=2))
    assert run(package) == (20, ANNOUNCEMENT)
    assert run(package) == (20, "")


def test_the_stamp_depends_on_kernel_rules_and_compiler(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel, rules = package / "kernel.py", package / "rules"
    monkeypatch.setattr(compiled, "HERE", package)
    monkeypatch.setattr(compiled, "__file__", str(package / "compiled.py"))
    stamps = []
    for file in (None, kernel, rules / "pay.py", rules / "amounts.py", package / "compiled.py"):
        if file is not None:
            file.write_text(file.read_text() + "\n# changed\n")
        compiled.source_stamp.cache_clear()
        stamps.append(compiled.source_stamp(str(kernel)))
    compiled.source_stamp.cache_clear()
    assert len(set(stamps)) == 5


def called_kernels(kernel: Dispatcher) -> Iterator[Dispatcher]:
    """Those that the code names, as `name` or as `module.name`."""
    function = kernel.py_func
    names = function.__code__.co_names
    found = [function.__globals__.get(name) for name in names]
    for module in [value for value in found if isinstance(value, ModuleType)]:
        found += [getattr(module, name, None) for name in names]
    yield from (value for value in found if isinstance(value, Dispatcher))


def test_kernels_call_kernels_of_their_own_file_and_of_the_rules_only() -> None:
    """The law that makes the stamp of a cache complete."""
    calls = 0
    for package in (pursuit, scripted_agents):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name == "pursuit.stable_baselines":
                continue  # loads torch, and has no kernels
            names = vars(importlib.import_module(module.name))
            made = [
                make(kind, 2, 2)
                for make in [names.get("team_entry_for")]
                if make
                for kind in (0, 1)
            ]
            for kernel in (*names.values(), *names.get("ENTRIES", {}).values(), *made):
                if not isinstance(kernel, Dispatcher):
                    continue
                own = kernel.py_func.__module__
                for called in called_kernels(kernel):
                    calls += 1
                    home = called.py_func.__module__
                    books = ("pursuit.rules.", "pursuit.reacher.rules")
                    assert home == own or home.startswith(books), (
                        f"{own}.{kernel.py_func.__name__} calls {home}.{called.py_func.__name__}"
                    )
    assert calls > 100


def test_one_kernel_serves_one_game_and_many() -> None:
    """Columns of one game lie in a row, those of many do not; it is all the same code."""
    seen, known = [], []
    for games in (1, 3):
        simulator = pursuit.Simulator(pursuit.make_task("chase"), games, seed=5)
        actions = np.zeros((games, 2), dtype=np.int32)
        simulator.act([None, scripted_agents.AStarEvader(0.5)], actions)
        seen.append((simulator.observe("index", 0)[0].tolist(), actions[0].tolist()))
        entries: list[Any] = [encodings.encode_index, kernels.ENTRIES[kernels.EVADER]]
        known.append([set(kernel.overloads) for kernel in entries])
    assert seen[0] == seen[1] and known[0] == known[1]


def test_what_kernels_call_is_compiled_for_one_width_of_whole_numbers() -> None:
    @compiled.subroutine
    def doubled(number: Any) -> Any:
        return 2 * number

    @compiled.inlined
    def summed(numbers: Any) -> Any:
        return doubled(numbers[0]) + doubled(3) + doubled(np.int16(4)) + doubled(np.int64(5))

    kernel = numba.njit(_nrt=False)(lambda numbers: summed(numbers))
    assert kernel(np.array([-6], dtype=np.int32)) == -12 + 6 + 8 + 10
    assert list(doubled.overloads) == [(numba.int64,)]  # type: ignore[attr-defined]
