"""The files of compiled kernels, which several processes read and write at once."""

import errno
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

from pursuit import kernel_cache
from pursuit.compiled import compiled
from pursuit.kernel_cache import KernelCacheFile

WRITER = """
import sys
from pursuit.kernel_cache import KernelCacheFile

folder, own, keys = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
print(flush=True)
sys.stdin.readline()
file = KernelCacheFile(folder, "kernel", "stamp")
for key in range(own, own + keys):
    file.save(("made for", key), f"code of {key}")
    assert file.load(("made for", key)) == f"code of {key}"
"""


@pytest.fixture
def file(tmp_path: Path) -> KernelCacheFile:
    return KernelCacheFile(str(tmp_path), "kernel", "stamp")


def files_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_processes_that_compile_one_kernel_lose_nothing_and_mix_up_nothing(tmp_path: Path) -> None:
    """Half of what each of them keeps another one keeps as well; all begin at once."""
    keys, writers = 40, []
    for own in range(0, 80, 20):
        writers.append(
            subprocess.Popen(
                [sys.executable, "-c", WRITER, str(tmp_path), str(own), str(keys)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        )
    for writer in writers:
        assert writer.stdout is not None and writer.stdout.readline() == "\n"
    for writer in writers:
        assert writer.stdin is not None
        print(file=writer.stdin, flush=True)
    for writer in writers:
        with writer:
            assert writer.wait(60) == 0
    file = KernelCacheFile(str(tmp_path), "kernel", "stamp")
    assert [file.load(("made for", key)) for key in range(100)] == [
        f"code of {key}" for key in range(100)
    ]
    assert len(files_in(tmp_path)) == 1 + 100  # nothing half written is left


def test_machine_code_is_given_for_what_it_was_made_for_alone(
    file: KernelCacheFile, tmp_path: Path
) -> None:
    file.save("one", b"code of one")
    (one,) = tmp_path.glob("*.nbc")
    file.save("other", b"code of other")
    (other,) = set(tmp_path.glob("*.nbc")) - {one}
    shutil.copy(one, other)
    assert file.load("one") == b"code of one" and file.load("other") is None
    file.save("other", b"compiled again")
    assert file.load("other") == b"compiled again" and len(files_in(tmp_path)) == 3


def test_what_another_source_was_compiled_to_is_never_given(
    file: KernelCacheFile, tmp_path: Path
) -> None:
    """Not even while the new index is there and its files are not yet: there is no such moment."""
    (tmp_path / "kernel.other-1.py311.1.nbc").write_bytes(b"of another kernel")
    (tmp_path / "kernel.1.nbc").write_bytes(b"from before there were names by content")
    file.save("one", b"old code")
    file.save("two", b"old code")
    changed = KernelCacheFile(str(tmp_path), "kernel", "another stamp")
    assert changed.load("one") is None and file.load("one") == b"old code"
    changed.save("one", b"new code")
    assert changed.load("one") == b"new code" and changed.load("two") is None
    assert file.load("one") is None and file.load("two") is None
    assert len(files_in(tmp_path)) == 2 + 1  # the old files are gone, the other kernel's is not


@pytest.mark.parametrize("fails", ["open", "replace", "makedirs"])
def test_where_the_disk_takes_nothing_it_is_said_once_and_nothing_is_left_half_written(
    file: KernelCacheFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(kernel_cache, "has_warned", False)
    file.save("one", b"code of one")
    with monkeypatch.context() as disk:
        disk.setattr(os, fails, full)
        with pytest.warns(UserWarning, match=r"No space left on device.*NUMBA_CACHE_DIR") as told:
            file.save("two", b"code of two")
            file.save("three", b"code of three")
    assert len(told) == 1 and str(tmp_path) in str(told[0].message)
    assert not list(tmp_path.glob("*.tmp.*"))
    assert file.load("one") == b"code of one" and file.load("two") is None
    file.save("two", b"code of two")
    assert file.load("two") == b"code of two"


@pytest.mark.parametrize("suffix", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("left", [b"", b"\x80\x04", b"nonsense"])
def test_damaged_files_are_as_none(
    file: KernelCacheFile, tmp_path: Path, suffix: str, left: bytes
) -> None:
    file.save("one", b"code of one")
    (path,) = tmp_path.glob(suffix)
    path.write_bytes(left)
    assert file.load("one") is None
    file.save("one", b"code of one")
    assert file.load("one") == b"code of one"


def test_machine_code_that_was_changed_is_as_none(file: KernelCacheFile, tmp_path: Path) -> None:
    """It would unpickle, and end the process that runs it."""
    file.save("one", b"code of one")
    (path,) = tmp_path.glob("*.nbc")
    content = path.read_bytes()
    assert content.count(b"code of one") == 1
    path.write_bytes(content.replace(b"code of one", b"code of two"))
    assert file.load("one") is None
    file.save("one", b"code of one")
    assert file.load("one") == b"code of one"


def test_an_index_that_cannot_be_read_is_as_none_and_it_is_said(
    file: KernelCacheFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "has_warned", False)
    file.save("one", b"code of one")
    index = tmp_path / file._index_name
    kept = index.read_bytes()
    index.unlink()
    index.mkdir()
    with pytest.warns(UserWarning, match=r"Is a directory.*NUMBA_CACHE_DIR"):
        assert file.load("one") is None
    file.save("two", b"code of two")
    index.rmdir()
    index.write_bytes(kept)
    assert file.load("one") == b"code of one"  # it was not taken for one of another source


def test_a_kernel_is_compiled_though_its_folder_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @compiled
    def doubled(number: int) -> int:
        return 2 * number

    cache: Any = doubled._cache  # type: ignore[attr-defined]
    cache._cache_file._cache_path = str(tmp_path / "file" / "folder")
    (tmp_path / "file").touch()
    cache._impl.locator.get_cache_path = lambda: cache._cache_file._cache_path
    monkeypatch.setattr(kernel_cache, "has_warned", False)
    with pytest.warns(UserWarning, match="Not a directory"):
        assert doubled(3) == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert doubled(3.0) == 6.0  # type: ignore[arg-type]
