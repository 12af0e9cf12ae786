"""Waiting for what a process started by a test does."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from typing import Any

import pytest

PATIENCE = 600.0
"""Seconds; far more than a slow machine needs on which others work too."""


def wait_until(happened: Callable[[], Any], process: subprocess.Popen[Any] | None = None) -> None:
    """Wait until `happened()` is true; fail if `process` ends before that, with its messages."""
    deadline = time.monotonic() + PATIENCE
    while not happened():
        if process is not None and process.poll() is not None and not happened():
            output, errors = process.communicate()
            pytest.fail(f"it ended with {process.returncode}\n{output}\n{errors}")
        if time.monotonic() > deadline:
            if process is not None:
                process.kill()
            pytest.fail(f"nothing happened in {PATIENCE:.0f} s")
        time.sleep(0.005)
