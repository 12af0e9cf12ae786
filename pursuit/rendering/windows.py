"""Rendering of environments: text, images, or a window."""

from __future__ import annotations

import importlib
import os
from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pursuit.rendering.rendering import Drawable
from pursuit.validation import unknown

RENDER_MODES = ("ansi", "rgb_array", "human")


def metadata_of(fps: int, **more: Any) -> dict[str, Any]:
    """The `metadata` of environments of one game, and of the functions that make them."""
    return {"render_modes": list(RENDER_MODES), "render_fps": fps, **more}


class Rendered(ABC):
    """Implements `render` and `close` for environments of one game; subclasses define `_scene`."""

    metadata: dict[str, Any]
    render_mode: str | None
    _window: Window | None = None

    def _render_as(self, render_mode: str | None, fps: int, **metadata: Any) -> None:
        """Set the render mode and the metadata; ValueError for an unknown mode."""
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ValueError(unknown("render_mode", render_mode, RENDER_MODES, "None or one of"))
        self.render_mode = render_mode
        self.metadata = metadata_of(fps, **metadata)

    @abstractmethod
    def _scene(self) -> Drawable:
        """The current scene."""

    def _show(self) -> None:
        """Update the window after a reset or a step."""
        if self.render_mode == "human":
            self.render()

    def render(self) -> str | NDArray[np.uint8] | None:
        """Text ("ansi"), an image [height, width, 3] uint8 ("rgb_array"), or None ("human")."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() without a render_mode; give one to the environment")
            return None
        if self.render_mode == "ansi":
            return self._scene().text()
        if self.render_mode == "rgb_array":
            return self._scene().draw()
        self._window = self._window or Window()
        self._window.show(self._scene(), self.metadata["render_fps"])
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None


class Window:
    """A window that shows scenes. After it is closed by its button, scenes are ignored.

    Raises:
        ImportError: pygame-ce is not installed.
    """

    def __init__(self) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            self._pygame = importlib.import_module("pygame")
        except ImportError:
            raise ImportError("a window needs pygame-ce: pip install 'pursuit[render]'") from None
        self._pygame.display.init()
        self._pygame.display.set_caption("pursuit")
        self._clock = self._pygame.time.Clock()
        self.is_open = True

    def show(self, scene: Drawable, fps: float = 5) -> None:
        """Draw the scene; wait so that at most `fps` scenes are shown per second (0: no wait)."""
        if not self.is_open:
            return
        display = self._pygame.display
        pixels = scene.draw().swapaxes(0, 1)
        surface = display.get_surface()
        if surface is None or surface.get_size() != pixels.shape[:2]:
            surface = display.set_mode(pixels.shape[:2])
        self._pygame.surfarray.blit_array(surface, pixels)
        display.flip()
        self._clock.tick(fps)
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()

    def close(self) -> None:
        """Close the window; further calls have no effect."""
        if self.is_open:
            self.is_open = False
            self._pygame.display.quit()
