"""Opening pages in a web browser, if one is available."""

from __future__ import annotations

import os
import sys
import webbrowser


def has_screen() -> bool:
    """Whether a graphical browser can be shown; text browsers would block the terminal."""
    if sys.platform in ("win32", "darwin"):
        return "SSH_CONNECTION" not in os.environ
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_page(address: str) -> bool:
    """Open an address in the user's browser; False if there is none."""
    try:
        return has_screen() and webbrowser.open(address)
    except webbrowser.Error:
        return False
