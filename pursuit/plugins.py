"""Registries of parts: built-in ones by name, custom ones by `package.module:Name` or entry point.

A *part* is a reward scheme or function, an observation, a network, a policy, an axis, a curriculum
or an algorithm; each kind has one `Registry`. A name given in Python or on the command line is
trusted, and its module is imported. A name in a *file* is not trusted: while the content of a file
is used (`reading`), a name is imported only if its module is allowed (by `allow`, the option
--allow, or the environment variable PURSUIT_ALLOW).
"""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Generic, TypeVar

from pursuit import siblings
from pursuit.validation import did_you_mean, raised, shortened, unknown

Part = TypeVar("Part")

ALLOW, LOOK_IN = "PURSUIT_ALLOW", "PURSUIT_LOOK_IN"
"""Environment variables: the modules that files may name (comma-separated), and their folders."""

OPENSPIEL = "openspiel:"
"""Prefix of the names of OpenSpiel's games, which name no module."""

_NAME = r"[^\W\d]\w*"
_REFERENCE = re.compile(rf"({_NAME}(?:\.{_NAME})*):({_NAME})")
_allowed: set[str] = set()
_folders: list[str] = []
_named: set[str] = set()
"""References that the user of this process has given; files may name them, too."""
_files: list[str] = []
"""The files whose content is used, the latest last."""


def is_reference(name: object) -> bool:
    """Whether a name is of the form `package.module:Name`."""
    return isinstance(name, str) and _REFERENCE.fullmatch(name) is not None


def module_of(reference: str) -> str:
    """The module of `package.module:Name`."""
    return reference.partition(":")[0]


# -- trust -----------------------------------------------------------------------------------------


def allow(*modules: str) -> None:
    """Allow files to name parts of these modules and of their submodules, in this process.

    Raises:
        ValueError: an invalid name of a module.
    """
    for module in modules:
        if not isinstance(module, str) or not re.fullmatch(rf"{_NAME}(\.{_NAME})*", module):
            raise ValueError(f"allow {module!r}; give the name of a module, such as my_parts")
    _allowed.update(modules)


def allowed() -> tuple[str, ...]:
    """The modules that files may name, from `allow` and PURSUIT_ALLOW."""
    given = {name.strip() for name in os.environ.get(ALLOW, "").split(",")} - {""}
    return tuple(sorted(_allowed | given))


class _NotAllowed(Exception):
    """A file names code that is not allowed. It is no ValueError until it leaves `reading`, so that
    no reader takes it for a wrong value."""


@contextmanager
def reading(where: object, given: Sequence[str] = ()) -> Iterator[None]:
    """While the content of a file is used, names are imported only if they are allowed.

    Args:
        where: the file, for the message.
        given: texts of the user (such as the arguments of a command); what they name is allowed.

    Raises:
        ValueError: the file names `package.module:Name` of a module that is not allowed.
    """
    for text in given:
        _named.update(found[0] for found in _REFERENCE.finditer(text))
    _files.append(str(where))
    try:
        yield
    except _NotAllowed as error:
        raise ValueError(str(error)) from None
    finally:
        _files.pop()


def check_allowed(name: str) -> None:
    """Raise an error, a ValueError outside of `reading`, if a file is read and the module of
    `package.module:Name` is not allowed; other names are not checked."""
    known = tuple(f"{module}." for module in allowed())
    if not _files or not is_reference(name) or name in {*_named, *allowed()}:
        return
    if f"{module_of(name)}.".startswith(known):
        return
    top = module_of(name).partition(".")[0]
    raise _NotAllowed(
        f"{_files[-1]}: names {name!r}, code that is not part of Pursuit; if you trust it, add "
        f"--allow {top} (in Python pursuit.allow({top!r}), or {ALLOW}={top})"
    )


# -- functions of train ----------------------------------------------------------------------------


def from_train(name: str) -> Any:
    """Import the object `name` ("package.module:name") of `train`.

    `train` imports this package. The name is a string to avoid a circular import.

    Raises:
        ImportError: a dependency of `train` is not installed.
    """
    try:
        return resolve_name(f"pursuit.{name}")
    except ModuleNotFoundError as error:
        raise ImportError(
            f"{name} needs {error.name}, which is not installed; install Pursuit with the "
            "dependencies of training: pip install ."
        ) from error


# -- search path of modules ------------------------------------------------------------------------


def look_in(folder: Path | str) -> None:
    """Append `folder` to the search path of custom modules; earlier folders take precedence."""
    path = str(Path(folder).resolve())
    if path not in _folders:
        _folders.append(path)


def _custom_folders() -> list[str]:
    """The folders of `look_in` and PURSUIT_LOOK_IN."""
    return [*_folders, *filter(None, os.environ.get(LOOK_IN, "").split(os.pathsep))]


def _search_path() -> list[str]:
    """The folders with custom modules."""
    return list(dict.fromkeys([*(p or os.getcwd() for p in sys.path), *_custom_folders()]))


def environment() -> dict[str, str]:
    """Environment variables that pass the allowed modules and their folders to a subprocess."""
    sources = (source_of(module_of(name)) for name in sorted(_named))
    homes = [str(found[0]) for found in sources if found and "site-packages" not in found[0].parts]
    folders = dict.fromkeys([*_custom_folders(), *homes])
    tops = tuple(f"{module}." for module in allowed())
    own = (name for name in sorted(_named) if not f"{module_of(name)}.".startswith(tops))
    return {ALLOW: ",".join([*allowed(), *own]), LOOK_IN: os.pathsep.join(folders)}


def source_of(module: str) -> tuple[Path, list[Path]] | None:
    """Find the source files of a custom module without importing it.

    Returns:
        The folder that contains the module, and its files: one for a single module, or every .py
        file of its package. None if there is no source.
    """
    top = module.partition(".")[0]
    loaded = getattr(sys.modules.get(top), "__file__", None)
    if top == "__main__" or loaded is None:
        spec = PathFinder.find_spec(top, _search_path()) if top != "__main__" else None
        if spec is not None:  # of a namespace package (without `__init__.py`) its first folder
            loaded = spec.origin or next(iter(spec.submodule_search_locations or ()), None)
    if loaded is None:
        return None
    path = Path(loaded).resolve()
    if path.is_dir() or path.name == "__init__.py":
        package = path if path.is_dir() else path.parent
        return package.parent, sorted(package.rglob("*.py"))
    return (path.parent, [path]) if path.is_file() else None


def sha256_of(module: str) -> str | None:
    """The SHA-256 of a module's source file, or of its package; None without source.

    For a package the digest covers the paths and contents of all its files.
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


def accepts(function: Callable[..., object], *arguments: object, **named: object) -> bool:
    """Whether a function can be called with these arguments; True if its signature is unknown."""
    try:
        inspect.signature(function).bind(*arguments, **named)
    except TypeError:
        return False
    except ValueError:  # some functions written in C
        return True
    return True


@cache
def installed(group: str) -> Mapping[str, str]:
    """The entry points of a group in installed packages: `module:Name` by name."""
    return {point.name: point.value for point in entry_points(group=group)}


class Registry(Generic[Part]):
    """The parts of one kind by name.

    Args:
        kind: the kind, for messages. `pursuit.<plural>` is its group of entry points.
        needs: description of a valid object, for messages.
        fits: returns whether an object is of this kind.
        plural: plural of `kind`; default: with "s".
        ours: names of built-in parts that are not registered.
        renamed: the new names of built-in parts by their former ones, for messages.
    """

    def __init__(
        self,
        kind: str,
        needs: str,
        fits: Callable[[Any], bool],
        plural: str | None = None,
        ours: Sequence[str] = (),
        renamed: Mapping[str, str] | None = None,
    ) -> None:
        self.kind, self.needs, self._fits = kind, needs, fits
        self._renamed = dict(renamed or {})
        self.group, self._ours = f"pursuit.{plural or kind + 's'}", tuple(ours)
        self._parts: dict[str, Part] = {}
        self._origins: dict[str, str] = {}

    def register(self, name: str, part: Part) -> Part:
        """Register a part under a name and return the part.

        Raises:
            ValueError: a name in use or with a colon, or an object of another kind.
        """
        if not isinstance(name, str) or not name or ":" in name:
            raise ValueError(f"{self.kind} {name!r}; give a name without a colon")
        if name in self._parts:
            raise ValueError(f"{self.kind}: {name!r} is already registered; give another name")
        self._parts[name] = self._checked(repr(name), part)
        self._origins[name] = sys._getframe(1).f_globals.get("__name__", "__main__")
        return part

    def remove(self, name: str) -> None:
        """Remove a registered part."""
        del self._parts[name], self._origins[name]

    def names(self) -> tuple[str, ...]:
        """The names of built-in and registered parts and of those in installed packages."""
        return tuple(dict.fromkeys([*self._ours, *self._parts, *installed(self.group)]))

    def get(self, name: object) -> Part:
        """The part with this name; custom parts are imported.

        Raises:
            ValueError: an unknown name, a module that cannot be imported, or an object of another
                kind.
        """
        if not isinstance(name, str):
            raise ValueError(self.unknown(name))
        if name in self._parts:
            return self._parts[name]
        if is_reference(name):
            found = self._checked(repr(name), self._import(name, name))
            _named.add(name)
            return found
        if name in installed(self.group):
            value = installed(self.group)[name]
            return self._checked(f"{name!r} ({value})", self._import(name, value))
        raise ValueError(self.unknown(name))

    def resolved(self, part: Any) -> Part:
        """The part with this name; an object is returned as it is.

        Raises:
            ValueError: as `get`.
        """
        return self.get(part) if isinstance(part, str) else self._checked(repr(part), part)

    def check(self, name: object) -> None:
        """Raise ValueError unless `name` is built-in or `get` finds it."""
        if callable(name):
            own = getattr(name, "__name__", "Name")
            raise ValueError(f"{self.kind}={own}; give its name, 'package.module:{own}'")
        if name not in self._ours:
            self.get(name)

    def origin(self, name: str) -> str | None:
        """The module of a custom part; None for built-in parts and unknown names."""
        if is_reference(name):
            return module_of(name)
        if name in self._ours:
            return None
        module = self._origins.get(name) or module_of(installed(self.group).get(name, ""))
        return None if not module or siblings.is_ours(module) else module

    def unknown(self, name: object) -> str:
        """The error message for an unknown name; for a former one, with the new one."""
        new = self._renamed.get(str(name))
        if new is not None:
            return f"unknown {self.kind} {name!r}; it was renamed, give {new}"
        message = unknown(self.kind, name, self.names())
        return message + "; or a custom one as package.module:Name"

    def _checked(self, label: str, part: Any) -> Part:
        if not self._fits(part):
            raise ValueError(
                f"{self.kind} {label} is {shortened(part)}; it must be {self.needs}"
                if label != repr(part)
                else f"{self.kind}={shortened(part)}; it must be {self.needs}, or a name"
            )
        return part

    def _import(self, name: str, reference: str) -> Any:
        """Import the object of a reference; ValueError (one line) if that fails."""
        if name == reference:  # else it is that of an installed package
            check_allowed(name)
        module_name, _, attribute = reference.partition(":")
        missing = [folder for folder in _search_path() if folder not in sys.path]
        sys.path.extend(missing)  # at the end, and only for custom modules
        used = _files[:]
        try:
            siblings.check_hidden(module_name)
            _files.clear()  # what an allowed module names itself is not from a file
            module = import_module(module_name)
        except (Exception, SystemExit) as error:  # the module may raise anything
            raise ValueError(
                f"{self.kind} {name!r}: module {module_name} cannot be imported "
                f"({raised(error)}); fix it, or add its folder to PYTHONPATH. A file my_file.py is "
                "named my_file:Name"
            ) from error
        finally:
            _files[:] = used
        if not hasattr(module, attribute):
            public = [known for known in dir(module) if not known.startswith("_")]
            top = module_name.partition(".")[0]
            file = f"; it is {module.__file__}" if top in siblings.NAMES else ""
            raise ValueError(
                f"{self.kind} {name!r}: module {module_name} has no {attribute!r}"
                f"{did_you_mean(attribute, public)}{file}"
            )
        return getattr(module, attribute)
