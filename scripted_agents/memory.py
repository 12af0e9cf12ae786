"""How much memory there is, and the refusal of what would need more."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

MEMORY_INFO = Path("/proc/meminfo")
GROUP_LIMIT, GROUP_USED = (Path("/sys/fs/cgroup") / f"memory.{n}" for n in ("max", "current"))


def available_bytes() -> int | None:
    """Bytes of memory that can be had now, within the limit of a container; None if unknown."""
    found = []
    try:
        lines = MEMORY_INFO.read_text().splitlines()
        free = {line.split()[0]: int(line.split()[1]) for line in lines if len(line.split()) > 1}
        found.append(1024 * free["MemAvailable:"])
    except (OSError, KeyError, ValueError):  # no Linux
        names = getattr(os, "sysconf_names", {})
        if "SC_PHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
            found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    with contextlib.suppress(OSError, ValueError):  # no container, or one without a limit
        found.append(int(GROUP_LIMIT.read_text()) - int(GROUP_USED.read_text()))
    return max(min(found), 0) if found else None


def check_memory(needed: int, what: str, remedy: str, most: int | None = None) -> None:
    """Raise before anything is computed that would not fit.

    Args:
        needed: bytes.
        what: needs them, for the message.
        remedy: what to do instead.
        most: a bound of its own, in bytes, whatever the machine has.

    Raises:
        ValueError: `needed` is above `most`, or above what is available now.
    """
    available = available_bytes()
    allowed = min(limit for limit in (most, available, needed) if limit is not None)
    if needed > allowed:
        whose = "available here" if allowed == available else "the most that is used"
        raise ValueError(
            f"{what}: needs {needed:,} bytes ({needed / 1e9:.3g} GB) of memory; {allowed:,} bytes "
            f"({allowed / 1e9:.3g} GB) are {whose}. {remedy}"
        )
