"""The on-disk cache of one kernel, which several processes may read and write at once.

Numba numbers the files of a kernel and writes its index before the file that the index names. Two
processes that compile one kernel for different arguments then take the same number, and one of them
is given the machine code of the other; after a change of the rules a process can find the new index
and the old file. Here every entry has a file of its own, named by what it was compiled for, which
it holds as well; it is written before the index, and the index by one process at a time.

Where the disk takes or gives nothing, kernels are kept in memory alone, and it is said once. Files
that were damaged, as by a machine that lost its power, are as none.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

with contextlib.suppress(ImportError):  # Windows: what two processes keep at once may be lost, and
    import fcntl  # is compiled again

DIGEST = hashlib.sha256().digest_size

has_warned = False
"""Whether this process has said that its disk takes or gives no kernels."""


class KernelCacheFile(IndexDataCacheFile):
    """The index of one kernel and the files that it names."""

    def load(self, key: Any) -> Any:
        """What was compiled for `key`, or None."""
        try:
            found = super().load(key)
        except OSError as error:
            warn_of(self._cache_path, error)
            return None
        return found[1] if found is not None and found[0] == key else None

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled for `key`, or warn that the disk does not."""
        try:
            self._keep(key, data)
        except OSError as error:
            warn_of(self._cache_path, error)

    def _keep(self, key: Any, data: Any) -> None:
        os.makedirs(self._cache_path, exist_ok=True)
        name = self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16))
        with locked(self._cache_path):
            kept = self._load_index()
            if not kept:  # of another source, or of none
                self._remove_all()
            self._save_data(name, (key, data))
            self._save_index({**kept, key: name})

    def _load_index(self) -> dict[Any, str]:
        try:
            found: dict[Any, str] = super()._load_index()
        except OSError:
            raise
        except Exception:  # what damaged pickles raise is not bounded
            return {}
        return found if isinstance(found, dict) else {}

    def _save_data(self, name: str, data: Any) -> None:
        content = self._dump(data)
        with self._open_for_write(self._data_path(name)) as file:
            file.write(hashlib.sha256(content).digest() + content)

    def _load_data(self, name: str) -> Any:
        """As Numba's; machine code with other bytes than were saved would end the process."""
        content = Path(self._data_path(name)).read_bytes()
        digest, content = content[:DIGEST], content[DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            raise OSError(f"{name}: damaged")  # to `load` it is none then
        return pickle.loads(content)

    def _remove_all(self) -> None:
        """Remove files that no index names any more."""
        before, _, after = self._data_name_pattern.partition("{number:d}")
        for path in Path(self._cache_path).iterdir():
            number = path.name.removeprefix(before).removesuffix(after)
            if path.name == f"{before}{number}{after}" and number.isdecimal():
                with contextlib.suppress(OSError):
                    path.unlink()


@contextlib.contextmanager
def locked(folder: str) -> Iterator[None]:
    """One process at a time is in here with a folder, where the system and its disk can do that."""
    if os.name == "nt":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # disks of other machines
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def warn_of(folder: str, error: OSError) -> None:
    """Say, once in a process, that compiled kernels cannot be kept in a folder, and why."""
    global has_warned
    if not has_warned:
        has_warned = True
        warnings.warn(
            f"{folder}: compiled kernels cannot be kept there ({error.strerror or error}), so all "
            "processes compile them again; make room there, or set NUMBA_CACHE_DIR to a folder",
            stacklevel=2,
        )


def cache_of(dispatcher: Any, stamp: str) -> KernelCacheFile:
    """The cache of a kernel in place of Numba's, for its source of this stamp."""
    cache = dispatcher._cache
    cache._impl.locator.ensure_cache_path = lambda: None  # `save` does that, and may fail
    return KernelCacheFile(cache._cache_path, cache._impl.filename_base, stamp)
