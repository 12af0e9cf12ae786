"""Animations of games as GIF and MP4 files."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pursuit.files import write_atomically
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
    Scene,
)


def save_animation(
    path: str | Path, scenes: Iterable[Drawable], fps: float = 5, size: int = 480
) -> None:
    """Write the scenes as an animated GIF or as an MP4, by the suffix of `path`.

    The last frame is shown for 1.5 seconds. GIFs repeat endlessly, and equal consecutive scenes
    become one longer frame. The file is written atomically: a failure leaves an existing file
    unchanged.

    Args:
        path: ends in `.gif` or `.mp4`.
        scenes: at least one, all of mazes of the same height and width, of graphs, or of arms.
        fps: frames per second; at most 50 for a GIF.
        size: as for `Scene.draw`.

    Raises:
        ValueError: another suffix; no scenes; pictures of different sizes; `fps` not above 0.
        ImportError: `path` is an MP4 and imageio-ffmpeg is not installed.
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
        raise ValueError(f"fps={fps}; give more than 0 frames per second")
    in_color = (scene.picture(size) for scene in scenes)
    frames = _checked(path, _indexed(scenes, size) if suffix == ".gif" else in_color)
    write_atomically(path, lambda partial: writers[suffix](partial, frames, fps))


def _checked(path: Path, frames: Iterable[Image.Image]) -> Iterator[Image.Image]:
    expected: tuple[int, int] | None = None
    for frame in frames:
        if expected is not None and frame.size != expected:
            raise ValueError(
                f"{path}: a picture of {frame.width}x{frame.height} after pictures of "
                f"{expected[0]}x{expected[1]}; give scenes of mazes of the same height and width"
            )
        expected = frame.size
        yield frame
    if expected is None:
        raise ValueError(f"{path}: no scenes; an animation needs at least one")


@lru_cache(maxsize=1)
def _palette() -> Image.Image:
    """An image with a palette of all colours of the pictures, and four blends of every two.

    One palette for all frames keeps a GIF small and free of dithering noise.
    """
    colors = [WHITE, OPENING, WALL, BLOCKED, HATCH, CAPTURED, CAPTURED_LINE, *ROLE_COLORS.values()]
    basis = np.array(colors)
    entries = [*basis]
    for first, second in combinations(basis, 2):
        for blend in (first + (second - first) * i // 5 for i in range(1, 5)):
            # Pillow rounds colours to multiples of 4, so a similar blend would replace a colour.
            if (abs(basis - blend).max(axis=1) >= 12).all():
                entries.append(blend)
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.array(entries, dtype=np.uint8).tobytes())
    return palette


def _indexed(scenes: Iterable[Drawable], size: int) -> Iterator[Image.Image]:
    """The pictures as indices of `_palette`. Those of mazes are kept and get new footers, as agents
    that walk in circles play long episodes of few pictures."""

    def indexed(image: Image.Image) -> Image.Image:
        return image.quantize(palette=_palette(), dither=Image.Dither.NONE)

    @lru_cache(maxsize=256)
    def kept(scene: Scene) -> Image.Image:
        return indexed(scene.picture(size))

    for scene in scenes:
        if type(scene) is Scene:  # other kinds may show steps elsewhere
            image, footer = kept(replace(scene, steps=0, caption="")).copy(), scene.strip(size)
            image.paste(indexed(footer), (0, image.height - footer.height))
            yield image
        else:
            yield indexed(scene.picture(size))


def _write_gif(path: Path, frames: Iterator[Image.Image], fps: float) -> None:
    images = list(frames)
    milliseconds = max(20, round(1000 / fps))
    durations = [milliseconds] * (len(images) - 1) + [max(1500, milliseconds)]

    # Pillow's optimisation takes ten times as long, and saves a kilobyte per frame.
    options: dict[str, Any] = {"save_all": True, "append_images": images[1:], "optimize": False}
    images[0].save(path, format="GIF", duration=durations, loop=0, **options)


def _write_mp4(path: Path, frames: Iterator[Image.Image], fps: float) -> None:
    try:
        ffmpeg = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ImportError(
            "an MP4 file needs imageio-ffmpeg: pip install 'pursuit[render]', or write a .gif"
        ) from None
    last = next(frames)
    options = {"macro_block_size": 2, "quality": 8, "output_params": ["-f", "mp4"]}
    writer = ffmpeg.write_frames(str(path), last.size, fps=fps, **options)
    writer.send(None)
    try:
        for frame in chain([last], frames):
            writer.send((last := frame).tobytes())
        for _ in range(math.ceil(1.5 * fps) - 1):
            writer.send(last.tobytes())
    finally:
        writer.close()
