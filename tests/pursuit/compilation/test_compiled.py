"""Compiled kernels are cached on disk and recompiled when functions that they inline change."""

import ast
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

import numpy as np
import pytest

import pursuit
import scripted_agents
from pursuit import siblings
from pursuit.compilation import compiled, compiler, kernel_cache
from pursuit.compilation.compiled import Kernel
from scripted_agents.exact.tours.kernels import held_karp

KERNEL = """
from pursuit.compilation.compiled import compiled
from pursuit.rules.pay import pay


@compiled
def total(steps):
    paid = 0
    for _ in range(steps):
        paid = pay(paid)
    return paid
"""
PAY = """
from pursuit.compilation.compiled import inlined
from pursuit.rules.amounts import raised


@inlined
def pay(paid):
    return raised(paid)
"""
RULES = """
from pursuit.compilation.compiled import subroutine


@subroutine
def raised(paid):
    return paid + {reward}
"""
ANNOUNCEMENT = (
    "pursuit: compiling kernels (once per machine and kind of game), up to about "
    f"{sum(compiler.USUAL[0].values()):.0f} s remain ...\n"
)


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package named `pursuit` that really compiles, with rules of one line in two files."""
    package = tmp_path / "pursuit"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "compilation").mkdir()
    (package / "compilation" / "__init__.py").touch()
    for module in (compiled, compiler, kernel_cache):
        shutil.copy(str(module.__file__), package / "compilation")
    shutil.copy(siblings.__file__, package)
    (package / "kernel.py").write_text(KERNEL)
    (package / "rules").mkdir()
    (package / "rules" / "__init__.py").touch()
    (package / "rules" / "pay.py").write_text(PAY)
    (package / "rules" / "amounts.py").write_text(RULES.format(reward=1))
    return package


def run(package: Path) -> tuple[int, str]:
    """The result of total(10) and the output on stderr, in a subprocess."""
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


@pytest.mark.slow
def test_a_change_of_the_rules_recompiles_kernels_of_other_files(package: Path) -> None:
    assert run(package) == (10, ANNOUNCEMENT)
    assert list(package.glob("__pycache__/kernel.total-*.nbc"))
    assert run(package) == (10, "")
    (package / "rules" / "amounts.py").write_text(RULES.format(reward=2))
    assert run(package) == (20, ANNOUNCEMENT)
    assert run(package) == (20, "")


def test_the_stamp_depends_on_all_files_that_a_kernel_imports(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel, rules = package / "kernel.py", package / "rules"
    (rules / "other.py").write_text("from pursuit.rules.amounts import raised\n")
    monkeypatch.setattr(kernel_cache, "ROOT", package.parent)
    stamps = []
    imported = [
        kernel,
        rules / "pay.py",
        rules / "amounts.py",
        package / "compilation" / "compiled.py",
        package / "compilation" / "compiler.py",
    ]
    for file in [None, *imported, package / "compilation" / "kernel_cache.py", rules / "other.py"]:
        if file is not None:
            file.write_text(file.read_text() + "\n# changed\n")
        kernel_cache.source_stamp.cache_clear()
        stamps.append(kernel_cache.source_stamp(str(kernel)))
    kernel_cache.source_stamp.cache_clear()
    assert len(set(stamps)) == 7 and stamps[-2] == stamps[-1]


@pytest.mark.parametrize(
    "line",
    [
        "import pursuit.rules.amounts",
        "import pursuit.rules.amounts as other, sys",
        "from pursuit.rules import amounts",
        "from pursuit.rules.amounts import raised",
        "def f():\n    from pursuit.rules.amounts import raised",
        "from pursuit import rules",
        "from pursuit.rules import (  # (the rules)\n    pay,\n    amounts as other,\n)",
        "from pursuit.rules import pay, \\\n    amounts",
        "import sys; import pursuit.rules.amounts",
        "if True: from pursuit.rules import amounts",
    ],
)
def test_every_form_of_import_is_followed(
    package: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.setattr(kernel_cache, "ROOT", package.parent)
    (package / "rules" / "__init__.py").write_text("from pursuit.rules import amounts\n")
    (package / "new.py").write_text(f"import numpy\nfrom scripted_agents.none import x\n{line}\n")
    assert package / "rules" / "amounts.py" in kernel_cache.imported_files(package / "new.py")


def test_imports_are_those_of_the_parser() -> None:
    for package in kernel_cache.PACKAGES:
        for file in (kernel_cache.ROOT / package).rglob("*.py"):
            names = set()
            for node in ast.walk(ast.parse(file.read_text())):
                if isinstance(node, ast.Import):
                    names |= {each.name for each in node.names}
                elif isinstance(node, ast.ImportFrom):
                    names |= {f"{node.module}.{each.name}" for each in node.names}
            ours = {name for name in names if name.split(".")[0] in kernel_cache.PACKAGES}
            assert ours <= kernel_cache.imported_names(file), file


def called_kernels(kernel: Kernel) -> Iterator[Kernel]:
    """Those that the code names, as `name` or as `module.name`."""
    function = kernel.py_func
    names = function.__code__.co_names
    found = [function.__globals__.get(name) for name in names]
    for module in [value for value in found if isinstance(value, ModuleType)]:
        found += [getattr(module, name, None) for name in names]
    yield from (value for value in found if isinstance(value, Kernel))


def test_the_stamp_covers_every_kernel_that_a_kernel_calls() -> None:
    calls = elsewhere = 0
    for package in (pursuit, scripted_agents):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name == "pursuit.environments.stable_baselines":
                continue  # loads torch, and has no kernels
            names = vars(importlib.import_module(module.name))
            made = [
                make(kind, 2, 2)
                for make in [names.get("team_entry_for")]
                if make
                for kind in (0, 1)
            ]
            for kernel in (*names.values(), *names.get("ENTRIES", {}).values(), *made):
                if not isinstance(kernel, Kernel):
                    continue
                own = Path(kernel.py_func.__code__.co_filename)
                for called in called_kernels(kernel):
                    home = Path(called.py_func.__code__.co_filename)
                    calls += 1
                    elsewhere += home != own
                    assert home in kernel_cache.imported_files(own)
    assert calls > 100 and elsewhere > 50


def test_the_first_call_of_a_kernel_takes_names_of_arguments() -> None:
    fresh: Any = compiled.compiled(held_karp.py_func)  # type: ignore[attr-defined]
    between, best = np.array([[0, 3], [3, 0]], dtype=np.int32), np.zeros((2, 1), dtype=np.int32)
    assert fresh(between=between, num_goals=1, best=best) == 3
