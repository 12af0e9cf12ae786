"""The tables of results pages are those that the analyses beside their data make.

A table is made again by `docs/results/data/STUDY/analysis.py`, as `pursuit report` does, or by a
test here, or its page says that the runs are not kept.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyses import DATA, PAGES, RESULTS, measured, readme_of, script, tables_of, text_of
from matplotlib.image import imread

from pursuit.mazes.maze import load_maze
from scripted_agents import expected_tour_length
from train.experiments.committed import grouped, read_table
from train.reports.tables import plain_text
from train.runs.parts import contest_of
from train.settings.task import ReacherSettings

ANALYSES = [path.parent.name for path in sorted(DATA.glob("*/analysis.py"))]
STUDIES = {path.stem for path in RESULTS.glob("*.md")} - {"index"}
"""The pages of results; a study without one has a README beside its rows."""
OTHERS = {"thesis": 1, "arm": 1, "curricula": 1, "teams": 1, "index": 1}
"""By page the number of tables that a test here makes, or that hold no results."""
NOT_KEPT = "Runs not kept"
"""What a page says of tables whose data are gone."""
Row = dict[str, Any]


@pytest.mark.parametrize("study", ANALYSES)
def test_a_page_has_the_tables_of_its_analysis(study: str) -> None:
    page, found = text_of(PAGES.get(study, study)), tables_of(study)
    assert found
    for title, table in found.items():
        assert table and f"\n\n{table}\n\n" in f"{page}\n", title


def test_the_front_page_has_the_table_of_its_runs() -> None:
    (table,) = tables_of("front_page").values()
    readme = (RESULTS.parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"\n\n{table}\n\n" in readme


@pytest.mark.parametrize("page", sorted(STUDIES | {PAGES.get(study, study) for study in ANALYSES}))
def test_a_page_says_which_runs_are_not_kept(page: str) -> None:
    """Of a table that does not follow from data: where it says how it was measured, or in the
    README."""
    text, readme = text_of(page), readme_of(page)
    said = measured(page) if page in STUDIES else ""
    said += readme.read_text(encoding="utf-8") if readme.exists() else ""
    made = [tables_of(study) for study in ANALYSES if PAGES.get(study, study) == page]
    known = sum(map(len, made)) + OTHERS.get(page, 0)
    assert known == len(re.findall(r"^\|[-|: ]+\|$", text, re.M)) or NOT_KEPT in said


@pytest.mark.parametrize("study", [name for name in ANALYSES if hasattr(script(name), "figures")])
def test_pictures_are_those_of_the_rows(study: str, tmp_path: Path) -> None:
    script(study).figures(DATA / study, tmp_path)
    drawn = sorted(tmp_path.glob("*.png"))
    assert [path.name for path in drawn] == sorted(
        path.name for path in (DATA / study).glob("*.png")
    )
    for path in drawn:
        assert np.abs(imread(path) - imread(DATA / study / path.name)).mean() < 0.01, path.name


@pytest.mark.parametrize("path", sorted(DATA.glob("*/make_rows.py")), ids=lambda p: p.parent.name)
def test_a_script_that_makes_rows_can_be_imported(path: Path) -> None:
    assert script(path.parent.name, "make_rows").__doc__


def rows(name: str) -> list[Row]:
    return read_table(DATA / f"{name}.csv")


def test_the_studies_of_the_thesis_with_five_seeds() -> None:
    page = text_of("thesis")

    def gaps(study: str, column: str, value: Any, names: str, digits: str) -> str:
        """The gaps of algorithms, each with its digits."""
        own = {row["group"]: row["gap"] for row in rows(f"{study}/table") if row[column] == value}
        shown = zip(names.split(), digits, strict=True)
        return ", ".join(f"{name.upper()} {own[name]:.{n}f}" for name, n in shown)

    tours = (expected_tour_length(load_maze(f"{size}x{size}"), 3) for size in range(3, 10))
    assert f"exact: {', '.join(f'{tour:.2f}' for tour in tours)} (other mazes)" in page
    assert {row["gap"] for row in rows("tabular/table")} == {0.0} and "0 in every seed" in page
    goals = grouped(rows("maze_by_goals/table"), "num_goals", "group")
    ten = [
        "{} {gap:.1f} [{gap_low:.1f}, {gap_high:.1f}]".format(name.upper(), **goals[10, name][0])
        for name in ("ppo", "dqn", "a2c")
    ]
    assert f"| {'; '.join(ten)} |" in page
    one = gaps("reacher_by_joints", "joints", 1, "ddpg a2c td3 ppo sac", "22221")
    two = gaps("reacher_by_joints", "joints", 2, "ppo a2c td3 sac ddpg", "00000")
    assert f"| 1 joint: {one}; 2: {two} |" in page
    best = grouped(rows("reacher_noise_tau/table"), "tau", "group")[0.1, "gaussian"][0]
    former = grouped(rows("thesis/former_values"), "setting")["gaussian, tau 0.0"]
    zero = [row["value"] for row in former]
    interval = "{gap:.2f} [{gap_low:.2f}, {gap_high:.2f}]".format(**best)
    assert f"| tau 0.1: {interval}; tau 0: {min(zero):.1f} to {max(zero):.0f} |" in page


@pytest.mark.slow
def test_inverse_kinematics_are_those_of_the_arm() -> None:
    page = text_of("arm")
    methods = ("thesis' inverse kinematics", "cyclic", "transpose", "pseudo-inverse", "damped")
    for joints in (1, 2, 3, 4, 6, 8):
        contest = contest_of(ReacherSettings(joints=joints), episodes=2000, seed=0)
        steps = {score.name: score.mean_steps for score in contest.baselines()}
        line = [str(joints), f"{steps['optimal']:.2f}"]
        for method in methods:
            more = 100.0 * (steps[method] / steps["optimal"] - 1.0)
            line.append(f"{steps[method]:.2f} ({more:.{int(joints == 1)}f} %)")
        assert f"| {' | '.join([*line, plain_text(steps['random'])])} |" in page


def test_gaps_after_several_budgets_are_those_of_the_runs() -> None:
    text = " ".join(text_of("speed").split())
    runs = rows("budgets/runs")
    learners = {row["learner"] for row in runs}
    assert learners == {"ppo", "a2c", "reinforce", "dqn", "q_learning", "cross_entropy"}
    assert len(runs) == len(learners) * 4 * 5
    assert {row["gap_percent"] for row in runs if row["learner"] != "cross_entropy"} == {0.0}
    searched = grouped((row for row in runs if row["learner"] == "cross_entropy"), "frames")
    ends = {
        frames: [end(row["gap_percent"] for row in own) for end in (min, max)]
        for frames, own in searched.items()
    }
    low, high = ends[4_000_000]
    assert f"needs 4 million (gaps of {low:g} to {high:.2f} %)" in text
    for frames in (2_000_000, 500_000):
        assert "{:,.0f} to {:,.0f} %".format(*ends[frames]) in text
    found = [row["gap_percent"] for row in rows("budgets/cross_entropy_search")]
    best = f"Of {len(found)} random settings at 2 million frames the best has {min(found):,.0f} %"
    assert best in text
