"""Agents without learning: heuristics and exact solvers.

The names that `__init__.pyi` lists, and modules, are imported on first use.
"""

import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from typing import Any

import lazy_loader

from pursuit.siblings import SecondName

_named, _, __all__ = lazy_loader.attach_stub(__name__, __file__)
_former = {each.name for each in pkgutil.iter_modules([f"{__path__[0]}/exact"])}
_modules = _former | {each.name for each in pkgutil.iter_modules(__path__)}


def __getattr__(name: str) -> Any:
    return import_module(f"{__name__}.{name}") if name in _modules else _named(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_modules})


class FormerNames:
    """Finds the modules of `exact` under their former names, without it; both are one module."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, _: Any = None) -> ModuleSpec | None:
        """How to load a module with a former name; None for others."""
        inside = name.removeprefix(f"{__name__}.")
        if inside == name or inside.partition(".")[0] not in _former:
            return None
        return ModuleSpec(name, SecondName(f"{__name__}.exact.{inside}"))


sys.meta_path.insert(0, FormerNames)
