"""Ablations run to their reports, of single agents and of self-play."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pandas
import pytest
from command_errors import error_of
from executed_here import executed_here
from test_study_files import ABLATION, SELF_PLAY
from test_sweeps import write

from train.commands.main import main
from train.experiments import figures
from train.experiments.report import report_on
from train.experiments.rows import CURVES, RUNS

NEAR = """[[variants]]
name = "near first"
curriculum = "goal-spread-start"

"""


@pytest.fixture(scope="module")
def ablated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete ablation of four runs."""
    folder = tmp_path_factory.mktemp("ablated")
    file = write(folder / "tiny.toml", ABLATION.replace(NEAR, ""))
    with executed_here():
        main(["ablate", file, "--out", str(folder / "out")])
    return folder


def test_an_ablation_runs_reports_and_is_not_repeated(
    ablated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ablated / "out"
    text = (out / "report" / "report.md").read_text()
    for variant in ("none", "fewer goals first"):
        assert re.search(rf"\| {variant} \| [^|]+ \| 2 \|", text)
    assert "control |" in text and "P(better than none)" in text
    assert "Budget per run: 6,000 frames." in text
    assert "frames on the hardest stage" in text and "below 80 % is marked" in text
    for name in ("final.png", "variants.png"):
        assert (out / "report" / name).stat().st_size > 15_000
    stamps = {p: p.stat().st_mtime_ns for p in out.glob("runs/*/results.json")}
    assert len(stamps) == 4
    main(["ablate", str(ablated / "tiny.toml"), "--out", str(out)])
    assert "4 complete already" in capsys.readouterr().out
    assert {p: p.stat().st_mtime_ns for p in stamps} == stamps
    main(["report", str(out)])
    assert "Tiny" in capsys.readouterr().out
    main(["report", str(out), "--x", "frames", "--log", "--out", str(ablated / "curves")])
    table = (ablated / "curves" / "table.csv").read_text().splitlines()
    names = ["none", "fewer goals first"]
    assert [row.split(",")[0] for row in table[1:]] == names
    rows = pandas.read_csv(out / "report" / "runs.csv")
    assert rows["variant"].to_list() == ["none"] * 2 + ["fewer goals first"] * 2
    assert {"seed", "maze", "frames", "seconds", "shortfall", "frames_to_5"} <= {*rows.columns}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("run.json", "run.json: names no variant; restore it"),
        ("metrics.csv", "has no evaluations; restore its metrics.csv"),
    ],
)
def test_a_report_names_the_run_that_lost_a_file(
    name: str,
    message: str,
    ablated: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = Path(shutil.copytree(ablated / "out", tmp_path / "out"))
    lost = min(out.glob(f"runs/*/{name}"))
    lost.unlink()
    said = error_of(capsys, "report", out)
    assert message in said and lost.parent.name in said


@pytest.mark.parametrize(("asked", "drawn"), [(None, "frames"), ("seconds", "seconds")])
def test_variants_with_budgets_in_frames_are_drawn_over_frames(
    ablated: Path, monkeypatch: pytest.MonkeyPatch, asked: str | None, drawn: str
) -> None:
    units: list[Any] = []
    draw = figures.draw_panels

    def panels(path: Path, grid: Any, unit: str, *rest: Any, **how: Any) -> None:
        units.append(unit)
        draw(path, grid, unit, *rest, **how)

    monkeypatch.setattr(figures, "draw_panels", panels)
    report_on(ablated / "out", **({"unit": asked} if asked else {}))
    assert units == [drawn]


def test_all_variants_are_evaluated_at_the_same_final_difficulty(ablated: Path) -> None:
    out = ablated / "out"
    runs = pandas.read_csv(out / RUNS)
    assert runs["optimal_steps"].nunique() == 1 and runs["random_steps"].nunique() == 1
    curves = pandas.read_csv(out / CURVES)
    # Training starts in easier stages than the task itself.
    taught = runs[runs["variant"] == "fewer goals first"]["run"]
    stages: Any = curves[curves["run"].isin(taught)].groupby("run").first()["stage"]
    assert (stages < 3).all()


@pytest.mark.slow
def test_an_ablation_of_self_play_reports_nash_conv(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(SELF_PLAY)
    with executed_here():
        main(["ablate", str(file), "--out", str(tmp_path / "out")])
    text = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "| latest | control | 2 |" in text and "ratio to latest" in text
    assert (tmp_path / "out" / "report" / "final.png").stat().st_size > 10_000
    for folder in (tmp_path / "out" / "runs").iterdir():
        content = json.loads((folder / "results.json").read_text())
        evaluation = content["evaluation"]
        uniform = content["sampling"] == "uniform"
        expected = content["mixture_nash_conv"][0] if uniform else evaluation["nash_conv"]
        assert evaluation["played_nash_conv"] == expected
