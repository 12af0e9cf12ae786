"""Animations of a game, of any world: GIF and MP4."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import chain, combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pursuit.files import write_beside
from pursuit.rendering.rendering import (
    BLOCKED,
    CAPTURED,
    CAPTURED_LINE,
    HATCH,
    OPENING,
    ROLE_COLORS,
    WALL,
    WHITE,
    Drawable,
)


def save_animation(
    path: str | Path, scenes: Iterable[Drawable], fps: float = 5, size: int = 480
) -> None:
    """Write the scenes as an animated GIF or as an MP4, by the suffix of `path`.

    The last frame stays for a second and a half. A GIF loops forever; equal scenes in a row become
    one longer frame. The file is written beside `path` and renamed, so that a failure, in writing
    or in making the scenes, leaves what was there.

    Args:
        path: ends in `.gif` or `.mp4`.
        scenes: at least one, of mazes of one height and width, or of arms.
        fps: frames a second; a GIF has at most 50.
        size: as for `draw_scene`.

    Raises:
        ValueError: another suffix; no scenes; pictures of different sizes; `fps` not above 0.
        ImportError: an MP4 is wanted and imageio-ffmpeg is not installed.
        OSError: the file cannot be written.
    """
    path = Path(path)
    writers = {".gif": _write_gif, ".mp4": _write_mp4}
    suffix = path.suffix.lower()
    if suffix not in writers:
        raise ValueError(
            f"{path}: suffix {path.suffix!r}; an animation is a .gif or .mp4 file: rename it"
        )
    if not fps > 0:
        raise ValueError(f"fps={fps}; an animation needs more than 0 frames a second")
    frames = _frames(path, scenes, size)
    write_beside(path, lambda beside: writers[suffix](beside, frames, fps))


def _frames(path: Path, scenes: Iterable[Drawable], size: int) -> Iterator[NDArray[np.uint8]]:
    shape: tuple[int, ...] | None = None
    for scene in scenes:
        frame = scene.draw(size)
        if shape is not None and frame.shape != shape:
            raise ValueError(
                f"{path}: a picture of {frame.shape[1]}x{frame.shape[0]} after pictures of "
                f"{shape[1]}x{shape[0]}; animate mazes of one height and width"
            )
        shape = frame.shape
        yield frame
    if shape is None:
        raise ValueError(f"{path}: no scenes; an animation needs at least one")


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    """An image with every colour of the pictures, and four blends between any two, as palette.

    One palette for all frames keeps a GIF small and free of dithering noise.
    """
    colors = [WHITE, OPENING, WALL, BLOCKED, HATCH, CAPTURED, CAPTURED_LINE, *ROLE_COLORS.values()]
    basis = np.array(colors)
    entries = [*basis]
    for first, second in combinations(basis, 2):
        for blend in (first + (second - first) * i // 5 for i in range(1, 5)):
            # Pillow rounds colours to multiples of 4: what lies next to a colour would replace it.
            if (abs(basis - blend).max(axis=1) >= 12).all():
                entries.append(blend)
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.array(entries, dtype=np.uint8).tobytes())
    return palette


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    images = [
        Image.fromarray(frame).quantize(palette=_palette(), dither=Image.Dither.NONE)
        for frame in frames
    ]
    milliseconds = max(20, round(1000 / fps))
    durations = [milliseconds] * (len(images) - 1) + [max(1500, milliseconds)]
    rest = images[1:]
    images[0].save(
        path, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0
    )


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], fps: float) -> None:
    try:
        ffmpeg = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ImportError(
            f"{path.suffix} needs imageio-ffmpeg: pip install 'pursuit[render]', or write a .gif"
        ) from None
    last = next(frames)
    height, width, _ = last.shape
    how = {"macro_block_size": 2, "quality": 8, "output_params": ["-f", "mp4"]}
    writer = ffmpeg.write_frames(str(path), (width, height), fps=fps, **how)
    writer.send(None)
    try:
        for frame in chain([last], frames):
            writer.send(last := frame)
        for _ in range(math.ceil(1.5 * fps) - 1):
            writer.send(last)
    finally:
        writer.close()
