"""What a study keeps in its folder is read completely, or refused with one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from test_study_files import ABLATION, TABLE, load

from train.commands.main import main
from train.experiments.executors import progress_of
from train.experiments.report import write_study
from train.experiments.rows import StudyRows, error_of, read_all
from train.experiments.runs import (
    ERROR,
    LABEL,
    LAYOUT,
    PROGRESS,
    is_folder_of,
    prepare,
    read_label,
    read_layout,
)
from train.experiments.study import Layout


def test_a_dry_run_lists_the_runs_with_what_varies_and_does_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = TABLE.replace("#grid", "max_steps = [50, 60]")
    sweep = load(tmp_path / "s.toml", "table", text)
    out = tmp_path / "out"
    main(["sweep", str(tmp_path / "s.toml"), "--out", str(out), "--dry-run"])
    assert not out.exists()
    prepare(sweep, out)
    folder = out / "runs" / sweep.runs[0].name
    (folder / "checkpoint.pt").write_bytes(b"")
    capsys.readouterr()
    main(["sweep", str(tmp_path / "s.toml"), "--out", str(out), "--dry-run"])
    first, second, last = capsys.readouterr().out.splitlines()
    assert first.split() == ["interrupted", "max_steps=50", "seed=0", str(folder)]
    assert second.split()[:3] == ["new", "max_steps=60", "seed=0"]
    assert last == f"2 runs into {out} (1 interrupted, 1 new); nothing was done"
    short = ABLATION.replace("seeds = [0, 1]", "seeds = [0]")
    (tmp_path / "a.toml").write_text(short)
    main(["ablate", str(tmp_path / "a.toml"), "--out", str(out / "none"), "--dry-run"])
    first, second, _, reach, last = capsys.readouterr().out.splitlines()
    assert "variant=none seed=0" in first and "variant=near first" in second and "3 new" in last
    assert "p < 0.05 cannot be reached: with 1 seeds" in reach
    for version, folder in ((), ""), (("--version", "short"), ""), (("--version", "full"), "-full"):
        main(["ablate", "opponent-epsilon", "--dry-run", *version])
        assert f" into ablations/opponent-epsilon{folder} (" in capsys.readouterr().out


# -- what a sweep keeps ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("[]", "a table expected, a list found"),
        ("{}", "field 'title' is missing"),
        ('{"title": 3}', "field title: a string expected"),
        ('{"title": "a", "runs": [1]}', "field runs[0]: a string expected"),
        ('{"title": "a", "group": null}', "field group: a list expected"),
        ("{", "damaged, not JSON"),
    ],
)
def test_a_damaged_plan_is_one_line(
    content: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = load(tmp_path / "s.toml", "table", TABLE)
    prepare(sweep, tmp_path / "out")
    (tmp_path / "out" / LAYOUT).write_text(content)
    with pytest.raises(SystemExit) as exit_:
        main(["report", str(tmp_path / "out")])
    told = capsys.readouterr().err
    assert exit_.value.code == 2 and len(told.splitlines()) == 1
    assert said in told and LAYOUT in told
    prepare(sweep, tmp_path / "out")  # the next sweep repairs it
    assert read_layout(tmp_path / "out").title == "s"


@pytest.mark.parametrize(
    ("analysis", "control", "need"),
    [
        ("nonsense", None, "summary"),
        ("libraries", None, "summary"),
        ("summary", "a", "variants or paired"),
    ],
)
def test_an_analysis_that_does_not_fit_is_refused(
    analysis: str, control: str | None, need: str, tmp_path: Path
) -> None:
    row = {"kind": "single", "budget_frames": 9}
    rows = StudyRows(Layout("t", analysis=analysis, control=control), [row], [row])
    with pytest.raises(ValueError, match=f"analysis='{analysis}' of 't'; such runs need {need}"):
        write_study(rows, tmp_path, {})


def test_a_plan_of_a_later_version_is_not_read(tmp_path: Path) -> None:
    sweep = load(tmp_path / "s.toml", "table", TABLE)
    prepare(sweep, tmp_path / "out")
    plan = tmp_path / "out" / LAYOUT
    plan.write_text(plan.read_text().replace('"format": 2', '"format": 99'))
    with pytest.raises(ValueError, match="has format 99, this version of pursuit reads 1 to 2"):
        read_all(tmp_path / "out")
    with pytest.raises(ValueError, match="has format 99"):
        prepare(sweep, tmp_path / "out")
    plan.unlink()  # and its runs are there: it is written again
    assert is_folder_of(sweep, tmp_path / "out")


def test_damaged_labels_results_errors_and_progress_are_no_tracebacks(tmp_path: Path) -> None:
    sweep = load(tmp_path / "s.toml", "table", TABLE)
    prepare(sweep, tmp_path / "out")
    folder = tmp_path / "out" / "runs" / sweep.runs[0].name
    (folder / LABEL).write_text('{"maze": {"a": 1}}')
    with pytest.raises(ValueError, match=r"run\.json: .* expected, a table found"):
        read_label(folder)
    (folder / LABEL).unlink()
    (folder / "results.json").write_text(json.dumps({"frames": 3, "seconds": "many"}))
    with pytest.raises(ValueError, match=r"results\.json: .*; delete it"):
        read_all(tmp_path / "out")
    (folder / "results.json").unlink()
    for content in (b"", b"\xff\xfe\n", b"boom\nmore"):
        (folder / ERROR).write_bytes(content)
        assert error_of(folder) in ("unknown", "\ufffd\ufffd", "boom")
        assert [row["status"] for row in read_all(tmp_path / "out").everything] == ["failed"]
    for text, share in (("0.25", 0.25), ("nan", 0.0), ("1e99", 1.0), ("x", 0.0), ("-3", 0.0)):
        (folder / PROGRESS).write_text(text)
        assert progress_of(folder) == share
