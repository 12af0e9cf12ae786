"""The comparison: it runs to its report, resumes, refuses bad files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train.commands.main import main
from train.experiments import executors
from train.experiments.comparison.contestants import CONTESTANTS, settings_of
from train.experiments.comparison.library_run import LibraryRun, learn, world_and_contest
from train.experiments.comparison.plan import FILES, copy_of, load_comparison
from train.experiments.comparison.report import comparison_report, median_of, reached
from train.experiments.comparison.run import Result, result_of, run_comparison
from train.experiments.study import OUTCOME, Study, Watch
from train.settings.task import TaskSettings

pytest.importorskip("stable_baselines3")

TASK = """[[tasks]]
name = "runner, 2x2"
settings = { task = "maze", maze = "2x2", num_goals = 1 }
held_out = ["3x3"]
"""
TINY = f"""
title = "Tiny"
contestants = ["ours", "stable-baselines3"]
{TASK}[space]
num_games = {{ choices = [8] }}
rollout_steps = {{ choices = [8] }}
minibatch_size = {{ choices = [32, 999] }}
learning_rate = {{ low = 1e-3, high = 1e-2, scale = "log" }}
width = {{ choices = [16] }}
[short]
tuning = {{ frames = 128, trials = 2 }}
final = {{ frames = 256, seeds = [0, 1] }}
episodes = 20
[full]
tuning = {{ seconds = 1, trials = 2 }}
final = {{ seconds = 1, seeds = [0] }}
"""
RUNNER = TaskSettings(task="maze", maze="3x3", num_goals=1)


def written(folder: Path, text: str = TINY) -> str:
    path = folder / "tiny.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def unwatched(study: Study) -> Watch:
    return lambda statuses, progress: None


def outcomes(out: Path) -> list[Path]:
    return list(out.rglob(OUTCOME))


# -- a comparison --------------------------------------------------------------------------------


def test_a_small_comparison_runs_to_its_report_and_is_not_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = load_comparison(written(tmp_path))
    outcome = run_comparison(plan, tmp_path / "out", unwatched, workers=0)
    assert len(outcomes(tmp_path / "out")) == sum(plan.count()) == 4 + 4
    # The final settings are those of the trial with the lowest score.
    for (task, name), number in outcome.chosen.items():
        scores = [outcome.scores[task, name, trial][0] for trial in range(2)]
        assert number == int(np.argmin([np.inf if s is None else s for s in scores]))
        final = outcome.finals[task, name, 0]
        assert final is not None
        assert final.settings["learning_rate"] == plan.trials[number]["learning_rate"]
        assert final.settings["minibatch_size"] <= 64  # a rollout
        assert [p["frames"] for p in final.points] == [64.0, 128.0, 192.0, 256.0]
    report = comparison_report(plan, outcome, tmp_path / "out")
    text = report.read_text(encoding="utf-8")
    for word in ("First to each gap", "Stable-Baselines3", "learning_rate", "3x3", "Processor"):
        assert word in text
    assert (report.parent / "curves.png").stat().st_size > 10_000
    with (report.parent / "runs.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 4
    with (report.parent / "trials.csv").open(encoding="utf-8") as file:
        assert [row["chosen"] for row in csv.DictReader(file)].count("True") == 2

    # Repeated: nothing is executed, and the report is the same.
    monkeypatch.setattr(executors, "JobHere", pytest.fail)
    again = run_comparison(plan, tmp_path / "out", unwatched, workers=0)
    assert again == outcome


def test_a_failed_run_is_reported_and_retried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> Any:
        raise RuntimeError("no luck")

    alone = TINY.replace('"ours", "stable-baselines3"', '"ours"')
    plan = load_comparison(written(tmp_path, alone))
    entry = CONTESTANTS["ours"]
    monkeypatch.setitem(CONTESTANTS, "ours", replace(entry, build=broken))
    with pytest.raises(ValueError, match=r"ours failed in every trial on 'runner, 2x2'"):
        run_comparison(plan, tmp_path / "out", unwatched, workers=0)
    errors = list((tmp_path / "out" / "trials").rglob("error.txt"))
    assert len(errors) == 2 and "no luck" in errors[0].read_text(encoding="utf-8")
    monkeypatch.setitem(CONTESTANTS, "ours", entry)
    run_comparison(plan, tmp_path / "out", unwatched, workers=0)
    assert not list((tmp_path / "out" / "trials").rglob("error.txt"))


def test_one_seed_is_one_seed(tmp_path: Path) -> None:
    text = TINY.replace('"ours", "stable-baselines3"', '"ours"').replace(
        "seeds = [0, 1]", "seeds = [0]"
    )
    plan = load_comparison(written(tmp_path, text.replace("trials = 2", "trials = 1")))
    outcome = run_comparison(plan, tmp_path / "out", unwatched, workers=0)
    told = comparison_report(plan, outcome, tmp_path / "out").read_text(encoding="utf-8")
    assert "Seeds: 0;" in told and "Trials: 1," in told


def test_damaged_results_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / OUTCOME).write_text(json.dumps({"points": []}), encoding="utf-8")
    with pytest.raises(ValueError, match=r"repeats that run"):
        result_of(tmp_path)


def test_a_folder_of_an_older_format_is_refused(tmp_path: Path) -> None:
    """Each of its runs was a file, not a folder."""
    (tmp_path / "out" / "trials").mkdir(parents=True)
    (tmp_path / "out" / "trials" / "ours-2x2-seed1000000-0123456789.json").write_text("{}")
    with pytest.raises(ValueError, match=r"trials: not empty, .*; give a new folder"):
        run_comparison(load_comparison(written(tmp_path)), tmp_path / "out", unwatched, workers=0)


@pytest.mark.slow
def test_the_command_runs_in_separate_processes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["compare", written(tmp_path), "--out", str(tmp_path / "out"), "--workers", "2"])
    assert "report: " in capsys.readouterr().out
    assert (tmp_path / "out" / "report" / "report.html").is_file()


# -- what is compared ------------------------------------------------------------------------------


def test_the_shipped_comparison_is_tuned_on_other_mazes_and_fits_its_time() -> None:
    plan = load_comparison("ppo")
    assert plan.seconds() is not None and plan.seconds() <= 45 * 60  # type: ignore[operator]
    for on in load_comparison("ppo", "full").tasks:
        copies = {copy_of(task.maze) for task in (on.task, *on.held_out)}
        assert 3 <= len(on.held_out) <= 5 and len(copies) == 1 + len(on.held_out)
    # Every contestant has the same trials, seeds and budgets, and as many of each.
    alike = {
        name: [
            (job.given | {"contestant": ""}, number)
            for (_, other, number, _), job in plan.trial_jobs().items()
            if other == name
        ]
        for name in plan.contestants
    }
    assert all(each == alike["ours"] for each in alike.values()) and len(alike["ours"]) == 8
    assert {path.stem for path in FILES.glob("*.toml")} == {"ppo"}


def test_times_are_censored_and_medians_need_more_than_half() -> None:
    points = [
        {
            "seconds": s,
            "wall_seconds": s,
            "processor_seconds": s,
            "frames": 10 * s,
            "greedy": gap,
            "sampled": 1.0,
            "greedy_success": 1.0,
            "sampled_success": 1.0,
        }
        for s, gap in ((1.0, 0.2), (2.0, 0.04), (3.0, 0.06))
    ]
    result = Result(points, 9.0, {}, "", "", "")
    assert reached(result, "greedy", 0.05, "seconds") == 2.0
    assert reached(result, "greedy", 0.05, "frames") == 20.0
    assert reached(result, "sampled", 0.05, "seconds") == float("inf")
    assert reached(None, "greedy", 0.05, "seconds") == float("inf")
    never = float("inf")
    assert median_of([1.0, 2.0, 4.0, never, never]) == 4.0
    assert median_of([1.0, 2.0, never, never]) is None


@pytest.mark.parametrize("name", CONTESTANTS)
def test_every_contestant_learns_and_is_evaluated_equally(name: str) -> None:
    if name == "stable-baselines3":
        pytest.importorskip("stable_baselines3")
    drawn = {"num_games": 8, "rollout_steps": 8, "minibatch_size": 32, "width": 16}
    found = learn(LibraryRun(name, RUNNER, drawn, 3, None, 200, 50, True))
    points = found["points"]
    assert [point["frames"] for point in points] == [64, 128, 192]  # a fourth would not fit
    assert all(point["processor_seconds"] > 0 and point["greedy"] >= 0 for point in points)
    world, contest, optimum = world_and_contest(RUNNER, 50)
    assert found["optimal_steps"] == optimum.mean_steps
    # Initial policies are nearly uniform for all observations.
    trainer = CONTESTANTS[name].build(world, settings_of(name, world, drawn), 3)
    drawn_from = trainer.policy(greedy=False).distribution(world.task, contest.starts().games, 0)
    trainer.close()
    assert np.allclose(drawn_from.mean(axis=0), 0.25, atol=0.1)


def test_a_discount_that_is_drawn_is_that_of_every_contestant() -> None:
    many = replace(RUNNER, num_goals=8)
    world, *_ = world_and_contest(many, 50)
    assert settings_of("ours", world, {}).gamma_end == pytest.approx(0.997)
    for name in CONTESTANTS:
        drawn = settings_of(name, world, {"gamma": 0.95})
        assert drawn.gamma == drawn.last_gamma == 0.95


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"ours", "stable-baselines3"', '"ours", "nobody"', "unknown contestant 'nobody'"),
        ('"ours", "stable-baselines3"', '"ours", "ours"', "give one or more, each once"),
        ('held_out = ["3x3"]', 'held_out = ["2x2"]', "is the maze of the comparison"),
        ('held_out = ["3x3"]', "held_out = []", "held_out is empty"),
        ('held_out = ["3x3"]', 'held_out = ["suite:5x5-train"]', "is several mazes"),
        ("num_goals = 1", 'num_goals = 1, colour = "red"', "colour"),
        ('held_out = ["3x3"]', 'held_out = ["3x3", "4x4", "3x3"]', "'3x3' is given twice"),
        ("width = { choices = [16] }", "breadth = { choices = [16] }", "'breadth'"),
        (
            "width = { choices = [16] }",
            "pairs = { choices = [true] }",
            "'pairs' in [space]",
        ),
        ("width = { choices = [16] }", "shared = { choices = [true] }", "'shared' in [space]"),
        ("width = { choices = [16] }", "samples = 3", "'samples' in [space]"),
        ("width = { choices = [16] }", "seed = 3", "'seed' in [space]"),
        ("width = { choices = [16] }", "width = { choices = [0] }", "width=0"),
        (
            "width = { choices = [16] }",
            'width = { choices = ["16"] }',
            "[space]: a value of a wrong",
        ),
        (
            "width = { choices = [16] }",
            "width = { low = 16, high = 17.5 }",
            "[space]: field width: a whole number",
        ),
        ("frames = 128,", "", "give one of the two"),
        ("frames = 256,", "frames = -1,", "above 0"),
        (", trials = 2", "", "field .trials. is missing"),
        (", trials = 2", ", trials = 2, seeds = [7]", "seeds"),
        ("seeds = [0, 1]", "seeds = [0, 1], finalists = 1", "finalists"),
        ("seeds = [0, 1]", "seeds = [0, 1], trials = 1", "trials"),
        ("seeds = [0, 1]", "seeds = [0, 1, 0]", "seeds=[0, 1, 0]; give one or more"),
        ("episodes = 20", "episodes = 20\nheld_out = -1", "held_out=-1; give at least 1"),
        (
            "episodes = 20",
            'episodes = 20\ntasks = ["runner, 2x2", "runner, 2x2"]',
            "give one or more, each once",
        ),
        ("[space]", f"{TASK.replace('runner', 'another')}[space]", "are the same; leave one out"),
        ("seeds = [0, 1]", "seeds = []", "seeds is an empty list"),
        ("seeds = [0, 1]", "seeds = [1000000]", "the first seed of trials"),
        ("episodes = 20", "episodes = 1", "at least 2"),
        ('title = "Tiny"', "", "title"),
        ("[space]", "[spaces]", "spaces"),
    ],
)
def test_bad_files_are_refused_in_a_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    text = TINY.replace(old, new, 1)
    assert text != TINY
    with pytest.raises(ValueError, match=words.replace("[", r"\[")) as refused:
        load_comparison(written(tmp_path, text))
    assert "tiny.toml" in str(refused.value)


def test_an_evader_cannot_be_compared(tmp_path: Path) -> None:
    text = TINY.replace(
        'task = "maze", maze = "2x2", num_goals = 1',
        'task = "chase", role = "evader", maze = "2x2"',
    )
    with pytest.raises(ValueError, match="needs a known optimum"):
        load_comparison(written(tmp_path, text))


def test_no_such_file_or_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match=r"no such comparison file; shipped are ppo"):
        load_comparison("nothing")
    with pytest.raises(ValueError, match="short or full"):
        load_comparison("ppo", "medium")
    with pytest.raises(ValueError, match="unknown clock 'sun'"):
        load_comparison("ppo", clock="sun")
    with pytest.raises(SystemExit) as stopped:
        main(["compare", "ppo", "--workers", "0"])
    assert stopped.value.code == 2 and "workers=0" in capsys.readouterr().err
