"""Checks of the available memory, made before large arrays are allocated."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

MEMINFO = Path("/proc/meminfo")
LIMITS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))
"""Files with the memory limit of a container: cgroup v2 and v1."""
USED = ("memory.current", "memory.usage_in_bytes")
"""Files in the same folders with the memory in use, in bytes."""

SMALL = 2**26
"""Fewer bytes are always tried: containers can report for a moment that no memory is free."""


def check_memory(what: str, needed: int, remedy: str, most: int | None = None) -> None:
    """Raise ValueError if more memory is needed than is available.

    Args:
        what: description of the object, for the message.
        needed: bytes that it needs.
        remedy: advice to the user, for the message.
        most: an additional upper bound in bytes, independent of the machine.

    Raises:
        ValueError: with the bytes that are needed and the bytes that are available.
    """
    if most is not None and needed > most:
        raise ValueError(
            f"{what} needs {needed:,} bytes of memory; the limit is {most:,}; {remedy}"
        )
    free = free_memory()
    if needed > max(free, SMALL):
        raise ValueError(
            f"{what} needs {needed:,} bytes of memory, and {free:,} are free here; {remedy}"
        )


def free_memory() -> int:
    """Available memory in bytes: MemAvailable of Linux, within the limit of the container.

    If neither is known, the total memory of the machine.
    """
    found = []
    with contextlib.suppress(ValueError, OSError, AttributeError):  # systems without sysconf
        found.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for line in _text_of(MEMINFO).splitlines():
        if line.startswith("MemAvailable:"):
            found.append(1024 * int(line.split()[1]))
    for limit, used in zip(LIMITS, USED, strict=True):
        most, taken = _text_of(limit).strip(), _text_of(limit.with_name(used)).strip()
        if most.isdigit():
            found.append(int(most) - (int(taken) if taken.isdigit() else 0))
    return max(min(found, default=2**63 - 1), 0)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
