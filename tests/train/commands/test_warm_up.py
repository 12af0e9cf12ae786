"""`pursuit warm-up` fills the cache of kernels, and leaves nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_errors import error_of, run
from numba.core import config

from pursuit.compilation import kernel_cache
from train.commands import warm_up as command


def compiled_in(said: str) -> list[int]:
    """The numbers of functions by command, then of all."""
    return [int(count) for count in re.findall(r"(\d+) functions", said)]


def test_what_is_compiled_is_loaded_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = tmp_path / "cache"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache))  # of the process that compiles
    monkeypatch.setattr(config, "CACHE_DIR", str(cache))
    monkeypatch.setattr(command, "CHASE", {"maze": "2x2"})
    run("warm-up")
    said = capsys.readouterr().out
    assert said.startswith(f"cache: {cache}\n") and "pursuit maze" in said
    first, total = compiled_in(said)
    assert first == total >= len(list(cache.rglob("*.nbc"))) > 0  # a file holds several
    run("warm-up")
    assert compiled_in(capsys.readouterr().out) == [0, 0]
    assert [*tmp_path.iterdir()] == [cache]


@pytest.mark.slow
def test_every_command_runs_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run("warm-up", "--all")
    assert len(compiled_in(capsys.readouterr().out)) == len(command.CHASE | command.OTHERS) + 1
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize("named", [True, False])
def test_a_cache_that_cannot_be_written_is_an_error(
    named: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def nowhere(_: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    (tmp_path / "file").touch()
    if named:
        monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "file" / "cache"))
    else:
        monkeypatch.setattr(kernel_cache, "KernelCache", nowhere)
    told = error_of(capsys, "warm-up")
    assert "NUMBA_CACHE_DIR=" in told and "kernels cannot be saved there" in told
    assert str(tmp_path) in told or not named
