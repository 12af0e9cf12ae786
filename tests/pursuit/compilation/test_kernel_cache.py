"""The files of compiled kernels, which several processes read and write at once."""

import errno
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core import event

from pursuit.compilation import kernel_cache
from pursuit.compilation.compiled import compiled

TYPES = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "float32", "float64")
WRITER = """
import sys
import numpy as np
from pursuit.compilation.compiled import compiled

@compiled
def doubled(numbers):
    return numbers[0] * 2

print(flush=True)
sys.stdin.readline()
for name in sys.argv[1:]:
    assert doubled(np.array([3], dtype=name)) == 6
print(sum(doubled.stats.cache_hits.values()), sum(doubled.stats.cache_misses.values()), flush=True)
"""


def kernel_in(folder: Path, monkeypatch: pytest.MonkeyPatch, stamp: str = "stamp") -> Any:
    """A kernel that nothing was compiled for yet in this process, with its files in a folder."""
    monkeypatch.setattr(kernel_cache, "source_stamp", lambda _: stamp)

    @compiled
    def doubled(numbers: Any) -> Any:
        return numbers[0] * 2

    cache: Any = doubled._cache  # type: ignore[attr-defined]
    cache._cache_path = str(folder)
    cache._impl.locator.get_cache_path = lambda: str(folder)
    file = cache._cache_file
    file._cache_path, file._index_path = str(folder), str(folder / file._index_name)
    return doubled


@pytest.mark.slow
def test_processes_that_begin_at_once_fill_one_cache(tmp_path: Path) -> None:
    """Four processes compile the same in different orders, then a fifth compiles nothing."""
    script = tmp_path / "script.py"
    script.write_text(WRITER)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def started(first: int) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, str(script), *TYPES[first:], *TYPES[:first]],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert process.stdout is not None and process.stdout.readline() == "\n"
        return process

    def begin(process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        print(file=process.stdin, flush=True)

    def hits_and_misses(process: subprocess.Popen[str]) -> list[int]:
        with process:
            assert process.stdout is not None
            found = [int(part) for part in process.stdout.readline().split()]
        assert process.returncode == 0
        return found

    writers = [started(first) for first in (0, 0, 2, 5)]
    for writer in writers:
        begin(writer)
    assert all(sum(hits_and_misses(writer)) == len(TYPES) for writer in writers)
    begin(reader := started(0))
    assert hits_and_misses(reader) == [len(TYPES), 0]
    assert not list(tmp_path.rglob("*.tmp.*"))  # nothing half written is left


def test_other_processes_do_not_wait_for_a_compilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is locked while files are read or written only."""
    fcntl = pytest.importorskip("fcntl")
    kernel, compilations = kernel_in(tmp_path, monkeypatch), 0

    class Other(event.Listener):
        def on_start(self, event: Any) -> None:
            nonlocal compilations
            handle = os.open(tmp_path, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)  # raises if it is locked
            os.close(handle)
            compilations += 1

        on_end = on_start

    with event.install_listener("numba:compile", Other()):
        assert kernel(np.array([2])) == 4
    assert compilations == 2


def test_machine_code_is_loaded_for_its_signature_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = kernel_in(tmp_path, monkeypatch)
    kernel(np.array([2]))
    (one,) = tmp_path.glob("*.nbc")
    kernel(np.array([2.5]))
    (other,) = set(tmp_path.glob("*.nbc")) - {one}
    shutil.copy(one, other)
    again = kernel_in(tmp_path, monkeypatch)
    assert again(np.array([2])) == 4 and again(np.array([2.5])) == 5.0
    assert sum(again.stats.cache_hits.values()) == sum(again.stats.cache_misses.values()) == 1


def test_machine_code_of_other_sources_is_never_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hits(stamp: str, number: Any) -> int:
        kernel = kernel_in(tmp_path, monkeypatch, stamp)
        assert kernel(np.array([number])) == 2 * number
        return sum(kernel.stats.cache_hits.values())

    assert [hits("old", 1), hits("old", 1.0), hits("old", 1), hits("old", 1.0)] == [0, 0, 1, 1]
    assert [hits("new", 1), hits("new", 1), hits("new", 1.0)] == [0, 1, 0]
    assert hits("old", 1) == 0


@pytest.mark.parametrize("fails", ["open", "replace", "makedirs"])
def test_a_full_disk_gives_one_warning_and_no_partial_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    kernel = kernel_in(tmp_path, monkeypatch)
    monkeypatch.setattr(kernel_cache, "has_warned", False)
    with monkeypatch.context() as disk:
        disk.setattr(os, fails, full)
        with pytest.warns(UserWarning, match=r"No space left on device.*NUMBA_CACHE_DIR") as warned:
            assert kernel(np.array([2])) == 4
            assert kernel(np.array([2.5])) == 5.0
    assert len(warned) == 1 and str(tmp_path) in str(warned[0].message)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("left", [b"", b"\x80\x04", b"nonsense", None])
def test_damaged_files_are_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, left: bytes | None
) -> None:
    """Machine code with one changed byte could be unpickled, and end the process."""
    assert kernel_in(tmp_path, monkeypatch)(np.array([2])) == 4
    (path,) = tmp_path.glob(suffix)
    content = path.read_bytes()
    at = content.find(b"\x7fELF") + 100 if suffix == "*.nbc" else len(content) // 2
    changed = content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]
    path.write_bytes(changed if left is None else left)
    for hits in (0, 1):
        kernel = kernel_in(tmp_path, monkeypatch)
        assert kernel(np.array([2])) == 4
        assert sum(kernel.stats.cache_hits.values()) == hits


def test_an_index_that_cannot_be_read_is_ignored_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "has_warned", False)
    kernel_in(tmp_path, monkeypatch)(np.array([2]))
    (index,) = tmp_path.glob("*.nbi")
    kept = index.read_bytes()
    index.unlink()
    index.mkdir()
    with pytest.warns(UserWarning, match=r"Is a directory.*NUMBA_CACHE_DIR"):
        assert kernel_in(tmp_path, monkeypatch)(np.array([2])) == 4
    index.rmdir()
    index.write_bytes(kept)
    kernel = kernel_in(tmp_path, monkeypatch)
    kernel(np.array([2]))
    assert sum(kernel.stats.cache_hits.values()) == 1  # it was not taken for one of another source


def test_a_kernel_is_compiled_without_its_cache_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    kernel = kernel_in(tmp_path / "file" / "folder", monkeypatch)
    monkeypatch.setattr(kernel_cache, "has_warned", False)
    with pytest.warns(UserWarning, match="Not a directory"):
        assert kernel(np.array([3])) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kernel(np.array([3.0])) == 6.0
