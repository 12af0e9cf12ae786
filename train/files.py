"""Files: written beside and renamed, so that an interruption loses nothing; JSON, CSV and locks."""

from __future__ import annotations

import contextlib
import csv
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout


def write_beside(path: Path, write: Callable[[Path], object]) -> None:
    """Have `write` make a file beside `path`, then put it in its place in one step.

    Raises:
        ValueError: `path` is a folder or a device, which renaming would replace.
        OSError: the disk is full, say; whatever was at `path` is still there.
    """
    if path.exists() and not path.is_file():
        raise ValueError(f"{path}: not a file; give the path of a file")
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(beside)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """`text` in UTF-8, atomically."""
    write_beside(path, lambda beside: beside.write_text(text, encoding="utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """These bytes, atomically."""
    write_beside(path, lambda beside: beside.write_bytes(content))


def write_json(path: Path, content: Any) -> None:
    """`content` as indented JSON, atomically."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def read_json(path: Path) -> Any:
    """The JSON in `path`; ValueError naming the file where there is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        raise ValueError(f"{path}: damaged, not JSON") from None


def write_csv(
    path: Path, rows: Sequence[Mapping[str, Any]], names: Iterable[str] | None = None
) -> None:
    """The rows under a header of `names` (all that occur, in order, if left out), atomically."""
    heads = list(names or dict.fromkeys(name for row in rows for name in row))

    def write(beside: Path) -> None:
        with beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, heads)
            writer.writeheader()
            writer.writerows(rows)

    write_beside(path, write)


@contextlib.contextmanager
def only_one(folder: Path, what: str) -> Iterator[None]:
    """Holds `folder` for this process; ValueError naming `what` where another one works on it."""
    folder.mkdir(parents=True, exist_ok=True)
    try:  # the system lets go of the lock when its process ends, however that ends
        held = FileLock(folder / ".lock").acquire(blocking=False)
    except Timeout:
        raise ValueError(f"{folder}: another {what} works on this folder; wait for it") from None
    with held:
        yield
