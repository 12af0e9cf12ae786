"""Reports of analyses beside their data, whose code runs only if it is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from pursuit import plugins
from train.commands.main import main

CODE = """
from pathlib import Path

(Path(__file__).parent / "ran").touch()

def tables(data):
    return {"Rows": "| a |\\n|---|\\n" + (data / "rows.csv").read_text()}

def figures(data, out):
    from train.reports.figures import pyplot, save
    figure, axis = pyplot().subplots()
    save(figure, out / "drawn.png")
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(plugins, "_allowed", set())
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "analysis.py").write_text(CODE)
    (folder / "rows.csv").write_text("| 1 |\n")
    return folder


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as exit_:
        main(["report", *arguments])
    error = capsys.readouterr().err
    assert exit_.value.code == 2 and error.count("\n") == 1
    return error


def test_the_code_of_a_folder_must_be_allowed(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = error_of(capsys, "study")
    assert "study: names 'analysis:tables'" in error and "add --allow analysis" in error
    assert not (study / "ran").exists()


def test_tables_and_figures_are_written_beside_no_data(study: Path) -> None:
    before = {path.name for path in study.iterdir()}
    main(["report", "study", "--allow", "analysis"])
    assert {path.name for path in study.iterdir()} - before <= {"ran", "__pycache__"}
    report = Path("report/report.md").read_text()
    assert report.startswith("# Results of study\n\n## Rows\n\n| a |\n|---|\n| 1 |\n")
    assert report.endswith("\n\n![drawn.png](drawn.png)\n")
    assert Path("report/drawn.png").is_file() and Path("report/report.html").is_file()
    (study / "analysis.py").write_text(CODE.replace("drawn.png", "another.png"))
    main(["report", "study", "--allow", "analysis", "--out", "report"])  # its own folder
    report = Path("report/report.md").read_text()
    assert "another.png" in report and "drawn.png" not in report


def test_a_wrong_analysis_is_refused_in_one_line(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def refused(code: str, *more: str) -> str:
        (study / "analysis.py").write_text(code)
        return error_of(capsys, "study", "--allow", "analysis", *more)

    assert "has no function tables; define tables(data)" in refused("")
    assert "cannot be imported (ZeroDivisionError: division by zero)" in refused("1 / 0")
    assert "log=True has no effect: analysis.py makes tables and figures" in refused(CODE, "--log")
    for wrong in ("3", "{'a': 3}"):
        code = f"def tables(data):\n    return {wrong}"
        assert f"tables returned {wrong}; return Markdown" in refused(code)
    Path("report").mkdir()
    Path("report/own.txt").touch()
    assert "contains files that this command did not write" in refused(CODE)
