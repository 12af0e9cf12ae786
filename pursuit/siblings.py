"""The packages beside this one, `scripted_agents`, `curricula` and `train`, by names that are ours.

Their names are common ones: a script or package of a user, such as `train.py`, hides ours where its
folder stands first on the search path. So each of their modules has a second name within this
package: `pursuit.train.runs` is `train.runs`.

- If `import train` gives ours, the second name leads to the same module, and nothing else changes.
- If it gives another one, which may happen at any time, ours is loaded from its folder under the
  second name, and the import statements in its files, which say `train`, use the second names, too
  (Python looks `__import__` up in the `__builtins__` of a module).

So the user's module is neither executed nor replaced, no module of ours is loaded twice, compiled
files and pickles are shared, and the source keeps static absolute imports for type checkers. Names
of ours in strings begin with "pursuit.". To put ours into `sys.modules` as `train` would not do: in
`python -m train`, a user's package needs that name for its own modules.
"""

from __future__ import annotations

import builtins
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import (
    SOURCE_SUFFIXES,
    FileFinder,
    ModuleSpec,
    PathFinder,
    SourceFileLoader,
)
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parents[1]
NAMES = ("scripted_agents", "curricula", "train")


def hidden_by(top: str) -> str | None:
    """The file or folder that `import top` gives instead of ours; None if it gives ours.

    Nothing is imported. `top` is one of `NAMES`.
    """
    loaded: Any = sys.modules.get(top)
    file, places = getattr(loaded, "__file__", None), getattr(loaded, "__path__", None)
    if loaded is None:
        others = (each for each in sys.meta_path if getattr(each, "__module__", "") != __name__)
        spec: Any = next(filter(None, (each.find_spec(top, None) for each in others)), None)
        file, places = spec and spec.origin, spec and spec.submodule_search_locations
    if file is None:  # a namespace package, or nothing
        return next(iter(places or ()), f"no {top}")
    ours = str(ROOT / top / "__init__.py")
    return None if file == ours or os.path.realpath(file) == os.path.realpath(ours) else file


def is_ours(module: str) -> bool:
    """Whether a module with this name is one of this project."""
    top = module.partition(".")[0]
    return top == "pursuit" or (top in NAMES and hidden_by(top) is None)


def second_name(module: str) -> str:
    """The name of a module that no other module hides: with "pursuit." in front if it is ours."""
    return f"pursuit.{module}" if module.partition(".")[0] in NAMES else module


def _loaded_as(name: str) -> str | None:
    """The name under which the module `name` was loaded; None before that."""
    return getattr(sys.modules.get(name), "__name__", None)


class Finder:
    """Finds our packages under both of their names; in `sys.meta_path`, which Python asks first."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, _: Any = None) -> ModuleSpec | None:
        """How to load a module of ours; None for others, and where Python's own way is right."""
        public = name.removeprefix("pursuit.")
        top, _, below = public.partition(".")
        if top not in NAMES:
            return None
        other = public if name != public else f"pursuit.{name}"
        if below:  # a module is loaded under that of its names under which its package was
            parent = _loaded_as(name.rpartition(".")[0]) or name
            is_second = parent.startswith("pursuit.") != name.startswith("pursuit.")
        else:
            is_second = hidden_by(top) is None and (name != public or _loaded_as(other) == other)
        if is_second:
            return ModuleSpec(name, SecondName(other))
        if name == public and (not below or hidden_by(top) or not any(map(hidden_by, NAMES))):
            check_hidden(name, path)
            return None
        folder = path[0] if path and below else str(ROOT)
        return FileFinder(folder, (OwnLoader, SOURCE_SUFFIXES)).find_spec(name)


def check_hidden(name: str, path: Sequence[str] | None = None) -> None:
    """ModuleNotFoundError if our package is hidden, and it alone has the module `name`.

    Args:
        name: of any module; it is not imported.
        path: where the package that hides ours has its modules; default: its folder.
    """
    parts = name.split(".")
    hidden = hidden_by(parts[0]) if parts[0] in NAMES and len(parts) > 1 else None
    if hidden is None:
        return
    if path is None:  # a file other than __init__.py has no modules
        parts, path = parts[:2], [hidden.removesuffix("__init__.py")]
    places = [str(ROOT.joinpath(*parts[:-1]))], path
    ours, theirs = (PathFinder.find_spec(parts[-1], each) for each in places)
    if ours and not theirs:
        raise ModuleNotFoundError(
            f"no module {name!r}: {parts[0]!r} is {hidden}, which hides the package of Pursuit; "
            f"import pursuit.{name}, or rename yours",
            name=name,
        )


class SecondName(Loader):
    """Loads a module by its other name: both are one module."""

    def __init__(self, other: str) -> None:
        self.other = other

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module itself, loaded by now."""
        module = import_module(self.other)
        self.spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module, which has been executed, its own spec back."""
        module.__spec__ = self.spec


class OwnLoader(SourceFileLoader):
    """Executes a module so that its import statements give our packages."""

    def exec_module(self, module: ModuleType) -> None:
        """As its base class."""
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": import_ours}
        super().exec_module(module)


def import_ours(name: str, scope: Any, local: Any, fromlist: Any, level: int) -> ModuleType:
    """`__import__` of our modules; statements call it with these arguments."""
    ours = name if level else second_name(name)
    module = builtins.__import__(ours, scope, local, fromlist, level)
    # `import train.runs` gives `train`
    return module if fromlist or ours == name else sys.modules[second_name(name.partition(".")[0])]


def install() -> None:
    """Make Python ask `Finder` first."""
    if not any(getattr(each, "__module__", "") == __name__ for each in sys.meta_path):
        sys.meta_path.insert(0, Finder)
