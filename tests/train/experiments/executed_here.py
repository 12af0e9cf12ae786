"""Runs of studies in the process of the test, where processes are not what is tested."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from train.experiments import executors


class JobHere:
    """A job that is executed when it is made."""

    def __init__(self, folder: Path, core: int | None) -> None:
        self.code = executors.perform_here(str(folder), {})

    def poll(self) -> int:
        return self.code

    def stop(self) -> None:
        pass


@contextmanager
def executed_here() -> Iterator[None]:
    """Local runs are executed in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executors, "LocalJob", JobHere)
        yield
