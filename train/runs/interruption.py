"""Ctrl-C and SIGTERM as a wish to stop, so that what was learned is saved first."""

from __future__ import annotations

import signal
from threading import current_thread, main_thread
from types import FrameType
from typing import Any


class Interruption:
    """While it is entered, the first signal sets `asked`; a second one is a KeyboardInterrupt."""

    def __init__(self) -> None:
        self.asked = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        if current_thread() is main_thread():  # Python handles signals nowhere else
            for number in (int(signal.SIGINT), int(signal.SIGTERM)):
                self._previous[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
