"""Replication: claims are decided by tests of rows, corrected over all cells of a page."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import thesis_table
from executed_here import executed_here
from scipy.stats import rankdata

from pursuit.mazes.maze import load_maze
from scripted_agents import expected_tour_length
from train.commands.main import main
from train.experiments import claims as claims_
from train.experiments import tuning
from train.experiments.claims import (
    CellTest,
    Decision,
    comparison_test,
    corrected,
    decide,
    diverged,
    part_of,
    threshold_test,
    worse_by,
)
from train.experiments.claims_page import decide_all, study_part, verdicts, write_replication
from train.experiments.executors import run_locally
from train.experiments.expansion import multiply_out
from train.experiments.replication import (
    changed_rules,
    keep_rules,
    load_replication,
    mazes_by_size,
    replication_stages,
    runs_of_study,
    with_own_mazes,
)
from train.experiments.rows import StudyRows, curve_measures
from train.experiments.stages import carry_out
from train.experiments.statistics import permutation_p
from train.experiments.study import PARTS, Claim, Layout, StudyFile, read_file
from train.experiments.tuning import last_trials, tuning_search_of
from train.files import read_json

Row = dict[str, Any]
VARYING = ("algorithm", "maze", "joints")


def ran(
    seed: int, gap: float, unsolved: float = 0.0, lengths: tuple[float, ...] = (), **row: object
) -> Row:
    """A run with these results."""
    plain = {"seed": seed, "optimality_gap": gap, "unsolved_share": unsolved, "max_steps": 200}
    own = {"frames": 10**6, "algorithm": "ppo", **plain, **row}
    evaluations = [{"frames": n, "mean_steps": length} for n, length in enumerate(lengths)]
    return {**curve_measures(own, evaluations), **own}


def test_a_run_diverges_if_most_starts_are_unsolved_and_lengths_do_not_fall() -> None:
    flat, falling = (200.0,) * 9, (200.0,) * 6 + (200.0, 190.0, 180.0)
    assert diverged(ran(0, 9.0, 0.6, flat))
    assert not diverged(ran(0, 9.0, 0.6, falling))
    assert not diverged(ran(0, 9.0, 0.5, flat))  # more than half, not half
    early = (200.0, 150.0, 140.0) + (140.0,) * 6  # it fell, but not in the last third
    assert diverged(ran(0, 9.0, 0.6, early))


LOWER = Claim("", "lower", {"algorithm": "ours"}, [{"algorithm": "rival 0"}])


def verdicts_of(claims: Sequence[Claim], runs: Sequence[Row]) -> list[str]:
    """The decisions on all cells of a page with only these claims."""
    found = [cell for claim in claims for cell in decide(claim, runs, VARYING, 0)]
    return [cell.verdict for cell in corrected(found)]


@cache
def p_of_ranks(ours: tuple[float, ...], theirs: tuple[float, ...]) -> float:
    return permutation_p([ours], [theirs])


@pytest.fixture
def fast_p(monkeypatch: pytest.MonkeyPatch) -> None:
    """`permutation_p` with a cache, as p depends only on the order of the values."""

    def p_of(ours: Sequence[Sequence[float]], theirs: Sequence[Sequence[float]]) -> float:
        ranks = rankdata([*ours[0], *theirs[0]])
        return p_of_ranks(tuple(ranks[: len(ours[0])]), tuple(ranks[len(ours[0]) :]))

    monkeypatch.setattr(claims_, "permutation_p", p_of)


def study_of(
    rng: np.random.Generator, rivals: int, cells: int, effect: float
) -> tuple[list[Claim], list[Row]]:
    """Five runs of each of several algorithms in some cells, log-normal, and a claim on them.

    The logarithms of ours are lower by `effect` standard deviations.
    """
    than = [{"algorithm": f"rival {n}"} for n in range(rivals)]
    claims = [Claim("", "lower", {"algorithm": "ours"}, than)]
    runs = []
    for name in ("ours", *(other["algorithm"] for other in than)):
        for joints in range(1, cells + 1):
            gaps = np.exp(rng.normal(-effect * (name == "ours"), size=5))
            label = {"algorithm": name, "joints": joints}
            runs += [ran(s, g, **label) for s, g in enumerate(gaps)]
    return claims, runs


@pytest.mark.parametrize(
    ("rivals", "cells"), [(1, 1), (2, 1), pytest.param(3, 2, marks=pytest.mark.slow)]
)
def test_studies_without_an_effect_are_decided_in_one_of_twenty_at_most(
    rivals: int, cells: int, fast_p: None
) -> None:
    rng, studies = np.random.default_rng(0), 300
    false = 0
    for _ in range(studies):
        verdicts = verdicts_of(*study_of(rng, rivals, cells, 0.0))
        assert len(verdicts) == cells
        false += set(verdicts) != {"undecided"}
    # At most 5 % in the long run; a fixed rule of 5 % would be above this in one of 700 cases.
    assert false / studies <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / studies)
    assert set(verdicts_of(*study_of(rng, rivals, cells, 12.0))) == {"confirmed"}
    assert set(verdicts_of(*study_of(rng, rivals, cells, -12.0))) == {"refuted"}


@pytest.mark.parametrize("cells", [1, 2])
def test_thresholds_without_an_effect_are_decided_in_one_of_twenty_at_most(cells: int) -> None:
    # The medians of the cells lie at the threshold; one of the distributions is far from normal.
    claim = Claim("", "within", {"joints": list(range(cells))}, to="scripted", percent=5.0)
    rng, studies = np.random.default_rng(0), 300

    def verdicts(values: np.ndarray) -> list[str]:
        runs = [
            ran(seed, 0.0, joints=joints, mean_steps=100.0 + value, scripted_steps=100.0)
            for joints, own in enumerate(values)
            for seed, value in enumerate(own)
        ]
        return verdicts_of([claim], runs)

    false = 0
    for _ in range(studies):
        skewed = np.exp(rng.normal(size=(cells, 8)) * 3.0)
        false += set(verdicts(5.0 * skewed)) != {"undecided"}
    assert false / studies <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / studies)
    assert verdicts(np.zeros((cells, 8))) == ["confirmed"] * cells
    assert verdicts(np.full((cells, 8), 6.0)) == ["refuted"] * cells
    assert verdicts(np.zeros((cells, 5))) == ["undecided"] * cells  # 2 of 2^5 is above 0.05


def test_the_search_has_the_fixed_settings_of_its_studies() -> None:
    """Else a study with the defaults, the first trial, would have settings of no trial."""
    plan = load_replication()
    assert plan.tuning is not None and any(study.tuned for study in plan.studies)
    drawn = {name for space in plan.tuning.space.values() for name in space}
    for study in plan.studies:
        if study.tuned:
            fixed = read_file(str(study.sweep), "sweep", StudyFile)[1].settings
            own = {name: value for name, value in fixed.items() if name in drawn}
            assert own.items() <= plan.tuning.settings.items(), study.id


def test_a_claim_of_two_cells_has_two_verdicts() -> None:
    runs = []
    for joints, best in ((1, "rival 0"), (2, "ours"), (3, "")):
        for name in ("ours", "rival 0"):
            label = {"algorithm": name, "joints": joints}
            gaps = [0.1 * seed + 10.0 * (name != best and best != "") for seed in range(6)]
            runs += [ran(s, g, **label) for s, g in enumerate(gaps)]
    verdicts = verdicts_of([LOWER], runs)
    assert verdicts == ["refuted", "confirmed", "undecided"]


def test_all_cells_of_a_page_are_corrected_together() -> None:
    least = CellTest(2 / 252, True, 2 / 252)
    assert [d.verdict for d in corrected([Decision(test=least)] * 6)] == ["confirmed"] * 6
    assert [d.verdict for d in corrected([Decision(test=least)] * 7)] == ["undecided"] * 7
    # Cells that no result could decide are not counted, nor are those without a test.
    idle = [Decision(test=threshold_test([True] * 5)), Decision(note="no complete runs")]
    assert [d.verdict for d in corrected([Decision(test=least)] * 6 + idle)][:6] == [
        "confirmed"
    ] * 6


def test_mazes_of_a_suite_are_strata_of_one_cell() -> None:
    def runs_in(maze: str, base: float) -> list[Row]:
        found = []
        for name, more in (("ours", 0.0), ("rival 0", 0.5)):
            label = {"algorithm": name, "maze": maze}
            gaps = [base + 0.01 * seed + more for seed in range(4)]
            found += [ran(s, g, **label) for s, g in enumerate(gaps)]
        return found

    suite = [*runs_in("suite:5x5-test/0", 0.0), *runs_in("suite:5x5-test/1", 9.0)]
    (cell,) = decide(LOWER, suite, VARYING, 0)
    assert [len(group.mazes) for group in cell.groups] == [2, 2]
    assert cell.groups[0].cell["maze"] == "suite:5x5-test"
    assert cell.test.p < 0.005  # two mazes: 2 of 70 * 70 splits; not stratified it is 0.4
    assert len(decide(LOWER, [*runs_in("5x5", 0.0), *runs_in("7x7", 9.0)], VARYING, 0)) == 2
    other = [run for run in suite if run["maze"][-1] == "0" or run["algorithm"] == "ours"]
    assert "compare the same mazes" in decide(LOWER, other, VARYING, 0)[0].note


def test_cells_without_enough_frames_or_runs_are_not_tested() -> None:
    runs = study_of(np.random.default_rng(0), 1, 1, 0.0)[1]
    (few,) = decide(LOWER, runs, VARYING, 2 * 10**6)
    assert few.verdict == "undecided" and few.note == (
        "runs of 1,000,000 frames; 2,000,000 are needed"
    )
    assert decide(LOWER, runs[:5], VARYING, 0)[0].note == "no complete runs"
    assert math.isnan(decide(LOWER, runs[:5], VARYING, 0)[0].test.p)


def test_a_run_without_the_value_of_a_rule_decides_nothing() -> None:
    runs = [ran(seed, 0.1) for seed in range(5)]
    (cell,) = decide(Claim("", "part_above", {"algorithm": "ppo"}, percent=50.0), runs, VARYING, 0)
    assert cell.verdict == "undecided" and "solved_gap is not known" in cell.note


def test_settings_that_a_claim_does_not_fix_are_separate_cells() -> None:
    def run(seed: int, maze: str, gap: float, algorithm: str = "ours") -> Row:
        return ran(seed, gap, maze=maze, algorithm=algorithm)

    runs = [run(seed, "3x3", 0.0) for seed in range(6)]
    runs += [run(seed, "5x5", 0.2) for seed in range(6)]  # a later one of the same seed
    runs += [run(seed, maze, 0.1, "rival 0") for seed in range(6) for maze in ("5x5", "3x3")]
    assert verdicts_of([LOWER], runs) == ["confirmed", "refuted"]
    assert verdicts_of([LOWER], [r for r in runs if r["maze"] == "3x3"]) == ["confirmed"]
    three = [*runs, run(0, "7x7", 0.1, "rival 0")]
    assert "2 cells are compared with 3" in decide(LOWER, three, VARYING, 0)[0].note


@pytest.mark.parametrize("role", ["evader", "evader_0", "evader_12"])
def test_longer_episodes_are_better_only_for_evaders(role: str) -> None:
    evader = ran(0, -0.1, role=role, mean_steps=180.0)
    assert worse_by(evader, "limit") == pytest.approx(10.0)
    chaser = ran(
        0, 0.1, role=role.replace("evader", "chaser"), mean_steps=11.0, scripted_steps=12.0
    )
    assert worse_by(chaser, "scripted") < 0


def test_a_gap_is_objective_gap_and_loops_and_the_rest() -> None:
    run = ran(0, 0.10, solved_gap=0.04, objective_gap=0.01)
    parts = {part: part_of(run, part) for part in PARTS}
    assert parts == pytest.approx({"objective": 10.0, "loops": 60.0, "learning": 30.0})
    assert part_of(ran(0, 0.0, solved_gap=0.0, objective_gap=0.0), "objective") == 0.0


def test_the_table_of_states_is_its_formula_with_two_factors_swapped(tmp_path: Path) -> None:
    for row in thesis_table.states_table():
        assert row["formula 3.2, two factors swapped"] == row["table 3.1"] != row["formula 3.2"]
    numbers = [row["formula 3.2"] for row in thesis_table.states_table()]
    assert numbers[0] == "828" and numbers[2] == "58,100"
    assert len(thesis_table.tours_table({})) == len(thesis_table.TOURS)
    (tmp_path / "mine.txt").write_text(load_maze("3x3").to_text())
    (tmp_path / "readme.md").write_text("no maze")
    (row,) = thesis_table.tours_table(mazes_by_size(tmp_path))
    assert row["optimal mean tour, exact"] == f"{expected_tour_length(load_maze('3x3'), 3):.3f}"


def test_an_evaders_settings_are_ranked_by_their_gaps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        ran(seed, gap, algorithm="dqn", role="evader", trial=number, variant=None)
        | {"run": f"{number}-{seed}", "status": "complete"}
        for number, gap in enumerate((-0.5, -0.01, -0.2))
        for seed in range(2)
    ]
    (tmp_path / "tuning").mkdir(parents=True)
    (tmp_path / "tuning" / "sweep.json").touch()
    search = StudyRows(Layout("", group=["algorithm"]), everything=rows)
    monkeypatch.setattr(tuning, "read_all", lambda folder: search)
    trials = last_trials(tmp_path)
    assert [row["chosen"] for row in trials] == [False, True, False]
    ranked = sorted(trials, key=lambda row: float(row["score"]))
    assert [row["trial"] for row in ranked] == [1, 2, 0]
    rows[2]["status"] = "failed"  # a trial that is not complete has no score
    assert [row["chosen"] for row in last_trials(tmp_path)] == [False, False, True]


@pytest.mark.parametrize("name", ["thesis/former_", "optimum/"])
def test_the_verdicts_of_the_committed_pages_follow_from_their_values(name: str) -> None:
    start = f"{Path(__file__).parents[3] / 'docs' / 'results' / 'data'}/{name}"
    runs: dict[tuple[str, str, str], dict[str, list[dict[str, str]]]] = {}
    with open(f"{start}values.csv", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            cell = runs.setdefault((row["study"], row["claim"], row["cell"]), {})
            cell.setdefault(row["rival"], []).append(row)
    with open(f"{start}claims.csv", encoding="utf-8") as file:
        told = [row for row in csv.DictReader(file) if row["p"]]
    tests = []
    for row, groups in zip(told, runs.values(), strict=True):
        if row["rule"] in ("lower", "higher"):
            sign = 1.0 if row["rule"] == "lower" else -1.0
            values = [[[sign * float(run["value"]) for run in own]] for own in groups.values()]
            tests.append(comparison_test(values[0], values[1:]))
        else:
            tests.append(threshold_test([run["meets"] == "True" for run in groups["0"]]))
    found = corrected([Decision(test=test) for test in tests])
    assert [cell.verdict for cell in found] == [row["verdict"] for row in told]
    assert [cell.test.p for cell in found] == pytest.approx([float(row["p"]) for row in told])


def test_user_defined_mazes_replace_shipped_ones_of_the_same_size(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder"):
        mazes_by_size(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="contains no maze file"):
        mazes_by_size(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).write_text(load_maze("5x5").to_text())
    with pytest.raises(ValueError, match="are both 5x5; keep one"):
        mazes_by_size(tmp_path)
    file = StudyFile(settings={"maze": "5x5"}, grid={"maze": ["3x3", "7x7-tree"]})
    changed = with_own_mazes(file, {"5x5": "/mine", "3x3": "/other"})
    assert changed.settings == {"maze": "/mine"}
    assert changed.grid == {"maze": ["/other", "7x7-tree"]}
    with pytest.raises(ValueError, match="has 5x5, but not 3x3"):
        with_own_mazes(file, {"5x5": "/mine"})
    assert with_own_mazes(file, {}) == file


def test_settings_that_were_found_go_to_their_algorithm_alone() -> None:
    file = StudyFile(
        settings={"task": "maze", "maze": "3x3", "frames": 1000, "gamma": 0.98},
        grid={"algorithm": ["ppo", "a2c"]},
    )
    study = multiply_out(file, "tiny", {("ppo", ""): {"gamma": 0.9}})
    found = {run.settings.algorithm: run.settings.hyper.gamma for run in study.runs}
    assert found == {"ppo": 0.9, "a2c": 0.98}


def test_every_algorithm_has_the_same_search_budget(tmp_path: Path) -> None:
    plan = load_replication()
    assert plan.tuning is not None
    search = tuning_search_of(plan.tuning, "short", tmp_path)
    trials = search.study(0).runs
    count = {name: 0 for name in plan.tuning.space}
    for run in trials:
        count[run.settings.algorithm] += 1
    assert len(set(count.values())) == 1
    assert len({run.settings.seconds for run in trials}) == 1
    shipped = [run for run in trials if set(run.label) == {"algorithm", "maze", "trial"}]
    assert len(shipped) == 3 * len(plan.tuning.mazes)
    for study in plan.studies:  # on mazes and seeds of no study
        if study.id != "figure-2.2":
            runs = runs_of_study(study, plan, search).runs
            used = {run.settings.task.maze for run in runs if hasattr(run.settings.task, "maze")}
            assert not used & set(plan.tuning.mazes)
            assert not {run.settings.seed for run in runs} & {run.seed for run in trials}


@pytest.mark.slow
@pytest.mark.parametrize("version", ["short", "full"])
@pytest.mark.parametrize("file", ["thesis", "optimum"])
def test_every_claim_is_about_runs_that_its_study_has(file: str, version: str) -> None:
    plan = load_replication(version=version, file=file)
    assert len({study.id for study in plan.studies}) == len(plan.studies)
    for study in plan.studies:
        assert runs_of_study(study, plan).runs
    study.claims[0].of["maze"] = "1x1"
    with pytest.raises(ValueError, match=r"'maze': '1x1'.* has no such run"):
        runs_of_study(study, plan)


def test_rules_are_saved_and_changes_are_reported(tmp_path: Path) -> None:
    plan = load_replication(["figure-2.2"])
    keep_rules(plan, tmp_path)
    study = plan.studies[0]
    assert changed_rules(study, tmp_path) == ""
    written = read_json(tmp_path / "rules.json")["figure-2.2"]["written"]
    study.claims[0].percent = 50.0
    keep_rules(plan, tmp_path)  # a second start does not overwrite them
    assert f"after its first run ({written})" in changed_rules(study, tmp_path)


def test_the_page_has_claim_rule_verdict_and_evidence(tmp_path: Path) -> None:
    plan = load_replication(["figure-4.4"])
    study = plan.studies[-1]
    more: dict[str, Any] = {
        "role": "chaser",
        "maze": "5x5",
        "machine": "M",
        "commit": "abcdefgh",
        "seconds": 9.0,
    }
    runs = [ran(seed, 0.01, mean_steps=10.1, scripted_steps=10.0, **more) for seed in range(9)]
    rows = StudyRows(Layout(""), runs, runs + 21 * [{}], varying=["algorithm", "maze"])
    found = [d for d in decide_all(plan, {study.id: rows}) if d.claim is study.claims[0]]
    text = "\n".join([*verdicts(found), *study_part(study, found, tmp_path, {study.id: rows})])
    assert "**9 of 30 runs are complete.**" in text
    assert "more than half of all runs end no more than 2 % worse than the scripted" in text
    assert "| 9 of 9 |" in text and "| confirmed | for | 0.0039 |" in text
    path = write_replication(plan, tmp_path)  # without any run
    claims = (path.parent / "claims.csv").read_text().splitlines()
    assert len(claims) == 1 + sum(len(study.claims) for study in plan.studies)
    assert (path.parent / "runs.csv").exists()
    assert path.with_suffix(".html").exists()


def test_the_command_lists_its_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    main(["reproduce", "figure-2.2", "--dry-run", "--out", out])
    assert re.search(r"figure-2.2 +22 runs, 0 complete; 5 s each", capsys.readouterr().out)
    assert not (tmp_path / "out").exists()
    main(["reproduce", "--list"])
    assert "figure-4.8" in capsys.readouterr().out
    for arguments, told in (
        (["figure-9"], "give all, or some of figure-2.2"),
        (["all", "--version", "long"], "unknown version 'long'"),
        (["figure-4.2-settings"], "is part of full only"),
        (["all", "--mazes", str(tmp_path / "no")], "no such folder"),
        (["all", "--page", "--out", out], "leave out --page to start"),
    ):
        with pytest.raises(SystemExit) as exit_:
            main(["reproduce", *arguments])
        assert exit_.value.code == 2
        assert told in capsys.readouterr().err


TINY = """
title = "Tiny"
[tuning]
mazes = ["2x2", "3x3"]
settings = { task = "maze", num_goals = 1 }
[tuning.short]
samples = 2
seconds = 0.3
[tuning.full]
samples = 2
seconds = 1.0
[tuning.space.q_learning]
learning_rate = { low = 0.1, high = 0.9 }
[[studies]]
id = "one"
title = "A table"
thesis = "It learns."
differs = "Nothing."
sweep = "SWEEP"
tuned = true
[[studies.claims]]
text = "A table finds the optimum."
rule = "within"
of = { maze = "2x2" }
"""


@pytest.mark.slow
def test_a_replication_from_the_search_to_the_page(tmp_path: Path) -> None:
    sweep = tmp_path / "tiny.toml"
    sweep.write_text(
        '[settings]\ntask = "maze"\nnum_goals = 1\nalgorithm = "q_learning"\nmaze = "2x2"\n'
        "[short]\nseeds = [0, 1, 2, 3, 4, 5]\nsettings = { frames = 10000 }\n"
        "[full]\nseeds = [0, 1, 2, 3, 4, 5]\n"
    )
    file = tmp_path / "studies.toml"
    file.write_text(TINY.replace("SWEEP", str(sweep)))
    plan, out = load_replication(file=str(file)), tmp_path / "out"
    told: list[str] = []

    @executed_here()
    def execute() -> list[dict[str, str]]:
        done = carry_out(
            replication_stages(plan, out),
            lambda study, folder: run_locally(study, folder, 1, lambda *_: None),
            told.append,
        )
        return [statuses for _, statuses in done]

    assert {status for each in execute() for status in each.values()} == {"complete"}
    assert {row["algorithm"] for row in last_trials(out) if row["chosen"]} == {"q_learning"}
    text = write_replication(plan, out).read_text()
    assert "6 of 6 runs are complete" in text and "| confirmed | for |" in text
    with (out / "report" / "runs.csv").open() as rows:
        assert len(list(csv.DictReader(rows))) == 6
    assert (out / "report" / "one.png").exists()
    before = {path: path.stat().st_mtime_ns for path in out.glob("*/*/runs/*/results.json")}
    execute()
    assert before == {path: path.stat().st_mtime_ns for path in before}
