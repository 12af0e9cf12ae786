"""The analysis of the ablations of curricula: the tables of their page, and made rows."""

from __future__ import annotations

import re
from functools import cache
from math import exp, log
from pathlib import Path
from statistics import fmean, geometric_mean, median
from typing import Any

import pytest
from analyses import DATA, RESULTS, script, text_of

from train.experiments.statistics import sign_flip_p
from train.files import write_csv

PAGE = RESULTS / "curricula.md"
Row = dict[str, Any]


analysis = script("curricula")


@cache
def studies() -> Any:
    """The runs of the page, by study."""
    return analysis.studies_in(DATA / "curricula")


def test_the_page_says_which_ablations_have_not_ended() -> None:
    page = " ".join(PAGE.read_text(encoding="utf-8").split())
    said = " ".join(re.findall(r"[^.]*\bnot ended\b[^.]*\.", page))
    for name in analysis.STUDIES:
        assert (f"`{name}`" in said) == (name not in studies()), name


def test_ratios_and_ps_of_the_page_stand_in_its_tables_or_beside_the_rows() -> None:
    """What is said in short on the page, of which the README has the checked statements."""
    page = PAGE.read_text(encoding="utf-8")
    prose = " ".join(re.sub(r"^\|.*$", "", page, flags=re.MULTILINE).split())
    known = [*analysis.tables(DATA / "curricula").values()]
    known.append((DATA / "curricula" / "README.md").read_text(encoding="utf-8"))
    said = re.findall(r"\b\d+\.\d+(?: \[[^\]]+\])?(?= times| there| in the|,| \()", prose)
    said += re.findall(r"p = [\d.]+\d", prose)
    assert len(said) >= 12
    for number in said:
        assert any(number in text for text in known), number


def row_of(name: str, variant: Row, maze: str, seed: int, frames: int, gap: float) -> Row:
    """A complete run."""
    run = f"{name}-{maze}-{variant['name']}-{seed}".replace(":", "_")
    row: Row = {"run": run, "kind": "single", "status": "complete", "maze": maze}
    row |= {"variant": variant["name"], "seed": seed, "budget_frames": frames, "frames": frames}
    row |= {"objective": "mean_steps", "shortfall": gap, "mean_optimality": 1 / (1 + gap / 100)}
    row |= {"hardest_share": 1.0}
    times = (f"{unit}_to_{limit}" for unit in ("seconds", "frames") for limit in (20, 10, 5, 2))
    return row | {name: float(frames) for name in times}


def test_ratios_are_paired_by_maze(tmp_path: Path) -> None:
    rows: dict[str, Row] = {}
    factors: dict[tuple[str, str], float] = {}
    for name in analysis.STUDIES:
        file = analysis.file_of(name)
        settings, seeds = file.settings, file.seeds
        mazes = (file.grid or {"maze": [settings["maze"]]})["maze"]
        for number, variant in enumerate(file.variants):
            factors[name, variant["name"]] = factor = 0.9**number
            for place, maze in enumerate(mazes):
                for seed in seeds:
                    gap = 3.0**place * factor * (1.0 + 0.1 * seed)
                    row = row_of(name, variant, maze, seed, settings["frames"], gap)
                    key = f"{maze} {variant['name']} {seed} {settings['frames']}"
                    rows.setdefault(key, row)
    write_csv(tmp_path / "runs.csv", [*rows.values()])
    made = analysis.studies_in(tmp_path)
    assert [*made] == [*analysis.STUDIES]
    for name, study in made.items():
        found = {row["variant"]: row for row in analysis.against_control(study)}
        assert list(found) == study.layout.variants
        for variant, row in found.items():
            if name == "mazes":
                assert row["runs"] == 10
            elif row["verdict"] != "control" and name != "maze-size":  # whose control has others
                assert row["ratio"] == pytest.approx(factors[name, variant]), (name, variant)
                assert row["lower_in"] == "12 of 12"
    first, second = (analysis.order_table(made, each) for each in analysis.ORDERS.values())
    assert first.count("| 1.11 [1.11, 1.11] | 0 of 12 |") == 4  # shuffled has the next factor
    assert second.count("| 1.11 [1.11, 1.11] |") == second.count("| 1.23 [1.23, 1.23] |") == 1

    del rows[next(key for key in rows if "shuffled" in key and " 12000000" in key)]
    write_csv(tmp_path / "runs.csv", [*rows.values()])
    assert "goal-spread-start" not in analysis.studies_in(tmp_path)


def test_what_the_answers_say_of_the_runs() -> None:
    page = " ".join(text_of("curricula").split())

    def ratios(name: str, variant: str, column: str) -> list[tuple[float, Row]]:
        """To the control, and the run, by maze."""
        runs = analysis.by_variant(studies()[name])
        control = {row["maze"]: row for row in runs["none"]}
        pairs = [(row, control[row["maze"]][column]) for row in runs[variant]]
        known = [(row, other) for row, other in pairs if None not in (row[column], other)]
        return [(max(row[column], 0.1) / max(other, 0.1), row) for row, other in known]

    def middle(name: str, variant: str, gap: int) -> float:
        """Of the mazes where both reach the gap."""
        return geometric_mean([ratio for ratio, _ in ratios(name, variant, f"frames_to_{gap}")])

    assert f"n = 100 reaches 5 % with {middle('opponent-epsilon', 'n = 100', 5):.2f} times" in page
    first, second, third = (middle("goal-spread-start", "linear", gap) for gap in (20, 10, 5))
    assert f"needs {first:.1f} times the frames of the control to a gap of 20 %" in page
    assert f"{second:.1f} times to 10 %, as many to 5 %" in page and f"{third:.1f}" == "1.0"
    whole = ratios("goal-spread-fixed", "n = 5000", "shortfall")
    ended = [ratio for ratio, row in whole if row["hardest_share"] > 0.0]
    assert (len(whole), len(ended)) == (12, 5) and "In seven of the twelve mazes" in page
    said = f"in the five others the gap is {min(ended):.2f} to {max(ended):.1f} times as large"
    assert said in page
    first, second = (middle("adaptive", name, 10) for name in ("linear", "success-gated"))
    assert f"the linear variant needs {first:.2f} and the success-gated one {second:.2f}" in page
    runs = analysis.by_variant(studies()["adaptive"])
    assert not any(row["unsolved_share"] for row in runs["linear"])
    failed = [row for row in runs["none"] if row["unsolved_share"]]
    assert len(failed) == 4 and "in four of the twelve mazes the control leaves" in page
    assert f"up to {100.0 * max(row['unsolved_share'] for row in failed):.1f} %" in page
    open_mazes = {row["maze"] for row in failed}
    ends = ratios("adaptive", "linear", "shortfall")
    parts = [
        [x for x, row in ends if (row["maze"] in open_mazes) == in_them]
        for in_them in (True, False)
    ]
    fours, others = map(geometric_mean, parts)
    assert f"Its ratio to the control is {fours:.2f} in these four and {others:.2f} in" in page
    again = {row["maze"][-3:]: x for x, row in ratios("order", "linear", "shortfall")}
    middles = (median(again.values()), median(x for x, _ in ends))
    assert "in the median maze {:.2f} ({:.2f} in `adaptive`)".format(*middles) in page
    least = again.pop("016")
    said = f"is {least:.2f}; without this maze it is {geometric_mean(again.values()):.2f}"
    assert said in page
    gaps = [row["shortfall"] for row in failed]
    assert f"its gap there is {min(gaps):.1f} to {max(gaps):.0f} %" in page


def test_learnability_of_mazes_paired_by_seed() -> None:
    runs = analysis.by_variant(studies()["mazes"])
    gaps = {
        name: [row["shortfall"] for row in sorted(rows, key=lambda row: row["seed"])]
        for name, rows in runs.items()
    }
    page = " ".join(text_of("curricula").split())

    def logs(variant: str) -> list[float]:
        return [log(a / b) for a, b in zip(gaps[variant], gaps["none"], strict=True)]

    more, regret = logs("exact learnability"), logs("maze replay, exact regret")
    assert min(more) > 0.0 and len(more) == 10 and "more in ten of ten seeds" in page
    assert f"has {exp(fmean(more)):.1f} times the gap" in page
    assert f"(p = {sign_flip_p(more):.3f}), and exact regret {exp(fmean(regret)):.1f} times" in page
    assert f"(p = {sign_flip_p(regret):.2f})" in page
