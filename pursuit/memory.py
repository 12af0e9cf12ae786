"""What this machine can hold: sizes beyond it are refused before anything is allocated."""

from __future__ import annotations

import os
from pathlib import Path

MEMINFO = Path("/proc/meminfo")
LIMITS = (
    Path("/sys/fs/cgroup/memory.max"),
    Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"),
)
"""Where Linux keeps the limit of a container, in its second and in its first form."""

ALWAYS_TRIED = 2**26
"""Bytes below which nobody looks."""


def check_memory(what: str, needed: int, remedy: str) -> None:
    """Refuse what needs more memory than is free.

    Args:
        what: needs it, for the message.
        needed: bytes.
        remedy: what to do about it.

    Raises:
        ValueError: naming the bytes needed and those that are free.
    """
    if needed < ALWAYS_TRIED:
        return
    free = free_memory()
    if needed > free:
        raise ValueError(
            f"{what} needs {needed:,} bytes of memory, and {free:,} are free here; {remedy}"
        )


def free_memory() -> int:
    """The bytes that a process may still use: what Linux calls available, or a container's limit.

    Where neither is known, all of the machine's.
    """
    found = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for line in _text_of(MEMINFO).splitlines():
        if line.startswith("MemAvailable:"):
            found.append(1024 * int(line.split()[1]))
    for limit in LIMITS:
        text = _text_of(limit).strip()
        if text.isdigit():
            found.append(int(text))
    return min(found)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""
