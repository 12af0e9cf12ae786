"""Signals and divergence, which end training early."""

from __future__ import annotations

import signal
from threading import current_thread, main_thread
from types import FrameType
from typing import Any, Self


class Stopped(KeyboardInterrupt):
    """A signal that ends the work at once.

    Attributes:
        status: the exit status for the signal: 130 for Ctrl-C, 143 for SIGTERM.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__()
        self.status = 128 + number


class Diverged(ArithmeticError):
    """Training has led to values that are not finite."""


class Signals:
    """A context in which Ctrl-C and SIGTERM raise `Stopped`.

    Args:
        patient: whether the first signal only sets `asked`.

    Attributes:
        status: the exit status for the last signal; 0 before the first one.
        asked: whether there was a signal.
    """

    def __init__(self, patient: bool = False) -> None:
        self.status, self.asked, self.patient = 0, False, patient
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if current_thread() is main_thread():  # Python handles signals in this thread only
            for number in (int(signal.SIGINT), int(signal.SIGTERM)):
                self._previous[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.status = 128 + number
        if self.asked or not self.patient:
            raise Stopped(number)
        self.asked = True
