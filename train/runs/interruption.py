"""Signals and divergence, which end training early."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator
from threading import current_thread, main_thread
from types import FrameType
from typing import Any, Self


class Stopped(KeyboardInterrupt):
    """A signal that ends the work: a run has saved what it learned.

    Like `KeyboardInterrupt`, `except Exception` does not catch it, so that a loop over runs ends.

    Attributes:
        status: the exit status for the signal: 130 for Ctrl-C, 143 for SIGTERM.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.status = 128 + number


class Diverged(ArithmeticError):
    """Training has led to values that are not finite."""


class Signals:
    """A context in which Ctrl-C and SIGTERM raise `Stopped`, at once or after a `held` part.

    Attributes:
        status: the exit status for the last signal; 0 before the first one.
        count: the number of signals.
    """

    def __init__(self) -> None:
        self.status, self.count = 0, 0
        self._holds: str | None = None
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if current_thread() is main_thread():  # Python handles signals in this thread only
            for number in (int(signal.SIGINT), int(signal.SIGTERM)):
                self._previous[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @contextlib.contextmanager
    def held(self, message: str = "") -> Iterator[None]:
        """A part that the first signal does not end: `Stopped` is raised after it.

        Args:
            message: printed to stderr at the signal, unless it is empty.
        """
        self._holds = message
        try:
            yield
        finally:
            self._holds = None
        if self.count:
            raise Stopped(self.status - 128)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.status, self.count = 128 + number, self.count + 1
        if self.count > 1 or self._holds is None:
            raise Stopped(number)
        if self._holds:
            print(f"\n{self._holds}", file=sys.stderr, flush=True)
