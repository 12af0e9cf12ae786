"""Claims of the thesis are decided by the rules that were written before the runs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pursuit.maze import load_maze
from train.commands.main import main
from train.experiments.forms import SweepFile
from train.experiments.sweep import multiply_out
from train.files import read_json
from train.reproduction.exact import STATES, TOURS, states_table, tours_table
from train.reproduction.plan import (
    SHIPPED,
    Claim,
    load_replication,
    mazes_by_size,
    sweep_of,
    tuning_sweep,
    with_mazes,
    with_settings,
)
from train.reproduction.report import Decided, page, write_replication
from train.reproduction.rules import PARTS, Ran, decide, diverged, part_of, verdict_of, worse_by
from train.reproduction.run import carry_out, changed_rules, keep_rules, tuned_settings


def ran(
    seed: int, gap: float, unsolved: float = 0.0, lengths: tuple[float, ...] = (), **row: object
) -> Ran:
    """A run that ended so."""
    plain = {"seed": seed, "optimality_gap": gap, "unsolved_share": unsolved, "max_steps": 200}
    return Ran({"frames": 10**6, "algorithm": "ppo", **plain, **row}, lengths)


def test_a_run_has_diverged_where_most_is_unsolved_and_nothing_falls() -> None:
    flat, falling = (200.0,) * 9, (200.0,) * 6 + (200.0, 190.0, 180.0)
    assert diverged(ran(0, 9.0, 0.6, flat))
    assert not diverged(ran(0, 9.0, 0.6, falling))
    assert not diverged(ran(0, 9.0, 0.5, flat))  # more than half, not half
    early = (200.0, 150.0, 140.0) + (140.0,) * 6  # it fell, but not in the last third
    assert diverged(ran(0, 9.0, 0.6, early))


@given(st.lists(st.booleans(), max_size=12))
def test_four_fifths_confirm_and_a_fifth_refutes(said: list[bool]) -> None:
    verdict, _, note = verdict_of(dict(enumerate(said)))
    if len(said) < 5:
        assert verdict == "undecided" and note
    elif 5 * sum(said) >= 4 * len(said):
        assert verdict == "confirmed"
    else:
        assert verdict == ("refuted" if 5 * sum(said) <= len(said) else "undecided")


def test_seeds_are_compared_with_their_like() -> None:
    ours = [ran(seed, 0.01 * seed) for seed in range(5)]
    theirs = [ran(seed, 0.01 * seed + 0.001, algorithm="dqn") for seed in range(5)]
    claim = Claim("", "lower", {"algorithm": "ppo"}, [{"algorithm": "dqn"}])
    verdict = decide(claim, ours + theirs, 0)
    assert verdict.verdict == "confirmed" and verdict.says == dict.fromkeys(range(5), True)
    assert 0.5 < verdict.ps[0] <= 1.0  # the permutation test knows of no pairs
    turned = Claim("", "higher", {"algorithm": "ppo"}, [{"algorithm": "dqn"}])
    assert decide(turned, ours + theirs, 0).verdict == "refuted"
    three = decide(claim, ours[:3] + theirs, 0)
    assert three.verdict == "undecided" and "3 complete seeds" in three.note
    few = decide(claim, ours + theirs, 2 * 10**6)
    assert few.verdict == "undecided" and "1,000,000 frames" in few.note


def test_a_run_without_what_a_rule_asks_for_decides_nothing() -> None:
    runs = [ran(seed, 0.1) for seed in range(5)]
    verdict = decide(Claim("", "part_above", {"algorithm": "ppo"}, percent=50.0), runs, 0)
    assert verdict.verdict == "undecided" and "solved_gap is not known" in verdict.note


def test_a_seed_says_so_where_the_rule_holds_in_every_cell() -> None:
    runs = [ran(seed, 0.0, maze="3x3", joints=1) for seed in range(5)]
    runs += [ran(seed, 0.1 * (seed > 0), maze="5x5", joints=1) for seed in range(5)]
    for run in runs:
        object.__setattr__(
            run,
            "row",
            {**run.row, "mean_steps": 10 * (1 + run.row["optimality_gap"]), "optimal_steps": 10},
        )
    both = Claim("", "within", {"maze": ["3x3", "5x5"]}, to="optimal", percent=0.0)
    verdict = decide(both, runs, 0)
    assert verdict.says == {0: True, 1: False, 2: False, 3: False, 4: False}
    assert verdict.verdict == "refuted"


def test_what_a_claim_leaves_open_are_cells_of_their_own() -> None:
    def run(seed: int, maze: str, gap: float, algorithm: str = "ppo") -> Ran:
        one = ran(seed, gap, maze=maze, algorithm=algorithm)
        return Ran(one.row, (), {"maze": maze, "algorithm": algorithm})

    runs = [run(seed, "3x3", 0.0) for seed in range(5)]
    runs += [run(seed, "5x5", 0.2) for seed in range(5)]  # a later one of the same seed
    runs += [run(seed, maze, 0.1, "dqn") for seed in range(5) for maze in ("5x5", "3x3")]
    lower = Claim("", "lower", {"algorithm": "ppo"}, [{"algorithm": "dqn"}])
    verdict = decide(lower, runs, 0)
    assert verdict.verdict == "refuted" and len(verdict.cells) == 4
    assert decide(lower, [r for r in runs if r.row["maze"] == "3x3"], 0).verdict == "confirmed"
    three = [*runs, run(0, "7x7", 0.1, "dqn")]
    assert "2 cells are compared with 3" in decide(lower, three, 0).note


def test_who_lives_longer_is_better_only_as_an_evader() -> None:
    evader = ran(0, -0.1, role="evader", mean_steps=180.0)
    assert worse_by(evader, "limit") == pytest.approx(10.0)
    chaser = ran(0, 0.1, role="chaser", mean_steps=11.0, scripted_steps=12.0)
    assert worse_by(chaser, "scripted") < 0


def test_a_gap_is_floor_and_loops_and_the_rest() -> None:
    run = ran(0, 0.10, solved_gap=0.04, objective_floor=0.01)
    parts = {part: part_of(run, part) for part in PARTS}
    assert parts == pytest.approx({"floor": 10.0, "loops": 60.0, "learning": 30.0})
    assert part_of(ran(0, 0.0, solved_gap=0.0, objective_floor=0.0), "floor") == 0.0


def test_the_table_of_states_is_not_its_formula() -> None:
    verdict, lines = states_table()
    assert verdict.verdict == "refuted" and len(lines) == 2 + len(STATES)
    assert "| 3x3 | 828 | 855 |" in lines and "| 5x5 | 58,100 | 58,375 |" in lines


def test_tours_are_decided_on_the_users_mazes_alone(tmp_path: Path) -> None:
    verdict, lines = tours_table({})
    assert verdict.verdict == "undecided" and "--mazes" in verdict.note
    assert len(lines) == 2 + len(TOURS)
    (tmp_path / "mine.txt").write_text(load_maze("3x3").to_text())
    (tmp_path / "readme.md").write_text("no maze")
    own = mazes_by_size(tmp_path)
    assert list(own) == ["3x3"]
    verdict, lines = tours_table(own)  # 4.92 here, 4.97 in the table: within 5 %
    assert verdict.verdict == "confirmed" and len(lines) == 3


@pytest.mark.parametrize(("kind", "rule"), [("exact = true", "learns"), ('sweep = "x"', "states")])
def test_rules_fit_their_study(tmp_path: Path, kind: str, rule: str) -> None:
    file = tmp_path / "claims.toml"
    file.write_text(
        f'title = "t"\n[[studies]]\nid = "a"\ntitle = "t"\nthesis = "q"\ndiffers = "d"\n{kind}\n'
        f'[[studies.claims]]\ntext = "z"\nrule = "{rule}"\n'
    )
    with pytest.raises(ValueError, match=f"rule '{rule}'; states and tours are for"):
        load_replication(file=str(file))


def test_a_users_mazes_stand_for_ours_of_their_size(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder"):
        mazes_by_size(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="no maze file in it"):
        mazes_by_size(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).write_text(load_maze("5x5").to_text())
    with pytest.raises(ValueError, match="are both 5x5; leave one"):
        mazes_by_size(tmp_path)
    file = SweepFile(settings={"maze": "5x5"}, grid={"maze": ["3x3", "7x7-tree"]})
    changed = with_mazes(file, {"5x5": "/mine", "3x3": "/other"})
    assert changed.settings == {"maze": "/mine"}
    assert changed.grid == {"maze": ["/other", "7x7-tree"]}
    with pytest.raises(ValueError, match="has no maze of 3x3; it has 5x5"):
        with_mazes(file, {"5x5": "/mine"})
    assert with_mazes(file, {}) == file


def test_settings_that_were_found_go_to_their_algorithm_alone() -> None:
    file = SweepFile(
        settings={"task": "maze", "maze": "3x3", "frames": 1000, "gamma": 0.98},
        grid={"algorithm": ["ppo", "a2c"]},
    )
    sweep = multiply_out(with_settings(file, {"ppo": {"gamma": 0.9}}), "tiny")
    found = {run.settings.algorithm: run.settings.hyper.gamma for run in sweep.runs}
    assert found == {"ppo": 0.9, "a2c": 0.98}


def test_every_algorithm_is_searched_for_as_long() -> None:
    plan = load_replication()
    assert plan.tuning is not None
    trials = tuning_sweep(plan).runs
    count = {name: 0 for name in plan.tuning.space}
    for run in trials:
        count[run.settings.algorithm] += 1
    assert len(set(count.values())) == 1
    assert len({run.settings.seconds for run in trials}) == 1
    assert sum(SHIPPED in run.label["variant"] for run in trials) == 3 * len(plan.tuning.mazes)
    for study in plan.studies:  # on mazes and seeds that nothing is judged on
        if not study.exact and study.id != "figure-2.2":
            runs = sweep_of(study, plan, {}).runs
            used = {run.settings.task.maze for run in runs if hasattr(run.settings.task, "maze")}
            assert not used & set(plan.tuning.mazes)
            assert not {run.settings.seed for run in runs} & {trials[0].settings.seed}


@pytest.mark.parametrize("version", ["short", "full"])
@pytest.mark.parametrize("file", ["thesis", "optimum"])
def test_every_claim_is_about_runs_that_its_study_has(file: str, version: str) -> None:
    plan = load_replication(version=version, file=file)
    assert len({study.id for study in plan.studies}) == len(plan.studies)
    for study in plan.studies:
        if not study.exact:
            assert sweep_of(study, plan, {}).runs
    study.claims[0].of["maze"] = "1x1"
    with pytest.raises(ValueError, match=r"'maze': '1x1'.* and no run of"):
        sweep_of(study, plan, {})


def test_rules_are_kept_and_their_change_is_told(tmp_path: Path) -> None:
    plan = load_replication(["figure-2.2"])
    keep_rules(plan, tmp_path)
    study = plan.studies[0]
    assert changed_rules(study, tmp_path) == ""
    written = read_json(tmp_path / "rules.json")["figure-2.2"]["written"]
    study.claims[0].percent = 50.0
    keep_rules(plan, tmp_path)  # a second start does not overwrite them
    assert f"had begun ({written})" in changed_rules(study, tmp_path)


def test_the_page_says_claim_rule_verdict_and_evidence(tmp_path: Path) -> None:
    plan = load_replication(["figure-4.4", "table-3.1"])
    study = plan.studies[-1]
    more: dict[str, Any] = {
        "role": "chaser",
        "maze": "5x5",
        "machine": "M",
        "commit": "abcdefgh",
        "seconds": 9.0,
    }
    runs = [ran(seed, 0.01, mean_steps=10.1, scripted_steps=10.0, **more) for seed in range(5)]
    verdict = decide(study.claims[0], runs, study.least_frames)
    text = page(plan, [Decided(study, runs, 30, [(study.claims[0], verdict, [])], "")], tmp_path)
    assert "5 of 30 runs are complete" in text and "**Confirmed, 5 of 5**" in text
    assert "no more than 2 % worse than the scripted reference" in text
    path = write_replication(plan, tmp_path)  # without any run
    claims = (path.parent / "claims.csv").read_text().splitlines()
    assert len(claims) == 1 + sum(len(study.claims) for study in plan.studies)
    assert path.with_suffix(".html").exists()


def test_the_command_says_what_it_would_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    main(["reproduce", "figure-2.2", "--dry-run", "--out", out])
    assert re.search(r"figure-2.2 +10 runs, 0 complete; 5 s each", capsys.readouterr().out)
    assert not (tmp_path / "out").exists()
    main(["reproduce", "--list"])
    assert "figure-4.8" in capsys.readouterr().out
    for arguments, told in (
        (["figure-9"], "unknown study 'figure-9'; all, or some of table-3.1"),
        (["all", "--version", "long"], "unknown version 'long'"),
        (["figure-4.2-settings"], "is part of full only"),
        (["all", "--mazes", str(tmp_path / "no")], "no such folder"),
        (["all", "--page", "--out", out], "leave --page out to begin"),
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
        "[short]\nseeds = [0, 1, 2, 3, 4]\nsettings = { seconds = 1 }\n"
        "[full]\nseeds = [0, 1, 2, 3, 4]\n"
    )
    file = tmp_path / "studies.toml"
    file.write_text(TINY.replace("SWEEP", str(sweep)))
    plan, out = load_replication(file=str(file)), tmp_path / "out"
    told: list[str] = []
    assert carry_out(plan, out, 2, told.append, lambda sweep: lambda statuses, progress: None)
    assert tuned_settings(plan, out).keys() <= {"q_learning"}
    text = write_replication(plan, out).read_text()
    assert "5 of 5 runs are complete" in text and "**Confirmed, 5 of 5**" in text
    assert (out / "report" / "one.png").exists()
    before = {path: path.stat().st_mtime_ns for path in out.glob("*/*/runs/*/results.json")}
    assert carry_out(plan, out, 2, told.append, lambda sweep: lambda statuses, progress: None)
    assert before == {path: path.stat().st_mtime_ns for path in before}
