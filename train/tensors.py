"""Files of tensors and plain values, written atomically and verified by a checksum."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import torch

from pursuit.files import cannot_write, write_atomically

StateDict = dict[str, Any]
"""Tensors and plain values by name: the content of a checkpoint, or a part of it."""

REMEDY = "restore it from a copy"
MARK = b"sha256:"
"""The end of a file, followed by the digest of its content: torch itself verifies no checksums."""


@contextmanager
def own_defaults() -> Iterator[None]:
    """PyTorch's initial defaults inside, float32 and the CPU, whatever the user has set."""
    made = torch.empty(0)  # faster than `torch.get_default_device`
    if made.dtype == torch.float32 and made.device.type == "cpu":
        yield
        return
    torch.set_default_dtype(torch.float32)
    try:
        with torch.device("cpu"):
            yield
    finally:
        torch.set_default_dtype(made.dtype)


def write_tensors(path: Path, content: object) -> None:
    """Write tensors and plain values with a checksum, atomically.

    Raises:
        OSError: for example a full disk; the previous file at `path` is kept.
    """

    def write(beside: Path) -> None:
        try:
            torch.save(content, beside)
            with beside.open("r+b") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
                file.write(MARK + digest)
        except RuntimeError as error:  # torch's error for a failed write
            raise cannot_write(path, _reason(beside, error)) from None

    write_atomically(path, write)


def _reason(beside: Path, error: RuntimeError) -> Exception:
    """The operating system's reason for a failed write, from another attempt: torch gives none."""
    try:
        with beside.open("ab") as file:
            file.write(bytes(2**16))
            file.flush()
            os.fsync(file.fileno())
    except OSError as refused:
        return refused
    return error


def read_tensors(path: Path) -> Any:
    """Read a file of `write_tensors` without running code from it (`weights_only=True`).

    Raises:
        ValueError: it cannot be read, is damaged (even by a single bit), or contains more than
            tensors and plain values.
    """
    try:
        with path.open("rb") as file:
            if not _checksum_fits(file):
                raise ValueError(
                    f"{path}: damaged, or not written by pursuit: its checksum does not match; "
                    f"{REMEDY}"
                )
            return loaded_tensors(file, path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def is_whole(path: Path) -> bool:
    """Whether the file of `write_tensors` can be read, and fits its checksum."""
    try:
        with path.open("rb") as file:
            return _checksum_fits(file)
    except OSError:
        return False


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


def loaded_tensors(file: BinaryIO, path: Path) -> Any:
    """The content that torch saved in `file` at `path`, without running code from it.

    Raises:
        ValueError: it is damaged, or contains more than tensors and plain values.
    """
    try:
        size = file.seek(0, os.SEEK_END)
        with zipfile.ZipFile(file) as archive:
            # torch does not compress, so a small file cannot require much memory.
            fits = sum(part.file_size for part in archive.infolist()) <= size
        file.seek(0)
        if fits:
            content = torch.load(file, map_location="cpu", weights_only=True)
            if all(_fits(tensor) for _, tensor in _tensors_in(content)):
                return content
    except Exception:  # the unpickler can raise anything for damaged bytes
        pass
    raise ValueError(f"{path}: damaged, or not only tensors and plain values; {REMEDY}")


def _fits(tensor: torch.Tensor) -> bool:
    """Whether a tensor is not larger than its memory: a view may repeat one number endlessly."""
    return tensor.numel() * tensor.element_size() <= tensor.untyped_storage().nbytes()


def first_not_finite(content: object) -> str | None:
    """The path, within nested dicts and lists, of the first tensor that is not finite."""
    found = _tensors_in(content)
    return next((where for where, tensor in found if not tensor.isfinite().all()), None)


def _tensors_in(content: object, where: str = "") -> Iterator[tuple[str, torch.Tensor]]:
    """All tensors in nested dicts and lists, with their paths."""
    parts: Any = ()
    if isinstance(content, torch.Tensor):
        yield where, content
    if isinstance(content, Mapping):
        parts = content.items()
    elif isinstance(content, list | tuple):
        parts = enumerate(content)
    for name, part in parts:
        yield from _tensors_in(part, f"{where}.{name}".lstrip("."))
