"""Tensors and plain values in files: written beside, proved when read, held against their form."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import torch

from train.files import cannot_write, write_beside

REMEDY = "restore it from a copy"
MARK = b"sha256:"
"""What ends a file, with the digest of all before it: torch itself compares no checksums."""


class Misfit(ValueError):
    """What was read has not the form that is needed; says where, and what is needed there."""


def write_tensors(path: Path, content: Any) -> None:
    """Write tensors and plain values with a checksum, atomically.

    Raises:
        OSError: the disk is full, say; whatever was at `path` is still there.
    """

    def write(beside: Path) -> None:
        try:
            torch.save(content, beside)
            with beside.open("r+b") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
                file.write(MARK + digest)
        except RuntimeError as error:  # what torch makes of a write that failed
            raise cannot_write(path, _reason(beside, error)) from None

    write_beside(path, write)


def _reason(beside: Path, error: RuntimeError) -> Exception:
    """Why the system refused to write, which torch does not say: ask it again."""
    try:
        with beside.open("ab") as file:
            file.write(bytes(2**16))
            file.flush()
            os.fsync(file.fileno())
    except OSError as refused:
        return refused
    return error


def read_tensors(path: Path) -> Any:
    """What `write_tensors` wrote; no code that the file may hold is run (`weights_only=True`).

    Raises:
        ValueError: it cannot be read, is damaged (by so much as a bit of a tensor), or holds more
            than tensors and plain values.
    """
    try:
        with path.open("rb") as file:
            if not _checksum_fits(file):
                raise ValueError(
                    f"{path}: damaged, or not written by pursuit: its checksum does not fit; "
                    f"{REMEDY}"
                )
            return loaded(file, path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def _checksum_fits(file: BinaryIO) -> bool:
    digest = hashlib.sha256()
    ending = len(MARK) + digest.digest_size
    left = file.seek(0, os.SEEK_END) - ending
    file.seek(0)
    while left > 0:
        part = file.read(min(left, 2**20))
        if not part:
            return False
        digest.update(part)
        left -= len(part)
    return left == 0 and file.read() == MARK + digest.digest()


def loaded(file: BinaryIO, path: Path) -> Any:
    """What torch saved in `file`, which is of `path`; no code that it may hold is run.

    Raises:
        ValueError: it is damaged, or holds more than tensors and plain values.
    """
    try:
        size = file.seek(0, os.SEEK_END)
        with zipfile.ZipFile(file) as archive:
            # Nothing torch writes is compressed; so a small file cannot ask for much memory.
            fits = sum(part.file_size for part in archive.infolist()) <= size
        file.seek(0)
        if fits:
            return torch.load(file, map_location="cpu", weights_only=True)
    except Exception:  # the unpickler raises whatever the bytes lead it to
        pass
    raise ValueError(f"{path}: damaged, or it holds more than tensors and plain values; {REMEDY}")


# -- forms -----------------------------------------------------------------------------------------


def check_like(found: Any, like: Any, where: str = "", more: bool = False) -> None:
    """Raise Misfit unless `found` has the form of `like`, which is of a fresh object of its kind.

    Dicts have the same names, lists as many items, tensors the same dtype and shape, values the
    same type; numbers are finite where those of `like` are. What is empty or None in `like` says
    nothing of what it holds later: an empty dict or list takes any items, None takes anything, and
    a dimension of 0 any number of rows. With `more` the outermost dict may have further names.
    """
    if like is None:
        return
    if isinstance(like, torch.Tensor):
        _check_tensor(found, like, where, _finite(like))
    elif isinstance(like, Mapping):
        _need(isinstance(found, dict), where, "a table", found)
        for name in like or ():
            _need(name in found, _at(where, name), _word(like[name]), None)
            check_like(found[name], like[name], _at(where, name))
        unknown = [name for name in found if like and not more and name not in like]
        _need(not unknown, _at(where, *unknown[:1]), "nothing of that name", found)
    elif isinstance(like, list | tuple):
        _need(isinstance(found, list | tuple), where, "a list", found)
        _need(not like or len(found) == len(like), where, f"{len(like)} items", found)
        for number, (one, other) in enumerate(zip(found, like, strict=False)):
            check_like(one, other, _at(where, number))
    else:
        _need(type(found) is type(like), where, _word(like), found)
        if isinstance(like, float) and _finite(like):
            _need(_finite(found), where, "a finite number", found)
        elif isinstance(like, int):
            _need(abs(found) < 2**63 or abs(like) >= 2**63, where, "a number of 64 bits", found)


def check_tensor(
    found: Any, dtype: torch.dtype, shape: tuple[int, ...], where: str, finite: bool = True
) -> None:
    """Raise Misfit unless `found` is a tensor like that; 0 in `shape` is any number of rows."""
    _check_tensor(found, torch.zeros(shape, dtype=dtype), where, finite)


def first_not_finite(content: Any, where: str = "") -> str | None:
    """Where among tables and lists the first tensor with a number that is not finite lies."""
    if isinstance(content, torch.Tensor):
        return None if _finite(content) else where
    parts: Any = ()
    if isinstance(content, Mapping):
        parts = content.items()
    elif isinstance(content, list | tuple):
        parts = enumerate(content)
    found = (first_not_finite(part, _at(where, name)) for name, part in parts)
    return next((place for place in found if place is not None), None)


def _check_tensor(found: Any, like: torch.Tensor, where: str, finite: bool) -> None:
    _need(isinstance(found, torch.Tensor), where, _word(like), found)
    fits = found.ndim == like.ndim and all(
        mine == wanted or wanted == 0 for mine, wanted in zip(found.shape, like.shape, strict=True)
    )
    _need(fits and found.dtype == like.dtype, where, _word(like), found)
    _need(found.layout == torch.strided, where, _word(like), found)
    _need(not finite or _finite(found), where, "finite numbers", found)


def _finite(value: Any) -> bool:
    if isinstance(value, torch.Tensor):
        return not value.is_floating_point() or bool(value.isfinite().all())
    return abs(value) < float("inf")


def _need(condition: bool, where: str, wanted: str, found: Any) -> None:
    if not condition:
        raise Misfit(f"{where or 'all of it'}: {wanted} needed, {_word(found)} found")


def _at(where: str, *names: Any) -> str:
    return ".".join([*([where] if where else []), *(str(name)[:80] for name in names)])


def _word(value: Any) -> str:
    """A value in words."""
    if isinstance(value, torch.Tensor):
        sizes = " x ".join(str(size) for size in value.shape) or "single"
        return f"{sizes} {str(value.dtype).removeprefix('torch.')}"
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    words = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
    return words.get(type(value), "something else")
