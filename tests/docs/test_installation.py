"""The table of dependencies lists those of pyproject.toml, and says who imports them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "guides" / "installation.md").read_text(encoding="utf-8")
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| `(\w+)` \| [\d.]+ \| [\d.]+ \| (.*?) \|", re.MULTILINE)
MODULES = {"pillow": "PIL"}
"""Modules that have another name than their project."""
ELSEWHERE = {"tensorboard", "SuperSuit"}
"""Imported by another dependency, or by users."""


def imports(place: Path, module: str) -> bool:
    """Whether a file, or one of a folder, imports a module."""
    files = place.rglob("*.py") if place.is_dir() else [place.with_suffix(".py")]
    found = re.compile(rf"^ *(import|from) {module}\b", re.MULTILINE)
    return any(found.search(file.read_text(encoding="utf-8")) for file in files)


def test_the_table_lists_the_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.split(r"[><=]", each)[0] for each in project["dependencies"]]
    assert [row[0] for row in ROW.findall(PAGE)] == names
    assert f"`pyproject.toml` lists {len(names)}," in GUIDE


def test_those_who_import_a_dependency_do() -> None:
    for name, users in ROW.findall(PAGE):
        module = MODULES.get(name, name)
        for user in re.findall(r"`([\w.]+)`", users):
            assert imports(ROOT.joinpath(*user.split(".")), module), f"{user} imports {module}"
        packages = ("pursuit", "scripted_agents", "train")
        used = any(imports(ROOT / each, module) for each in packages)
        assert used != (name in ELSEWHERE), name
