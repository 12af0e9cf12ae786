"""Calls with wrong values: each must be refused by a ValueError of one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

NUMBER = (None, "1", [], {}, float("nan"), float("inf"), 10**400, 1j)
WHOLE = (None, "1", 1.5, [], {}, True, -(2**70), 2**70, float("nan"))
FLAG = (None, 1, "yes", [])
TEXT = (None, 5, [], {}, "nonsense")
MAZES = (None, 5, 1.5, {}, "nonsense", b"3x3")
CELLS = (None, "ab", 1.5, {0: "a", "b": 1}, [1.5], ["a"], [99], [-5], [[0], [1, 2]], [None])
ARRAY = (None, "ab", {}, [[0], [1, 2]], 1j, [None])

Call = tuple[Callable[..., Any], dict[str, Any], dict[str, tuple[Any, ...]]]
"""A function, arguments that it takes, and wrong values of each of them."""


def faults_of(calls: Iterable[Call]) -> tuple[list[str], int]:
    """The wrong values that are taken, or that raise something else, and how many were tried."""
    faults, count = [], 0
    for function, given, wrong in calls:
        name = getattr(function, "__qualname__", str(function))
        function(**given)
        for argument, values in wrong.items():
            for value in values:
                count += 1
                try:
                    function(**{**given, argument: value})
                except ValueError as error:
                    if "\n" in str(error):
                        faults.append(f"{name}({argument}={value!r}): several lines: {error}")
                except Exception as error:
                    faults.append(f"{name}({argument}={value!r}): {error!r}")
                else:
                    faults.append(f"{name}({argument}={value!r}): taken")
        try:
            function(**given, no_such_keyword=1)
        except TypeError as error:
            if "unexpected keyword argument" in str(error):
                continue
        faults.append(f"{name}(no_such_keyword=1): no TypeError")
    return faults, count
