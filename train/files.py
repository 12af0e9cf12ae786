"""Files: written beside and renamed, so that an interruption loses nothing; JSON, CSV and locks."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

LOCK = ".lock"
_PART = re.compile(r"^\..*\.(?P<process>[0-9]+)\.part$")


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
    except CannotWrite:
        raise
    except OSError as error:
        raise cannot_write(path, error) from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def check_utf8(name: object) -> None:
    """ValueError for a name, of a file say, that is not text in UTF-8: no record could hold it."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        raise ValueError(
            f"{name}: not UTF-8; rename it, or, where this is no UTF-8 terminal, set PYTHONUTF8=1"
        ) from None


class CannotWrite(OSError):
    """A file could not be written; in words, and without the name of any temporary file."""


def cannot_write(path: Path, error: Exception) -> CannotWrite:
    """The error that says so of `path`, and why."""
    reason = getattr(error, "strerror", None) or (str(error).splitlines() or [""])[0]
    return CannotWrite(
        f"{path}: cannot be written ({reason or type(error).__name__}); make room, or give a "
        "folder that can be written. What was there before is kept"
    )


def check_folder(path: Path) -> None:
    """ValueError unless there is such a folder."""
    if not path.is_dir():
        raise ValueError(f"{path}: no such folder")


def check_new_files(paths: Iterable[Path | None], overwrite: bool = False) -> None:
    """ValueError unless a command may write each of these files.

    Args:
        paths: of its outputs, all different; None for one that is not wanted.
        overwrite: files that exist may be replaced; otherwise all must be new.
    """
    given = [path for path in paths if path is not None]
    for number, path in enumerate(given):
        if path in given[:number]:
            raise ValueError(f"{path}: given for two outputs; give two files")
        if path.is_dir():
            raise ValueError(f"{path}: a folder; give the path of a file")
        if path.exists() and not overwrite:
            raise ValueError(f"{path}: exists already; give a new file, or --overwrite")
        if not path.parent.is_dir():
            raise ValueError(f"{path}: no folder {path.parent}; make it first")


def check_output_folder(
    folder: Path, is_own: Callable[[Path], bool], overwrite: bool | None = None
) -> None:
    """ValueError unless a command may write its output into a folder.

    Args:
        folder: of the output; new, empty, or one that the command wrote before.
        is_own: whether the command wrote this folder, by the files in it.
        overwrite: any other folder is allowed as well; None for a command without this option.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: a file; give a folder")
    if overwrite or not folder.exists() or is_own(folder):
        return
    if any(path.name != LOCK and not is_leftover(path) for path in folder.iterdir()):
        raise ValueError(
            f"{folder}: holds files that this command did not write; give a new folder"
            + (", or --overwrite" if overwrite is not None else "")
        )


def begins_with(path: Path, text: str) -> bool:
    """Whether there is a file at `path` that begins with this text."""
    try:
        with path.open("rb") as file:
            return file.read(len(text.encode())) == text.encode()
    except OSError:
        return False


def is_leftover(path: Path) -> bool:
    """Whether `path` is the beginning of a file that a process which is gone did not finish."""
    named = _PART.match(path.name)
    if named is None:
        return False
    try:
        os.kill(int(named["process"]), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:  # somebody else's process: it lives
        return False
    return False


def remove_leftovers(folder: Path) -> None:
    """Delete what processes that are gone did not finish, in `folder` and below."""
    for path in folder.rglob(".*.part"):
        if is_leftover(path):
            with contextlib.suppress(OSError):
                path.unlink()


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
        text = path.read_text(encoding="utf-8")
        content = json.loads(text, parse_constant=_number, parse_float=_number)
        if "\\ud" in text.lower():  # an escape, of one half of a character perhaps
            json.dumps(content, ensure_ascii=False).encode()
        return content
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError):  # the latter where it is nested without end
        raise ValueError(f"{path}: damaged, not JSON; restore it from a copy") from None


def _number(text: str) -> float:
    number = float(text)
    if abs(number) < float("inf"):
        return number
    raise ValueError(f"{text} is no number of JSON")


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows under the header of `path`, as texts.

    Raises:
        ValueError: it cannot be read, or a row has not as many cells as the header.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            heads, *rows = list(csv.reader(file, strict=True)) or [[]]
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, csv.Error):
        raise ValueError(f"{path}: damaged, not CSV; restore it from a copy") from None
    if len(set(heads)) != len(heads) or any(len(row) != len(heads) for row in rows):
        raise ValueError(
            f"{path}: damaged, a row has not as many cells as the header has names; restore it "
            "from a copy"
        )
    return [dict(zip(heads, row, strict=True)) for row in rows]


def number_in(text: str, where: str) -> float:
    """The number that a cell of a table holds; ValueError naming `where` it is for none."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{where}: {text[:40]!r} is no number; restore it from a copy") from None


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


def hold(folder: Path, what: str, shared: bool = False) -> FileLock:
    """Hold `folder`, which is made if need be, until the lock is released.

    The system releases it when the process ends, however that ends; so does Python, when nobody has
    the lock any more.

    Args:
        folder: to be held.
        what: is done in it, for the message.
        shared: within this process it may be held several times.

    Raises:
        ValueError: it is held already.
        OSError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / LOCK, is_singleton=shared)
        lock.acquire(blocking=False)
    except Timeout:
        raise ValueError(f"{folder}: another {what} works on this folder; wait for it") from None
    except OSError as error:
        raise cannot_write(folder, error) from None
    return lock


@contextlib.contextmanager
def reserved(*paths: Path | None, overwrite: bool = False) -> Iterator[None]:
    """Holds the paths of output files for this process, which writes them meanwhile.

    Args:
        paths, overwrite: as in `check_new_files`.

    Raises:
        ValueError: as `check_new_files`, or another process is to write one of them.
    """
    check_new_files(paths, overwrite)
    with contextlib.ExitStack() as held:
        for path in filter(None, paths):
            lock = FileLock(path.with_name(f".{path.name}{LOCK}"))
            try:
                lock.acquire(blocking=False)
            except Timeout:
                raise ValueError(
                    f"{path}: another process is to write this file; give another, or wait for it"
                ) from None
            except OSError as error:
                raise cannot_write(path, error) from None
            held.callback(lock.release)
            held.callback(Path(lock.lock_file).unlink, missing_ok=True)
        check_new_files(paths, overwrite)  # one may have been written before it was held
        yield


@contextlib.contextmanager
def only_one(folder: Path, what: str) -> Iterator[None]:
    """Holds `folder` for this process, and clears it of what the dead left half written.

    Raises:
        ValueError: naming `what`, where another one works on it.
    """
    lock = hold(folder, what)
    try:
        remove_leftovers(folder)
        yield
    finally:
        lock.release()
