"""A browser, where there is one: for a page that a command has made."""

from __future__ import annotations

import os
import sys
import webbrowser


def has_screen() -> bool:
    """Whether a browser could show anything: a text browser would only take the terminal."""
    if sys.platform in ("win32", "darwin"):
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_page(address: str) -> bool:
    """Open an address in the person's browser; False where there is none."""
    try:
        return has_screen() and webbrowser.open(address)
    except webbrowser.Error:
        return False
