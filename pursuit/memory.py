"""What this machine can hold: sizes beyond it are refused before anything is allocated."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

MEMINFO = Path("/proc/meminfo")
LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Where Linux keeps the limit of a container, in its second and in its first form."""
USED = ("memory.current", "memory.usage_in_bytes")
"""What lies beside each of them: the bytes that the container has taken."""


def check_memory(what: str, needed: int, remedy: str, most: int | None = None) -> None:
    """Refuse what needs more memory than is free.

    Args:
        what: needs it, for the message.
        needed: bytes.
        remedy: what to do about it.
        most: a bound of its own, in bytes, whatever the machine has.

    Raises:
        ValueError: naming the bytes needed, and those that are free or that `most` allows.
    """
    if most is not None and needed > most:
        raise ValueError(
            f"{what} needs {needed:,} bytes of memory; {most:,} are the most that is used; {remedy}"
        )
    free = free_memory()
    if needed > free:
        raise ValueError(
            f"{what} needs {needed:,} bytes of memory, and {free:,} are free here; {remedy}"
        )


def free_memory() -> int:
    """The bytes that can still be had: what Linux calls available, within a container's limit.

    Where neither is known, all of the machine's.
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
