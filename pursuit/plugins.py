"""The one door for parts: ours by name, a user's by `package.module:Name` or as an entry point.

A *part* is a reward scheme or function, an observation, a network, a policy, an axis, a curriculum
or an algorithm; each kind has one `Registry`. Whoever writes a name himself (in Python, or as an
option) has its module imported. What a *file* names was written by who knows whom: `check_trusted`
refuses it before anything is imported, unless the user has allowed that module by name (`allow`,
the option --allow, or the environment variable PURSUIT_ALLOW).
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Generic, TypeVar

Part = TypeVar("Part")

ALLOW, LOOK_IN = "PURSUIT_ALLOW", "PURSUIT_LOOK_IN"
"""Environment variables: modules that files may name, with commas; folders to find them in."""
OURS = ("pursuit", "scripted_agents", "curricula", "train")

_NAME = r"[^\W\d]\w*"
_REFERENCE = re.compile(rf"({_NAME}(?:\.{_NAME})*):({_NAME})")
_allowed: set[str] = set()
_folders: list[str] = []
_resolved: set[str] = set()
"""Names that the user's own doing has resolved: a file that says them again runs nothing new."""


def is_reference(name: object) -> bool:
    """Whether a name is of the form `package.module:Name`."""
    return isinstance(name, str) and _REFERENCE.fullmatch(name) is not None


def module_of(reference: str) -> str:
    """The module of `package.module:Name`."""
    return reference.partition(":")[0]


# -- trust -----------------------------------------------------------------------------------------


def allow(*modules: str) -> None:
    """Let files name parts of these modules, and of whatever is inside them, in this process.

    Raises:
        ValueError: something that is no module's name.
    """
    for module in modules:
        if not isinstance(module, str) or not re.fullmatch(rf"{_NAME}(\.{_NAME})*", module):
            raise ValueError(f"allow {module!r}; give the name of a module, such as my_parts")
    _allowed.update(modules)


def allowed() -> tuple[str, ...]:
    """The modules that files may name: those of `allow` and of PURSUIT_ALLOW."""
    given = {name.strip() for name in os.environ.get(ALLOW, "").split(",")} - {""}
    return tuple(sorted(_allowed | given))


def check_trusted(where: object, content: Any) -> None:
    """Refuse what a file names, in any of its values, unless it is allowed; nothing is imported.

    Args:
        where: the file, as messages name it.
        content: plain values read from it.

    Raises:
        ValueError: a `package.module:Name` of a module that is not allowed.
    """
    for name in references(content):
        module = module_of(name)
        inside = any(module == known or module.startswith(f"{known}.") for known in allowed())
        if not inside and name not in _resolved:
            top = module.partition(".")[0]
            raise ValueError(
                f"{where}: names {name!r}, code that is not Pursuit's own; if you trust it, add "
                f"--allow {top} (in Python pursuit.allow({top!r}), or {ALLOW}={top})"
            )


def references(content: Any) -> Iterator[str]:
    """Every `package.module:Name` among plain values, however deep."""
    if is_reference(content):
        yield content
    elif isinstance(content, Mapping):
        for name, value in content.items():
            yield from references(name)
            yield from references(value)
    elif isinstance(content, list | tuple):
        for value in content:
            yield from references(value)


# -- what train has --------------------------------------------------------------------------------


def from_train(name: str) -> Any:
    """The object `name` ("package.module:name") of `train`, imported now.

    `train` builds on this package, so nothing below it imports it. What is reached from here is
    named by a text, as the entry points of Gymnasium's ids are.

    Raises:
        ImportError: a package that `train` needs is not installed.
    """
    try:
        return resolve_name(name)
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{name} needs {error.name}, which is not installed; install Pursuit with what its "
            "learners need: pip install ."
        ) from error


# -- where modules are -----------------------------------------------------------------------------


def look_in(folder: Path | str) -> None:
    """Find users' modules in `folder` too, after everywhere else, so that it hides nothing."""
    path = str(Path(folder).resolve())
    if path not in _folders:
        _folders.append(path)


def _search_path() -> list[str]:
    """Where users' modules are found."""
    given = [folder for folder in os.environ.get(LOOK_IN, "").split(os.pathsep) if folder]
    return list(dict.fromkeys([*(p or os.getcwd() for p in sys.path), *_folders, *given]))


def environment() -> dict[str, str]:
    """The environment variables with which another process finds and trusts what this one does."""
    sources = (source_of(module_of(name)) for name in sorted(_resolved))
    homes = [str(found[0]) for found in sources if found and "site-packages" not in found[0].parts]
    given = [folder for folder in os.environ.get(LOOK_IN, "").split(os.pathsep) if folder]
    folders = dict.fromkeys([*_folders, *given, *homes])
    return {ALLOW: ",".join(allowed()), LOOK_IN: os.pathsep.join(folders)}


def source_of(module: str) -> tuple[Path, list[Path]] | None:
    """The files that a user's module is made of, found without importing it.

    Returns:
        The folder that it is found in, and its files: the one of a module on its own, or every .py
        of the package that it belongs to. None where there is no source.
    """
    top = module.partition(".")[0]
    loaded = getattr(sys.modules.get(top), "__file__", None)
    if top == "__main__" or loaded is None:
        spec = PathFinder.find_spec(top, _search_path()) if top != "__main__" else None
        loaded = loaded if spec is None else spec.origin or _namespace(spec)
    if loaded is None:
        return None
    path = Path(loaded).resolve()
    if path.is_dir() or path.name == "__init__.py":
        package = path if path.is_dir() else path.parent
        return package.parent, sorted(package.rglob("*.py"))
    return (path.parent, [path]) if path.is_file() else None


def _namespace(spec: Any) -> str | None:
    """The folder of a package without `__init__.py`."""
    return next(iter(spec.submodule_search_locations or ()), None)


def sha256_of(module: str) -> str | None:
    """The SHA-256 of a module's source file, or of all files of its package; None without source.

    Of a package it is that of its files' paths and contents, one after the other.
    """
    found = source_of(module)
    if found is None:
        return None
    root, files = found
    if len(files) == 1 and files[0].parent == root:
        return hashlib.sha256(files[0].read_bytes()).hexdigest()
    whole = hashlib.sha256()
    for path in files:
        content = path.read_bytes()
        whole.update(f"{path.relative_to(root).as_posix()}\0{len(content)}\0".encode() + content)
    return whole.hexdigest()


# -- the registries --------------------------------------------------------------------------------


@cache
def installed(group: str) -> Mapping[str, str]:
    """What installed packages bring to a group of entry points: `module:Name` by name."""
    return {point.name: point.value for point in entry_points(group=group)}


class Registry(Generic[Part]):
    """The parts of one kind by name.

    Args:
        kind: in messages and, as `pursuit.<plural>`, the group of entry points.
        needs: what an object of this kind must be, in words.
        fits: whether an object is of this kind.
        plural: of the kind.
        ours: names that are known before anything is registered.
    """

    def __init__(
        self,
        kind: str,
        needs: str,
        fits: Callable[[Any], bool],
        plural: str | None = None,
        ours: Sequence[str] = (),
    ) -> None:
        self.kind, self.needs, self._fits = kind, needs, fits
        self.group, self._ours = f"pursuit.{plural or kind + 's'}", tuple(ours)
        self._parts: dict[str, Part] = {}
        self._origins: dict[str, str] = {}

    def register(self, name: str, part: Part) -> Part:
        """Take a part in under a name; returns it.

        Raises:
            ValueError: a name that is taken, or written like a reference; no part of this kind.
        """
        if not isinstance(name, str) or not name or ":" in name:
            raise ValueError(f"{self.kind} {name!r}; give it a name without a colon")
        if name in self._parts:
            raise ValueError(f"{self.kind}: one called {name!r} is there already; rename one")
        self._parts[name] = self._checked(repr(name), part)
        self._origins[name] = sys._getframe(1).f_globals.get("__name__", "__main__")
        return part

    def remove(self, name: str) -> None:
        """Forget a part that was registered."""
        del self._parts[name], self._origins[name]

    def names(self) -> tuple[str, ...]:
        """Ours, those that were registered, and those of installed packages."""
        return tuple(dict.fromkeys([*self._ours, *self._parts, *installed(self.group)]))

    def get(self, name: str) -> Part:
        """The part of that name, imported where it is a user's.

        Raises:
            ValueError: an unknown name, a module that cannot be imported, or no part of this kind.
        """
        if name in self._parts:
            return self._parts[name]
        if is_reference(name):
            found = self._checked(repr(name), self._import(name, name))
            _resolved.add(name)
            return found
        if name in installed(self.group):  # by the user
            value = installed(self.group)[name]
            return self._checked(f"{name!r} ({value})", self._import(name, value))
        raise ValueError(self.unknown(name))

    def take(self, given: Any) -> Part:
        """The part of a name, or an object itself.

        Raises:
            ValueError: as `get`.
        """
        return self.get(given) if isinstance(given, str) else self._checked(repr(given), given)

    def check(self, name: object) -> None:
        """ValueError unless `name` is one of ours, or that of a part that `get` finds."""
        if not isinstance(name, str):
            raise ValueError(self.unknown(name))
        if name not in self._ours:
            self.get(name)

    def origin(self, name: str) -> str | None:
        """The module that a user's part comes from; None for ours, and for unknown names."""
        if is_reference(name):
            return module_of(name)
        if name in self._ours:
            return None
        module = self._origins.get(name) or module_of(installed(self.group).get(name, ""))
        return None if not module or module.partition(".")[0] in OURS else module

    def unknown(self, name: object) -> str:
        """What to say of a name that is none."""
        known = self.names()
        close = get_close_matches(str(name), known, 1)
        return (
            f"unknown {self.kind} {name!r}; one of {', '.join(known)}"
            + (f" (did you mean {close[0]!r}?)" if close else "")
            + "; or your own as package.module:Name"
        )

    def _checked(self, told: str, part: Any) -> Part:
        if not self._fits(part):
            shown = " ".join(repr(part).split())[:60]
            raise ValueError(
                f"{self.kind} {told} is {shown}; it must be {self.needs}"
                if told != repr(part)
                else f"{self.kind}={shown}; it must be {self.needs}, or a name"
            )
        kept: Part = part
        return kept

    def _import(self, name: str, reference: str) -> Any:
        """The object that a reference names; ValueError in one line where there is none."""
        module_name, _, attribute = reference.partition(":")
        missing = [folder for folder in _search_path() if folder not in sys.path]
        sys.path.extend(missing)  # at the end, and only once a user's module is asked for
        try:
            module = import_module(module_name)
        except (Exception, SystemExit) as error:  # whatever the user's code raises
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise ValueError(
                f"{self.kind} {name!r}: module {module_name} cannot be imported ({reason}); mend "
                "it, or add its folder to PYTHONPATH"
            ) from error
        if not hasattr(module, attribute):
            public = [known for known in dir(module) if not known.startswith("_")]
            close = get_close_matches(attribute, public, 1)
            raise ValueError(
                f"{self.kind} {name!r}: module {module_name} has no {attribute!r}"
                + (f"; did you mean {close[0]!r}?" if close else "")
            )
        return getattr(module, attribute)
