"""The packages beside this one, `scripted_agents`, `curricula` and `train`, by names that are ours.

Their names are common ones: a script or package of a user, such as `train.py`, hides ours where its
folder stands first on the search path. So each of their modules has a second name within this
package: `pursuit.train.runs` is `train.runs`. If `import train` gives ours, the second name leads
to the same module, and nothing else changes. If it gives another one, which may happen at any time,
ours is loaded from its folder under the second name, and the import statements in its files, which
say `train`, use the second names, too (Python looks `__import__` up in the `__builtins__` of a
module). So the user's module is neither executed nor replaced, no module of ours is loaded twice,
compiled files and pickles are shared, and the source keeps static absolute imports for type
checkers. Names of ours in strings begin with "pursuit.".
"""

from __future__ import annotations

import builtins
import os
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parents[1]
NAMES = ("scripted_agents", "curricula", "train")


def hidden_by(top: str) -> str | None:
    """The file or folder that `import top` gives instead of ours; None if it gives ours.

    Nothing is imported. `top` is one of `NAMES`.
    """
    loaded = sys.modules.get(top)
    file: Any = getattr(loaded, "__file__", None)
    places: Any = getattr(loaded, "__path__", ())
    if loaded is None:
        spec = _search(top)
        if spec is not None:
            file, places = spec.origin, spec.submodule_search_locations or ()
    if file is None:  # a namespace package, or nothing
        return next(iter(places), f"no {top}")
    ours = str(ROOT / top / "__init__.py")
    return None if file == ours or os.path.realpath(file) == os.path.realpath(ours) else file


def is_ours(module: str) -> bool:
    """Whether a module with this name is one of this project."""
    top = module.partition(".")[0]
    return top == "pursuit" or (top in NAMES and hidden_by(top) is None)


def _search(top: str) -> ModuleSpec | None:
    """What Python would import as `top` without this module."""
    others = [each for each in sys.meta_path if getattr(each, "__module__", "") != __name__]
    found = (finder.find_spec(top, None) for finder in others)
    return next((spec for spec in found if spec is not None), None)


class Finder:
    """Finds our packages under both of their names; in `sys.meta_path`, which Python asks."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, _: Any = None) -> ModuleSpec | None:
        """How to load a module of ours; None for others, and where Python's own way is right."""
        public = name.removeprefix("pursuit.")
        top, _, below = public.partition(".")
        if top not in NAMES:
            return None
        other = public if name != public else f"pursuit.{name}"
        if below:
            parent, named = (sys.modules.get(each.rpartition(".")[0]) for each in (name, other))
            same = parent is not None and parent is named
            is_loaded = same and getattr(parent, "__name__", "") != name.rpartition(".")[0]
        else:
            is_loaded = hidden_by(top) is None and (
                name != public
                or isinstance(getattr(sys.modules.get(other), "__loader__", None), OwnLoader)
            )
        if is_loaded:
            return ModuleSpec(name, SecondName(other))
        if name == public:
            if not below or not any(map(hidden_by, NAMES)):
                return None
            if hidden_by(top):
                check_hidden(name, path)
                return None
        spec = PathFinder.find_spec(name, path if below else [str(ROOT)])
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = OwnLoader(spec.loader.name, spec.loader.path)
        return spec


def check_hidden(name: str, path: Sequence[str] | None = None) -> None:
    """ModuleNotFoundError if our package is hidden, and it alone has the module `name`.

    Args:
        name: of any module; it is not imported.
        path: where the package that hides ours has its modules; default: its folder.
    """
    top, _, below = name.partition(".")
    hidden = hidden_by(top) if top in NAMES and below else None
    if hidden is None:
        return
    if path is None:
        file, name = Path(hidden), ".".join(name.split(".")[:2])
        path = [hidden] if file.is_dir() else [str(file.parent)] * (file.name == "__init__.py")
    ours = ROOT.joinpath(*name.split("."))
    exists = ours.is_dir() or ours.with_suffix(".py").is_file()
    if exists and PathFinder.find_spec(name, path) is None:
        raise ModuleNotFoundError(
            f"no module {name!r}: {top!r} is {hidden}, which hides the package of Pursuit; import "
            f"pursuit.{name}, or rename yours",
            name=name,
        )


class SecondName(Loader):
    """Loads a module by its other name: both are one module."""

    def __init__(self, other: str) -> None:
        self.other = other

    def exec_module(self, module: ModuleType) -> None:
        """Put the other module in the place of `module`, as Python allows."""
        sys.modules[module.__name__] = import_module(self.other)


class OwnLoader(SourceFileLoader):
    """Executes a module so that its import statements give our packages."""

    def exec_module(self, module: ModuleType) -> None:
        """As its base class."""
        vars(module)["__builtins__"] = {**vars(builtins), "__import__": import_ours}
        super().exec_module(module)


def import_ours(
    name: str,
    globals: Mapping[str, object] | None = None,
    locals: Mapping[str, object] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> ModuleType:
    """`__import__` of our modules."""
    top = name.partition(".")[0]
    if level or top not in NAMES:
        return builtins.__import__(name, globals, locals, fromlist or (), level)
    module = builtins.__import__(f"pursuit.{name}", globals, locals, fromlist or ())
    return module if fromlist else sys.modules[f"pursuit.{top}"]


def install() -> None:
    """Make Python ask `Finder` first."""
    if not any(getattr(each, "__module__", "") == __name__ for each in sys.meta_path):
        sys.meta_path.insert(0, Finder)
