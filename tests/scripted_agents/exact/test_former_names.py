"""The modules of `exact` have their former names too, without it, and stay the same modules."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from scripted_agents import exact, solve_joint
from scripted_agents.exact.joint.solver import solve_joint as solver_of

ROOT = Path(__file__).parents[3]
MODULES = [
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for file in Path(exact.__file__).parent.rglob("*.py")
]
CODE = """
import sys
for module in sys.argv[2:]:
    former = module.replace(".exact.", ".")
    parent, _, name = former.rpartition(".")
    space = {}
    exec(f"import {sys.argv[1]}{former}; found = {sys.argv[1]}{former}", space)
    exec(f"from {sys.argv[1]}{parent} import {name} as again", space)
    assert space["found"] is space["again"] is sys.modules[module], module
    assert module == space["found"].__name__ == space["found"].__spec__.name
"""


@pytest.mark.parametrize("prefix", ["", "pursuit."])
def test_former_names_are_those_of_the_same_modules(prefix: str) -> None:
    modules = [name for name in MODULES if name != exact.__name__]
    assert len(modules) > 40
    subprocess.run([sys.executable, "-c", CODE, prefix, *modules], cwd=ROOT, check=True)


def test_pickles_with_former_names_are_read() -> None:
    assert solve_joint is solver_of
    former = pickle.dumps(solve_joint, 0).replace(b".exact.", b".")
    assert b".exact" not in former and pickle.loads(former) is solve_joint
