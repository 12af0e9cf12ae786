"""Files are written beside their place and renamed, so that a failure leaves what was there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def write_beside(path: Path, write: Callable[[Path], object]) -> None:
    """Have `write` make a file beside `path`, then put it in its place.

    Raises:
        OSError: it cannot be written; the error names `path`.
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
