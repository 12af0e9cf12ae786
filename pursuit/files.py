"""Atomic writing of files: a failure leaves the existing file unchanged."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable
from pathlib import Path


class CannotWrite(OSError):
    """A file could not be written; the message does not name temporary files, but `filename`."""

    def __str__(self) -> str:
        return str(self.args[0])


def cannot_write(path: Path, error: Exception) -> CannotWrite:
    """The error for `path`, with its reason."""
    reason = getattr(error, "strerror", None) or (str(error).splitlines() or [""])[0]
    named = CannotWrite(
        f"{path}: cannot be written ({reason or type(error).__name__}); free space, or give a "
        "writable folder. The previous content is kept"
    )
    named.errno, named.filename = getattr(error, "errno", None), str(path)
    return named


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write` with a temporary path in the same folder, then rename that file to `path`.

    For a symbolic link the file that it names is written, even if that does not exist yet.

    Raises:
        ValueError: `path` is a folder or a device, which renaming would replace.
        CannotWrite: for example a full disk; the previous file at `path` is kept.
    """
    real = Path(os.path.realpath(path))
    if real.is_symlink() or (real.exists() and not real.is_file()):  # a link: one to itself
        raise ValueError(f"{path}: not a file; give the path of a file")
    # As `train.files` finds them; processes of two machines may have the same number.
    partial = real.with_name(f".{real.name}.{secrets.token_hex(4)}.{os.getpid()}.part")
    try:
        write(partial)
        os.replace(partial, real)
    except CannotWrite:
        raise
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
