"""Numbers in the text of results and explanations, from the data beside them or computed again."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Sequence
from itertools import permutations, product
from math import exp, log
from pathlib import Path
from statistics import fmean, median

import pytest
from analyses import DATA, HEADINGS, measured, readme_of, script, sections_of, tables_of
from scipy.stats import binomtest, mannwhitneyu

from pursuit.mazes.maze import load_maze
from pursuit.mazes.suites import load_suite
from pursuit.tasks.task import TASK_NAMES
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    best_response,
    evaluate_exactly,
    mean_over_starts,
    solve_chase,
)
from scripted_agents.environments import make_env, single_agent_arguments
from train.experiments.committed import grouped, read_table
from train.files import read_csv
from train.settings.algorithms import HYPERPARAMETERS
from train.settings.curricula import CURRICULA

DOCS = Path(__file__).parents[2] / "docs"
RESULTS = [page.stem for page in sorted((DOCS / "results").glob("*.md")) if page.stem != "index"]
OTHER_FORM = {"speed", "front_page"}
"""Pages that are lists of values."""
REBASED = {"ec846a222f051d2d205b61bb0ee11373eac8a9c7"}
"""Commits of rows that a rebase has replaced, as the page of the rows says."""


def data(name: str) -> list[dict[str, str]]:
    """The rows of a file, such as "libraries/runs"."""
    return read_csv(DATA / f"{name}.csv")


def text_of(page: str) -> str:
    """The text of a page on one line, of results with the README beside their rows."""
    paths = [DOCS / page, readme_of(Path(page).stem)]
    if not page.startswith("results/"):
        paths.pop()
    texts = [path.read_text(encoding="utf-8") for path in paths if path.exists()]
    return " ".join(" ".join(texts).split())


def exact_p(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """The p of the permutation test of U of five against five runs, by SciPy; ties by hand."""
    if len({*ours, *theirs}) == len(ours) + len(theirs):
        return float(mannwhitneyu(ours, theirs, method="exact").pvalue)
    pool = [*ours, *theirs]

    def apart(chosen: frozenset[int]) -> float:
        pairs = product(chosen, set(range(len(pool))) - chosen)
        u = sum((pool[i] < pool[j]) + 0.5 * (pool[i] == pool[j]) for i, j in pairs)
        return abs(u - len(ours) * len(theirs) / 2)

    splits = {frozenset(order[: len(ours)]) for order in permutations(range(len(pool)), len(ours))}
    given = apart(frozenset(range(len(ours))))
    return sum(apart(split) >= given - 1e-9 for split in splits) / len(splits)


@pytest.mark.parametrize("page", RESULTS)
def test_a_results_page_says_what_it_rests_on(page: str) -> None:
    said = measured(page).lower()
    assert re.search(r"commit|version|recipe", said)
    if page != "speed":
        assert (re.search(r"seeds?|run", said) and "defaults" in said) or "settings" in said


@pytest.mark.parametrize("page", [page for page in RESULTS if page not in OTHER_FORM])
def test_a_results_page_has_the_answer_first_and_four_sections(page: str) -> None:
    """What is longer stands in the README beside the rows."""
    text = (DOCS / "results" / f"{page}.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.*)", text, re.MULTILINE) == [*HEADINGS]
    title, empty, answer = text.split("\n")[:3]
    assert title.startswith("# ") and not empty and re.match(r"\w", answer)
    assert all(section.strip() for section in sections_of(page).values())
    lines = text.splitlines()
    prose = " ".join(line for line in lines if not line.startswith("|")).split()
    assert len(prose) <= 600, f"{len(prose)} words without tables"
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    assert len(tables) <= 2
    assert all(table.count("\n") <= 2 + 10 for table in tables)  # two lines are the head


def test_commits_that_results_rest_on_are_in_the_history() -> None:
    def git(*arguments: str) -> str:
        found = subprocess.run(["git", *arguments], capture_output=True, text=True, cwd=DOCS)
        return found.stdout.strip()

    if git("rev-parse", "--is-shallow-repository") != "false":
        pytest.skip("needs the whole history")
    commits = {*git("rev-list", "HEAD").split()}
    for page in RESULTS:
        for short in re.findall(r"\b(?=\w*\d)[0-9a-f]{7,12}\b", measured(page)):
            assert any(each.startswith(short) for each in commits | REBASED), (page, short)
    for table in sorted(DATA.rglob("*.csv")):
        own = {row["commit"] for row in read_csv(table) if row.get("commit")}
        assert own - REBASED <= commits, table


def test_how_many_curricula_there_are() -> None:
    controls = {"none", "uniform", "reversed", "shuffled"}
    said = text_of("explanation/comparison.md")
    assert f"{len({*CURRICULA} - controls)} curricula, {len(controls)} controls" in said
    assert controls < {*CURRICULA}


@pytest.mark.parametrize(
    ("kind", "least", "most"), [("", 1.7, 121.0), ("-open", 55.0, 161.0), ("-tree", 0.0, 0.0)]
)
def test_how_far_the_astar_chaser_is_above_the_best_response(
    kind: str, least: float, most: float
) -> None:
    gaps = []
    for size in range(3, 10):
        maze = load_maze(f"{size}x{size}{kind}")
        evader = AStarEvader(0.2).action_probabilities(maze)
        chaser = AStarChaser().action_probabilities(maze)
        best = mean_over_starts(best_response("chaser", maze, evader, horizon=200).values, maze)
        played = mean_over_starts(evaluate_exactly(maze, chaser, evader, horizon=200), maze)
        gaps.append(100 * (played / best - 1))
    assert (min(gaps), max(gaps)) == pytest.approx((least, most), abs=0.5)
    said = text_of("explanation/exact.md")
    assert "1.7 to 121 % more steps than the best response on the plain ones, 55 to 161 %" in said


def test_most_games_of_the_methods_study_have_no_mixed_state() -> None:
    mixed = [
        f"{suite} {number:03d}"
        for suite in ("5x5-test", "7x7-test")
        for number in range(10)
        if solve_chase(load_suite(suite)[number], discount=0.95).mixed.any()
    ]
    assert mixed == ["5x5-test 001", "5x5-test 002", "7x7-test 002"]
    said = text_of("results/data/self-play-methods/README.md")
    assert f"{20 - len(mixed)} of the 20 games have no state" in said
    assert "5x5-test 001 and 002 and 7x7-test 002 have some" in said


def test_in_how_many_mazes_a_table_needs_fewer_frames_than_a_network() -> None:
    frames = {
        (row["learner"], row["size"], row["number"]): int(row["frames"])
        for row in data("frames_and_states/runs")
    }
    mazes = [key[1:] for key in frames if key[0] == "table"]
    fewer = sum(frames["table", *maze] < frames["network", *maze] for maze in mazes)
    assert len(mazes) == 25
    assert f"needs fewer frames in {fewer} of the 25" in text_of("results/frames_and_states.md")


def test_in_how_many_comparisons_ours_is_first_in_frames_against_all() -> None:
    frames: dict[tuple[str, ...], dict[str, list[float]]] = {}
    for row, way, gap in product(data("libraries/runs"), ("greedy", "sampled"), (5, 2, 1)):
        reached = row[f"frames_to_{gap}_percent_{way}"]
        by_name = frames.setdefault((row["task"], way, str(gap)), {})
        by_name.setdefault(row["contestant"], []).append(float(reached or "inf"))
    first = [
        key
        for key, by_name in frames.items()
        if all(
            exact_p(by_name["ours"], other) < 0.05 and sorted(by_name["ours"])[2] < sorted(other)[2]
            for name, other in by_name.items()
            if name != "ours"
        )
    ]
    assert len(frames) == 18 and {key[0][:6] for key in first} == {"chaser"}
    said = text_of("results/libraries.md")
    assert f"against all others with p < 0.05 in {len(first)}: the chaser's 2 and 1 %" in said


def test_gru_and_stacked_observations_are_not_told_apart() -> None:
    said = text_of("results/partial_observability.md")
    for who, shown in (("the chaser", "0.095"), ("both", "0.29")):
        found = re.findall(
            rf"\| {who} \| (?:four observations|GRU[^|]*) \| ([\d., ]+) \| [\d.]+ %", said
        )
        ours, theirs = [[float(value) for value in each.split(", ")] for each in found]
        assert f"{exact_p(ours, theirs):.2g}" == shown and shown in said


def test_how_many_claims_of_the_thesis_are_decided() -> None:
    verdicts = Counter(re.findall(r"\| (\w+) \|$", tables_of("thesis")["claims"], re.MULTILINE)[1:])
    assert verdicts == {"confirmed": 10, "refuted": 6, "undecided": 5}
    said = text_of("results/thesis.md")
    runs = data("thesis/runs")
    failed = [row for row in runs if row["observation"] in ("cells", "positions", "walls")]
    steps = sorted(float(row["mean_steps"]) for row in failed)
    assert f"take {steps[0]:.0f} to {steps[-1]:.0f} of at most 200 steps" in said
    assert f"random actions {float(failed[0]['random_steps']):.0f}" in said
    chasers = [row for row in runs if row["study"] == "figure-4.4"]
    for row in chasers:
        beaten = float(row["mean_steps"]) < float(row["scripted_steps"])
        assert beaten or row["algorithm"] == "a2c", row["run"]
    over = {
        row["maze"]: 100.0 * (float(row["scripted_steps"]) / float(row["optimal_steps"]) - 1.0)
        for row in chasers
    }
    assert f"{over['5x5']:.1f} % (5x5) and {over['7x7']:.0f} % (7x7) above the optimum" in said
    assert "16 of the 21 claims are decided: ten confirmed, six refuted." in said
    former = [row for row in data("thesis/former_claims") if row["least_p"]]
    compared = [row for row in former if "against" in row["runs"]]
    again = {row["study"] for row in data("thesis/runs")} | {"figure-4.8", "figure-4.9"}
    five = [row for row in former if row["study"] not in again]
    assert f"too few to decide any of the {len(five)} tested ones" in said
    assert all(float(row["least_p"]) * len(compared) >= 0.05 for row in five)


def test_what_is_said_of_elo() -> None:
    rows = read_table(DATA / "elo" / "snapshots.csv")
    orders = script("elo").orders(rows)
    (seed,) = (row["seed"] for row in orders if row["supports the claim"] == "yes")
    said = text_of("results/elo.md")
    p = binomtest(1, len(orders)).pvalue
    assert f"one of ten runs supports it (p = {p:.3f}), seed {seed}" in said and len(orders) == 10
    others = grouped((row for row in rows if row["seed"] != seed), "seed", "role")
    whole = [script("elo").agreement(own) for own in others.values()]
    assert f"tau {min(whole):.2f} to {max(whole):.2f} over the whole run" in said
    near, *_, far = ([*row.values()][1:] for row in script("elo").pairs(rows))
    shares = [f"{float(text.removesuffix(' %')):.0f} %" for text in near]
    assert f"{shares[0]} of the pairs of chasers and {shares[1]} of evaders" in said
    assert f"at least 16 apart, {far[0].removesuffix(' %')} and {far[1]}" in said


def test_the_first_page_says_which_runs_are_behind_the_scripted_agent() -> None:
    """Means stand beside medians nowhere: the table has medians; single runs are said."""
    rows = data("front_page/runs")
    behind = []
    for name in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == name]
        gaps = [100 * float(row["optimality_gap"]) for row in own]
        scripted = 100 * (float(own[0]["scripted_steps"]) / float(own[0]["optimal_steps"]) - 1)
        if scripted > 0.0 and max(gaps) > scripted:
            assert sum(gap > scripted for gap in gaps) == 1
            behind.append(f"{max(gaps):.2f} against {scripted:.2f} %")
    assert len(behind) == 2
    for page in ("results/front_page.md", "../README.md"):
        assert all(each in text_of(page) for each in behind), page


def test_places_of_ours_in_frames_are_those_of_the_runs() -> None:
    places: dict[str, list[int]] = {}
    rows = data("libraries/runs")
    for task, way, gap in product(
        dict.fromkeys(row["task"] for row in rows), ("greedy", "sampled"), (5, 2, 1)
    ):
        frames: dict[str, list[float]] = {}
        for row in rows:
            if row["task"] == task:
                reached = float(row[f"frames_to_{gap}_percent_{way}"] or "inf")
                frames.setdefault(row["contestant"], []).append(reached)
        middle = {name: sorted(own)[2] for name, own in frames.items()}
        place = 1 + sum(value < middle["ours"] for value in middle.values())
        places.setdefault(task, []).append(place)
    first = sum(place == 1 for own in places.values() for place in own)
    one_goal = places["runner, 5x5, 1 goal"]
    assert (min(one_goal), max(one_goal), len(one_goal)) == (2, 4, 6)
    said = f"first in {first} of 18 comparisons, with one goal second to fourth of four in all six"
    assert said in text_of("results/libraries.md") and said in text_of("results/index.md")
    assert said.partition(",")[0] in text_of("explanation/comparison.md")


def test_under_which_rules_mappo_is_nearer_than_ippo() -> None:
    units: dict[tuple[str, str], dict[tuple[str, str], dict[str, str]]] = {}
    for row in data("teams/runs"):
        units.setdefault((row["kind"], row["seed"]), {})[row["learner"], row["rule"]] = row
    whole = [unit for unit in units.values() if len(unit) == 15]
    rules = ("cell", "n_catch", "surround")

    def ratio(column: str, *rules: str) -> float:
        return fmean(
            log(float(unit["mappo", rule][column]) / float(unit["ippo", rule][column]))
            for unit in whole
            for rule in rules
        )

    cell, n_catch, surround = (exp(ratio("optimality_gap", rule)) for rule in rules)
    said = text_of("results/data/teams/README.md")
    assert f"{n_catch:.2f} times the gap under `n_catch`" in said
    assert f"{surround:.2f} times under `surround`, but {cell:.2f} times under `cell`" in said
    assert f"takes {exp(ratio('seconds', *rules)):.1f} times the processor seconds" in said


def test_the_ratio_of_mappo_to_ippo_in_the_study_of_critics_and_layers() -> None:
    teams = script("teams")
    units = teams.cells_in(DATA / "teams")["steps"]
    ratio = teams.ratio_with_interval([teams.mappo_against_ippo(unit) for unit in units])
    said = "{:.2f} [{:.2f}, {:.2f}] times".format(*ratio)
    assert f"MAPPO has {said} the gap of IPPO" in text_of("results/teams.md")
    assert f"its gap is {said} that of IPPO" in text_of("results/index.md")


def test_the_gap_rises_where_imitation_ends() -> None:
    rows = [row for row in data("imitation/runs") if row["variant"] == "optimal"]
    curves = [[float(gap) for gap in row["curve"].split()] for row in rows]
    assert {len(curve) for curve in curves} == {20}  # in even distances, up to 300,000 frames
    early, after, end = (100 * median(curve[place] for curve in curves) for place in (3, 7, 19))
    said = text_of("results/imitation.md")
    assert f"median gap was {early:.1f} % after 60,000 frames, {after:.1f} % after 120,000" in said
    assert f"and {end:.1f} % after 300,000" in said


def test_files_of_tests_that_texts_name_exist() -> None:
    root = Path(__file__).parents[2]
    listed = subprocess.run(
        ["git", "ls-files"], cwd=root, capture_output=True, text=True, check=True
    ).stdout.split()
    for name in listed:
        if name.endswith((".py", ".md", ".toml", ".yml", "Makefile")) and "mutants" not in name:
            text = (root / name).read_text(encoding="utf-8") if (root / name).exists() else ""
            for file in re.findall(r"\btests/[a-z0-9_/]+\.py\b", text):
                assert (root / file).exists(), (name, file)


def test_docstrings_name_every_task() -> None:
    for function in (make_env, single_agent_arguments):
        for name in TASK_NAMES:
            assert f'"{name}"' in (function.__doc__ or ""), (function.__name__, name)


def test_every_learner_has_a_row_of_its_speed() -> None:
    further = (DATA / "speed" / "README.md").read_text(encoding="utf-8")
    row = r"^\| (\w+) \| (?:maze|chaser|arm|team|self-play)[^|]+\| [\d,]+ \| ([\d,]+) \|"
    speeds: dict[str, list[int]] = {}
    for name, speed in re.findall(row, further, re.MULTILINE):
        speeds.setdefault(name, []).append(int(speed.replace(",", "")))
    assert set(speeds) >= set(HYPERPARAMETERS) - {"tracked"}  # which does not learn
    page = (DOCS / "results" / "speed.md").read_text(encoding="utf-8")
    shown = set()
    for names, ends in re.findall(r"^\| (`.+) \| ([\d,]+ to [\d,]+) \|$", page, re.MULTILINE):
        own = [each for name in re.findall(r"`(\w+)`", names) for each in speeds[name]]
        assert ends == f"{min(own):,} to {max(own):,}", names
        shown |= {*re.findall(r"`(\w+)`", names)}
    assert shown == set(speeds)
