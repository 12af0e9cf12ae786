"""This machine, the software and the source's commit, for the provenance of results.

Linux has the processor's name and flags in a small file, read here in 0.2 ms. The library
py-cpuinfo 9 supports more systems, but takes 1.2 s and starts processes.
"""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache, partial
from pathlib import Path

import pursuit

CPUINFO = Path("/proc/cpuinfo")


@cache
def _cpuinfo() -> str:
    """Linux's description of the processors; empty on other systems."""
    try:
        return CPUINFO.read_text(encoding="utf-8")
    except OSError:
        return ""


def processor() -> str:
    """The processor's name."""
    for line in _cpuinfo().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def has_fast_bfloat16() -> bool:
    """Whether this processor multiplies bfloat16 matrices in hardware."""
    return "avx512_bf16" in _cpuinfo() or "amx_bf16" in _cpuinfo()


def uses_bfloat16(precision: str, device: str) -> bool:
    """Whether a precision ("auto", "float32", "bfloat16") means bfloat16 on this machine."""
    if precision != "auto":
        return precision == "bfloat16"
    if device.startswith("cuda"):
        import torch  # slow to import

        # Older cards only emulate it, slower than they compute in float32.
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False)
    return has_fast_bfloat16()


def usable_cores() -> list[int]:
    """The cores that this process may use; all of them on systems that do not say which."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


@cache
def commit() -> str | None:
    """The commit of the running source, with "+" if it has been changed; None if unknown."""
    here = Path(__file__).parent
    git = ["git", "-C", str(here)]
    run = partial(subprocess.run, capture_output=True, text=True)
    try:
        found = run([*git, "rev-parse", "HEAD"])
        changed = run([*git, "status", "--porcelain", "--", ":/", ":(top,exclude)runs"])
    except OSError:
        return None
    name = found.stdout.strip()
    if found.returncode or "site-packages" in here.parts:
        return None
    return name + ("+" if changed.stdout.strip() else "")


def versions() -> dict[str, str | None]:
    """The versions of the software."""
    import torch  # slow to import

    return {
        "pursuit": pursuit.__version__,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "commit": commit(),
    }


def machine() -> dict[str, str | int | None]:
    """The machine and its threads."""
    import torch  # slow to import

    return {"processor": processor(), "cores": os.cpu_count(), "threads": torch.get_num_threads()}
