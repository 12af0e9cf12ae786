"""Atomic writing of files, JSON and CSV, and locks."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from pursuit.files import cannot_write, write_atomically

LOCK = ".lock"
Plain = dict[str, Any]
"""Values by name: the content of a JSON file, or of a checkpoint (then also tensors)."""
RUN_FILES = ("config.json", "metrics.csv", "results.json", "checkpoint.pt", "checkpoints.json")
"""What a run is: its further files are drawn again from these."""
CONFIG_BEGINS = '{\n  "format": '
"""How `config.json` of a run begins, unlike files of this name of other programs."""
PART = re.compile(r"^\..*\.(?P<process>[0-9]+)\.part$")
"""Names of temporary files."""


def check_utf8(name: object) -> None:
    """ValueError for a name that is not valid UTF-8, as files cannot contain it."""
    try:
        str(name).encode()
    except UnicodeEncodeError:
        raise ValueError(
            f"{name}: not UTF-8; rename it, or set PYTHONUTF8=1 in a terminal without UTF-8"
        ) from None


def check_folder(path: Path) -> None:
    """ValueError unless `path` is an existing folder."""
    if not path.is_dir():
        raise ValueError(f"{path}: no such folder; give an existing one")


def check_new_files(
    paths: Iterable[Path | None], overwrite: bool = False, inputs: Iterable[Path] = ()
) -> None:
    """ValueError unless a command may write these files.

    Args:
        paths: of its outputs, all different; None for an output that is not written.
        overwrite: whether existing files may be replaced, except the inputs, and those of which a
            run consists.
        inputs: files or folders that it reads.
    """
    given, read = [path for path in paths if path is not None], [*map(os.path.realpath, inputs)]
    for number, path in enumerate(given):
        if path in given[:number]:
            raise ValueError(f"{path}: given for two outputs; give two different files")
        if path.is_dir():
            raise ValueError(f"{path}: is a folder; give the path of a file")
        real = Path(os.path.realpath(path))
        of_run = real.name in RUN_FILES and begins_with(real.with_name(RUN_FILES[0]), CONFIG_BEGINS)
        if of_run or str(real) in read:
            which = "a file of a run" if of_run else "the input"
            raise ValueError(f"{path}: is {which}, which is never replaced; give a new file")
        if path.exists() and not overwrite:
            raise ValueError(f"{path}: exists already; give a new file, or --overwrite")
        if real.is_symlink():
            raise ValueError(f"{path}: a link to itself; give the path of a file")
        folder = real.parent if path.is_symlink() else path.parent
        if not folder.is_dir():
            raise ValueError(f"{path}: folder {folder} does not exist; make it first")


def check_output_folder(
    folder: Path, is_own: Callable[[Path], bool], overwrite: bool | None = None
) -> None:
    """ValueError unless a command may write its output into a folder.

    Args:
        folder: of the output; new, empty, or written by the same command before.
        is_own: whether the command wrote the files of this folder.
        overwrite: whether any other folder is allowed; None for a command without this option.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file; give a folder")
    if overwrite or not folder.exists() or is_own(folder):
        return
    if any(path.name != LOCK and not is_leftover(path) for path in folder.iterdir()):
        raise ValueError(
            f"{folder}: contains files that this command did not write; give a new folder"
            + (", or --overwrite" if overwrite is not None else "")
        )


def begins_with(path: Path, text: str) -> bool:
    """Whether there is a file at `path` that starts with this text."""
    try:
        with path.open("rb") as file:
            return file.read(len(text.encode())) == text.encode()
    except OSError:
        return False


def is_leftover(path: Path) -> bool:
    """Whether `path` is a temporary file of a process that has ended."""
    named = PART.match(path.name)
    return named is not None and not is_running(int(named["process"]))


def is_running(process: int) -> bool:
    """Whether a process with this number is running; True on Windows, which cannot be asked so."""
    if os.name == "nt":  # os.kill(process, 0) sends Ctrl-C there
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # of another user
        return True
    return True


def remove_leftovers(folder: Path) -> None:
    """Delete temporary files of processes that have ended, in `folder` and its subfolders."""
    for path in folder.rglob(".*.part"):
        if is_leftover(path):
            with contextlib.suppress(OSError):
                path.unlink()


def write_text(path: Path, text: str) -> None:
    """Write `text` in UTF-8, atomically."""
    write_atomically(path, lambda beside: beside.write_text(text, encoding="utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write `content`, atomically."""
    write_atomically(path, lambda beside: beside.write_bytes(content))


def write_json(path: Path, content: object) -> None:
    """Write `content`, with numbers of Python or NumPy, as indented JSON, atomically."""
    write_text(path, json.dumps(content, indent=2, default=np.generic.item) + "\n")


def read_json(path: Path) -> Any:
    """The JSON in `path`; ValueError with the path if it is damaged."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = json.loads(text, parse_constant=_number, parse_float=_number)
        if "\\ud" in text.lower():  # possibly an unpaired surrogate
            json.dumps(content, ensure_ascii=False).encode()
        return content
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError):  # RecursionError for very deep nesting
        raise ValueError(f"{path}: damaged, not JSON; restore it from a copy") from None


def read_toml(path: Path, remedy: str) -> Plain:
    """The TOML in `path`; ValueError with the path and the remedy if it is damaged."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not TOML: {error}; {remedy}") from None


def _number(text: str) -> float:
    number = float(text)
    if abs(number) < float("inf"):
        return number
    raise ValueError(f"{text} is not a number in JSON")


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows under the header of `path`, as strings.

    Raises:
        ValueError: it cannot be read, or a row and the header differ in length.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            heads, *rows = list(csv.reader(file, strict=True)) or [[]]
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, csv.Error):
        raise ValueError(f"{path}: damaged, not CSV; restore it from a copy") from None
    if len(set(heads)) != len(heads) or any(len(row) != len(heads) for row in rows):
        raise ValueError(
            f"{path}: damaged, a row and the header differ in length; restore it from a copy"
        )
    return [dict(zip(heads, row, strict=True)) for row in rows]


def number_in(text: str, where: str) -> float:
    """The number in a cell of a table; otherwise ValueError, which starts with `where`."""
    try:
        return float(text)
    except ValueError:
        raise ValueError(
            f"{where}: {text[:40]!r} is not a number; restore it from a copy"
        ) from None


def write_csv(
    path: Path, rows: Sequence[Mapping[str, object]], names: Iterable[str] | None = None
) -> None:
    """Write rows under a header of `names` (default: all keys, in order), atomically."""
    heads = list(names or dict.fromkeys(name for row in rows for name in row))

    def write(beside: Path) -> None:
        with beside.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, heads)
            writer.writeheader()
            writer.writerows(rows)

    write_atomically(path, write)


def hold(folder: Path, what: str, shared: bool = False, name: str = LOCK) -> FileLock:
    """Lock `folder`, which is made if it does not exist, until the lock is released.

    It is also released when the process ends, or the lock is garbage-collected.

    Args:
        folder: to lock.
        what: the kind of work, for the message.
        shared: whether this process may lock it several times.
        name: of the file of the lock; others are for parts of the folder.

    Raises:
        ValueError: it is locked already.
        OSError: it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / name, is_singleton=shared)
        lock.acquire(blocking=False)
    except Timeout:
        raise ValueError(f"{folder}: another {what} uses this folder; wait for it") from None
    except OSError as error:
        raise cannot_write(folder, error) from None
    return lock


@contextlib.contextmanager
def reserved(
    *paths: Path | None, overwrite: bool = False, inputs: Iterable[Path] = ()
) -> Iterator[None]:
    """Lock the paths of output files for this process while it prepares them.

    Args:
        paths, overwrite, inputs: as in `check_new_files`.

    Raises:
        ValueError: as in `check_new_files`, or another process has locked one of them.
    """
    check_new_files(paths, overwrite, inputs)
    with contextlib.ExitStack() as held:
        for path in filter(None, paths):
            lock = FileLock(path.with_name(f".{path.name}{LOCK}"))
            try:
                lock.acquire(blocking=False)
            except Timeout:
                raise ValueError(
                    f"{path}: another process is writing this file; give another, or wait for it"
                ) from None
            except OSError as error:
                raise cannot_write(path, error) from None
            held.callback(lock.release)
            held.callback(Path(lock.lock_file).unlink, missing_ok=True)
        check_new_files(paths, overwrite)  # one may have been written before it was locked
        yield


@contextlib.contextmanager
def only_one(folder: Path, what: str) -> Iterator[None]:
    """Lock `folder` for this process, and delete temporary files of processes that have ended.

    Raises:
        ValueError: another process uses it; the message names `what`.
    """
    lock = hold(folder, what)
    try:
        remove_leftovers(folder)
        yield
    finally:
        lock.release()
