"""Cases in which every value of several lists appears, instead of all combinations of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


def diagonal(*lists: Iterable[Any]) -> list[tuple[Any, ...]]:
    """As many cases as the longest list has values; shorter lists begin again."""
    rows = [list(values) for values in lists]
    return [
        tuple(row[case % len(row)] for row in rows) for case in range(max(len(row) for row in rows))
    ]
