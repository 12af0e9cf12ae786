"""Atomic writing of files: a failure leaves the existing file unchanged."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary path in the same folder, then rename that file to `path`.

    For a symbolic link the file that it names is written, even if that does not exist yet.

    Raises:
        ValueError: `path` is a folder or a device, which renaming would replace.
        OSError: the file cannot be written; the error names `path`.
    """
    real = Path(os.path.realpath(path))
    if real.is_symlink() or (real.exists() and not real.is_file()):  # a link: one to itself
        raise ValueError(f"{path}: not a file; give the path of a file")
    partial = real.with_name(f".{real.name}.{os.getpid()}.part")  # as `train.files` finds them
    try:
        write(partial)
        os.replace(partial, real)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
