"""Folders of earlier versions are opened, evaluated, resumed and reported.

`tools/old_folders.py` wrote the archives. An evaluation gives the numbers of the version that
trained: policies are the same, and their scores are exact or of the same episodes.
"""

from __future__ import annotations

import csv
import json
import re
import tarfile
from pathlib import Path
from typing import Any

import pytest

from train.commands.main import main
from train.kinds import open_run, read_settings, resume
from train.runs.folder import (
    CHECKPOINT,
    CONFIG,
    RESULTS,
    RESULTS_FORMAT,
    SELF_PLAY,
    load_results,
    read_metrics,
)

ARCHIVES = sorted((Path(__file__).parents[1] / "old_folders").glob("*.tar.xz"))


def names_in(archive: Path) -> list[str]:
    with tarfile.open(archive) as tar:
        return sorted({Path(name).parts[0] for name in tar.getnames()})


def runs_in(archive: Path) -> list[str]:
    with tarfile.open(archive) as tar:
        files = [Path(name) for name in tar.getnames()]
    return sorted(p.parts[0] for p in files if p.name == CHECKPOINT and len(p.parts) == 2)


CASES = [pytest.param(path, run, id=run) for path in ARCHIVES for run in runs_in(path)]
STUDIES = [
    pytest.param(path, name, id=name)
    for path in ARCHIVES
    for name in ("sweep", "ablate", "compare")
]


def extracted(archive: Path, name: str, folder: Path) -> Path:
    with tarfile.open(archive) as tar:
        chosen = [one for one in tar if Path(one.name).parts[0] == name]
        tar.extractall(folder, chosen, filter="data")
    return folder / name


def evaluation(folder: Path, out: Path) -> dict[str, Any]:
    main(["evaluate", str(folder), "--episodes", "20", "--out", str(out)])
    return json.loads(out.read_text())


def test_there_are_archives() -> None:
    assert ARCHIVES and len(CASES) > 20


@pytest.mark.slow
@pytest.mark.parametrize(("archive", "name"), CASES)
def test_a_run_is_opened_evaluated_and_resumed(archive: Path, name: str, tmp_path: Path) -> None:
    folder = extracted(archive, name, tmp_path)
    kind, settings = read_settings(folder)
    rows = read_metrics(folder)
    run = open_run(folder)
    assert run.trainee.frames == rows[-1]["frames"] > 0
    assert run.lock is not None
    run.lock.release()
    half = name.endswith("_half")
    if not half:
        kept = load_results(folder)
        whole = kind != SELF_PLAY or hasattr(settings.task, "game")
        if whole:
            found = evaluation(folder, tmp_path / "evaluation.json")
            check_equal(kept["evaluation"], found["evaluation"])
        (folder / "results.json").unlink()
    again = resume(folder, kind)
    again.train()
    content = again.results(20)
    assert again.progress == 1.0 and again.trainee.frames >= settings.frames
    assert read_metrics(folder)[: len(rows)] == rows or not half
    if not half:
        check_equal(kept["evaluation"], content["evaluation"])
    again.lock.release()  # type: ignore[union-attr]
    main(["report", str(folder), "--out", str(tmp_path / "report")])
    assert (tmp_path / "report" / "report.md").stat().st_size > 100


def check_equal(kept: dict[str, Any], found: dict[str, Any]) -> None:
    """All numbers that both evaluations have: only results have those against other policies."""
    both = {*kept} & {*found}
    assert len(both) >= 5
    for name in both:
        if isinstance(kept[name], float):
            assert found[name] == pytest.approx(kept[name], rel=1e-6, abs=1e-9), name
        else:
            assert found[name] == kept[name], name


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "report" / "runs.csv").open(newline="") as lines:
        return list(csv.DictReader(lines))


@pytest.mark.parametrize(("archive", "name"), STUDIES)
def test_a_study_is_reported_again(
    archive: Path, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = extracted(archive, name, tmp_path)
    before = rows_of(folder)
    file = extracted(archive, f"{name}.toml", tmp_path)
    main(["report", str(folder)])
    after = rows_of(folder)
    assert {row.pop("format") for row in after} == {str(RESULTS_FORMAT)}
    assert after == [{k: v for k, v in row.items() if k != "format"} for row in before]
    main([name, str(file), "--out", str(folder)])
    assert "4 complete already" in capsys.readouterr().out


def nearly(value: Any) -> Any:
    """A value of a JSON file with numbers to six places: linear programs differ by processor."""
    if isinstance(value, dict):
        return {name: nearly(own) for name, own in value.items()}
    if isinstance(value, list):
        return [nearly(own) for own in value]
    return round(value, 6) + 0.0 if isinstance(value, float) else value


@pytest.mark.parametrize("archive", ARCHIVES)
def test_a_league_is_played_again_over_its_folder(archive: Path, tmp_path: Path) -> None:
    folder, pair = (extracted(archive, name, tmp_path) for name in ("league", "pair"))
    before = json.loads((folder / "league.json").read_text())
    main(["league", str(pair), "astar", "random", "--games", "20", "--out", str(folder)])
    after = json.loads((folder / "league.json").read_text())
    for name in ("payoff", "chaser_ratings", "nash"):
        assert nearly(before[name]) == nearly(after[name]), name


def test_every_key_of_results_is_documented() -> None:
    """The archives have runs of all kinds."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "files.md").read_text()
    known = set(re.findall(r"`(\w+)`", page.replace("*NAME*\\_vs\\_uniform", "`NAME_vs_uniform`")))
    for archive in ARCHIVES:
        with tarfile.open(archive) as tar:
            for name in tar.getnames():
                file = tar.extractfile(name) if Path(name).name == RESULTS else None
                content = json.load(file) if file is not None else {"evaluation": {}}
                names = {"player_0": "NAME", "player_1": "NAME"}
                names |= {"equilibrium": "astar", "random": "astar"}
                for key in [*content, *content["evaluation"]]:
                    for own, shown in names.items():
                        key = re.sub(rf"\b{own}(?=_|$)|(?<=_){own}$", shown, key)
                    assert key in known, f"{name}: {key}"


def test_the_configuration_of_a_run_names_its_version_and_format() -> None:
    for archive in ARCHIVES:
        with tarfile.open(archive) as tar:
            file = tar.extractfile(f"ppo_maze/{CONFIG}")
            assert file is not None and json.load(file)["format"] > 0
