"""Atomic writing of files: a failure leaves the existing file unchanged."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary path in the same folder, then rename that file to `path`.

    Raises:
        OSError: the file cannot be written; the error names `path`.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")  # as `train.files` names them
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        partial.unlink(missing_ok=True)
