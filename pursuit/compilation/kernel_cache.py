"""The on-disk cache of compiled kernels.

Numba's cache of a kernel (`FunctionCache`) is used as it is but for three things that its public
settings do not offer:

- It looks at the file of the kernel alone. Here an entry is stamped with the contents of that file
  and of all files of this project that it imports, directly or not, so a change of a function that
  a kernel inlines reaches it.
- It numbers the files of a kernel and writes its index before the file that the index names, so
  processes that compile one kernel at once mix up its files. Here one process at a time reads or
  writes in a folder (Windows has no `flock`: there what two processes compile at once may be
  compiled again).
- A disk that is full ends the program, and machine code that was damaged may. Here kernels are then
  compiled and kept in memory, with one warning if the disk refuses.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import os
import pickle
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache

with contextlib.suppress(ImportError):
    import fcntl

ROOT = Path(__file__).parents[2]
PACKAGES = ("pursuit", "scripted_agents", "train")
"""The packages of this project that have kernels, in `ROOT`."""

has_warned = False
"""Whether this process has warned that the disk refuses compiled kernels."""


@cache
def source_stamp(path: str) -> str:
    """A fingerprint of the file `path` and of all project files that it imports."""
    digest = hashlib.sha256()
    for file in sorted(imported_files(Path(path))):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def imported_files(path: Path) -> set[Path]:
    """`path` and all files of this project that it imports, directly or not."""
    found, waiting = {path}, [path]
    while waiting:
        more = _imports(waiting.pop()) - found
        found |= more
        waiting += more
    return found


@cache
def _imports(path: Path) -> set[Path]:
    """The files of this project that a file imports, wherever in it; `from a import b` is a.b."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names += [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{each.name}" for each in node.names]
    files = set()
    for name in names:
        parts = name.split(".")
        if parts[0] in PACKAGES:
            module, holder = ROOT.joinpath(*parts), ROOT.joinpath(*parts[:-1])
            each = (module.with_suffix(".py"), holder.with_suffix(".py"))
            packages = (module / "__init__.py", holder / "__init__.py")
            candidates = (each[0], packages[0], each[1], packages[1])
            files |= set([file for file in candidates if file.is_file()][:1])
    return files


class CheckedImpl(CompileResultCacheImpl):
    """Numba's form of machine code in a file, with a checksum: damaged code would end a process."""

    def reduce(self, data: Any) -> Any:
        """What is written into the file."""
        content = pickle.dumps(super().reduce(data))
        return hashlib.sha256(content).digest(), content

    def rebuild(self, target_context: Any, reduced_data: Any) -> Any:
        """What was compiled, of what the file holds."""
        digest, content = reduced_data
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("damaged machine code")
        return super().rebuild(target_context, pickle.loads(content))


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    _impl_class = CheckedImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file._source_stamp = source_stamp(function.__code__.co_filename)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled for the argument types `sig`, or None."""
        found = self._exclusively(self._load, sig, target_context)
        return found if found is not None and found.signature.args == tuple(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for the argument types `sig`."""
        self._exclusively(super().save_overload, sig, data)

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except OSError:
            raise
        except Exception:  # what damaged pickles raise is not bounded
            self.flush()
            return None

    def _exclusively(self, work: Callable[..., Any], *given: Any) -> Any:
        """`work(*given)` by one process at a time in the folder; None where the disk refuses."""
        global has_warned
        try:
            os.makedirs(self._cache_path, exist_ok=True)
            with locked(self._cache_path):
                return work(*given)
        except OSError as error:
            if not has_warned:
                has_warned = True
                warnings.warn(
                    f"{self._cache_path}: compiled kernels cannot be kept there "
                    f"({error.strerror or error}), so all processes compile them again; make room "
                    "there, or set NUMBA_CACHE_DIR to a folder",
                    stacklevel=3,
                )
            return None


@contextlib.contextmanager
def locked(folder: str) -> Iterator[None]:
    """One process at a time is in here with a folder, where the system and its disk can do that."""
    if os.name == "nt":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # network file systems without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
