"""The on-disk cache of compiled kernels.

It extends Numba's cache of a kernel (`FunctionCache`) in four points that Numba's settings do not
cover:

- Numba checks only the file of the kernel for changes. Here the stamp of an entry covers that file
  and all project files that it imports, directly or not, so that changes of inlined functions are
  detected.
- Numba numbers the files of a kernel and writes its index first, so processes that compile the same
  kernel simultaneously mix up its files. Here a lock admits one process at a time to a folder.
  (Windows has no `flock`; there kernels compiled simultaneously may be compiled again.)
- With Numba a full disk ends the program, and damaged machine code may. Here such kernels are
  compiled and kept in memory, with one warning if the folder is not writable.
- The files name modules and classes, which are found by names that no module of a user hides.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
import re
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.environment import _rebuild_env

from pursuit.siblings import second_name

with contextlib.suppress(ImportError):
    import fcntl

ROOT = Path(__file__).parents[2]
PACKAGES = ("pursuit", "scripted_agents", "train")
"""The packages of this project that have kernels, in `ROOT`."""

IMPORT = re.compile(
    r"(?:^|[;:])\s*(?:from\s+([\w.]+)\s+)?import\s+(\([^)]*\)|(?:\\\n|[^\n;])+)", re.MULTILINE
)
"""An import statement, in a source without comments: the module before and the names behind it."""

has_warned = False
"""Whether this process has warned that compiled kernels cannot be saved."""


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
    """The project files that a file imports anywhere; `from a import b` may name module a.b."""
    files = set()
    for name in imported_names(path):
        parts = name.split(".")
        if parts[0] in PACKAGES:
            module, holder = ROOT.joinpath(*parts), ROOT.joinpath(*parts[:-1])
            each = (module.with_suffix(".py"), holder.with_suffix(".py"))
            packages = (module / "__init__.py", holder / "__init__.py")
            candidates = (each[0], packages[0], each[1], packages[1])
            files |= set([file for file in candidates if file.is_file()][:1])
    return files


def imported_names(path: Path) -> set[str]:
    """`a` of each `import a` in a file, and `a.b` of each `from a import b`; or more.

    Python's parser would take a quarter of a second for the files of all kernels.
    """
    code = re.sub("#.*", "", path.read_text(encoding="utf-8"))
    return {
        f"{source}.{name}".strip(".")
        for source, imported in IMPORT.findall(code)
        for name in re.findall(r"[\w.]+", imported)
    }


class OwnUnpickler(pickle.Unpickler):
    """Reads pickles of the cache; modules of this project have their second names."""

    def find_class(self, module: str, name: str) -> Any:
        """The object `name` of a module."""
        found = super().find_class(second_name(module), name)
        return rebuild_environment if found is _rebuild_env else found


def rebuild_environment(module: str, constants: Any, name: str) -> Any:
    """Numba's function that makes the environment of a function in a module."""
    return _rebuild_env(second_name(module), constants, name)


class CheckedFile(IndexDataCacheFile):
    """Numba's files of a kernel, read by `OwnUnpickler`."""

    def _load_index(self) -> dict[Any, str]:
        try:
            content = Path(self._index_path).read_bytes()
        except FileNotFoundError:
            return {}
        stream = io.BytesIO(content)
        if pickle.load(stream) != self._version:
            return {}
        stamp, overloads = OwnUnpickler(stream).load()
        return overloads if stamp == self._source_stamp else {}


class CheckedImpl(CompileResultCacheImpl):
    """Numba's file format of machine code, with a checksum, as damaged code can end the process."""

    def reduce(self, data: Any) -> Any:
        """The content of the file for compiled code."""
        content = pickle.dumps(super().reduce(data))
        return hashlib.sha256(content).digest(), content

    def rebuild(self, target_context: Any, reduced_data: Any) -> Any:
        """The compiled code from the content of the file."""
        digest, content = reduced_data
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("damaged machine code")
        parts = OwnUnpickler(io.BytesIO(content)).load()
        function = parts[1]
        function.modname = second_name(function.modname)
        return super().rebuild(target_context, parts)


class KernelCache(FunctionCache):
    """The cache of one kernel."""

    _impl_class = CheckedImpl

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        stamp = source_stamp(function.__code__.co_filename)
        self._cache_file = CheckedFile(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for the argument types `sig`, or None."""
        found = self._exclusively(self._load, sig, target_context)
        return found if found is not None and found.signature.args == tuple(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the compiled code for the argument types `sig`."""
        self._exclusively(super().save_overload, sig, data)

    def _load(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except OSError:
            raise
        except Exception:  # damaged pickles may raise anything
            self.flush()
            return None

    def _exclusively(self, work: Callable[..., Any], *given: Any) -> Any:
        """`work(*given)` with the folder locked; None if the folder cannot be used."""
        global has_warned
        try:
            os.makedirs(self._cache_path, exist_ok=True)
            with locked(self._cache_path):
                return work(*given)
        except OSError as error:
            if not has_warned:
                has_warned = True
                warnings.warn(
                    f"{self._cache_path}: compiled kernels cannot be saved there "
                    f"({error.strerror or error}), so each process compiles them again; free space "
                    "there, or set NUMBA_CACHE_DIR to another folder",
                    stacklevel=3,
                )
            return None


@contextlib.contextmanager
def locked(folder: str) -> Iterator[None]:
    """Lock a folder for this process, if the system and the file system support locks."""
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
