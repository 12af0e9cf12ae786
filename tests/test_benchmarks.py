"""Every benchmark can still be begun: what it imports exists, and its help names its options; the
tool for pictures of pages, too."""

from __future__ import annotations

import importlib.util
import runpy
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[1] / "tools"
FILES = sorted((TOOLS / "benchmarks").glob("bench_*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_benchmark_imports_and_has_a_main(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(path.parent))  # as where it is run
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert callable(module.main)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "the following arguments are required: out"),
        (["--help"], "further pages"),
        (["out", "a/x/page.html", "b/x/page.html"], "have the same folder and name; give one"),
    ],
)
def test_pictures_of_pages_are_not_begun_with_wrong_arguments(
    given: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["screenshots.py", *given])
    with pytest.raises(SystemExit):
        runpy.run_path(str(TOOLS / "screenshots.py"), run_name="__main__")
    assert said in "".join(capsys.readouterr()) and not [*tmp_path.iterdir()]
