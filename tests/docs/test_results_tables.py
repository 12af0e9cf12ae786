"""The numbers in the tables of results pages are those of the data beside them.

A table is made again from `docs/results/data/STUDY/`, or its page says that the runs are not kept.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable
from itertools import product
from math import exp, log
from pathlib import Path
from statistics import fmean, mean, median
from typing import Any

import pytest
from scipy.stats import kendalltau

from pursuit.mazes.maze import load_maze
from scripted_agents import expected_tour_length
from train.experiments.claims import named
from train.experiments.claims_page import decide_all
from train.experiments.recorded import read_recorded
from train.experiments.replication import load_replication
from train.experiments.rows import StudyRows
from train.experiments.statistics import LEVEL, distance_interval, holm, mean_interval, sign_flip_p
from train.experiments.study import Layout
from train.reports.tables import Row
from train.runs.parts import contest_of
from train.settings.task import ReacherSettings

RESULTS = Path(__file__).parents[2] / "docs" / "results"
NOT_KEPT = "Runs not kept"
"""What a page says of tables whose data are gone."""
NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:,\d{3})*(?:\.\d+)?(?![\w])")
NO_VALUES = re.compile(r"\b\d+x\d+|\btau [\d.]+:|\bn = \d+|\b\d+( joints?)?:")
"""Numbers that name a setting."""

Cell = str | list[float]
"""A text, or the numbers in it."""
Data = list[dict[str, str]]


def data(name: str) -> Data:
    """The rows of a file, such as "libraries/runs"."""
    with (RESULTS / "data" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def the(rows: Data, **values: str) -> dict[str, str]:
    """The one row with these values."""
    (row,) = [row for row in rows if values.items() <= row.items()]
    return row


def numbers(row: dict[str, str], *names: str) -> list[float]:
    return [float(row[name]) for name in names]


def tables_of(page: str) -> list[list[list[str]]]:
    """The body rows of all tables of a page."""
    text = (RESULTS / f"{page}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^\|.*\n\|[-|: ]+\|\n((?:\|.*\n)+)", text, re.MULTILINE)
    return [
        [[cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()]
        for block in blocks
    ]


def check_cell(shown: str, expected: Cell) -> None:
    """The text, or all numbers, each to the digits that are printed."""
    if isinstance(expected, str):
        assert shown == expected
        return
    found = [
        text.replace("−", "-").replace(",", "") for text in NUMBER.findall(NO_VALUES.sub("", shown))
    ]
    assert len(found) == len(expected), (shown, expected)
    for text, value in zip(found, expected, strict=True):
        digits = len(text.partition(".")[2])
        unit = 0.51 * 10.0**-digits  # a table's last digit may be that of a rounded number
        assert abs(float(text) - value) <= unit, (shown, expected)


# -- the tables: what stands in some of their columns ----------------------------------------------


def libraries() -> Iterable[dict[int, Cell]]:
    rows = data("libraries/runs")
    one, three, chaser = dict.fromkeys(row["task"] for row in rows)
    for name in dict.fromkeys(row["contestant"] for row in rows):
        own = {
            task: [row for row in rows if (row["task"], row["contestant"]) == (task, name)]
            for task in (one, three, chaser)
        }

        def reached(task: str, percent: int, own: dict[str, Data] = own) -> Cell:
            times = [row[f"seconds_to_{percent}_percent_sampled"] for row in own[task]]
            got = sorted(float(time) for time in times if time)
            if 2 * len(got) <= len(times):
                return [len(got)]
            return [median([*got, *[float("inf")] * (len(times) - len(got))]), len(got)]

        def ends(task: str, own: dict[str, Data] = own) -> Cell:
            gaps = [100 * float(row["sampled"]) for row in own[task]]
            return [min(gaps), max(gaps)]

        yield {
            1: [
                median(float(r["frames"]) / float(r["seconds"]) for r in own[t]) / 1e3 for t in own
            ],
            2: reached(one, 1),
            **{3 + n: reached(three, percent) for n, percent in enumerate((5, 2, 1))},
            6: ends(three),
            7: reached(chaser, 5),
            8: reached(chaser, 1),
            9: ends(chaser),
        }


def frames_and_states() -> Iterable[dict[int, Cell]]:
    rows = data("frames_and_states/runs")
    for size in "34567":
        own = [row for row in rows if row["size"] == size]
        frames = {
            learner: [float(row["frames"]) / 1e3 for row in own if row["learner"] == learner]
            for learner in ("table", "network")
        }
        yield {0: f"{size}x{size}", 1: [float(own[0]["states"])],
               2: frames["table"], 3: frames["network"]}  # fmt: skip


def small_budgets() -> Iterable[dict[int, Cell]]:
    rows = data("small_budgets/runs")
    for task, frames in dict.fromkeys((row["task"], row["frames"]) for row in rows):
        own = [row for row in rows if (row["task"], row["frames"]) == (task, frames)]
        before, after = ([row for row in own if row["defaults"] == w] for w in ("before", "after"))
        yield {
            0: task,
            1: f"{int(frames):,}",
            2: before[0]["num_games"],
            3: after[0]["num_games"],
            4: [100 * float(row["optimality_gap"]) for row in before],
            5: [100 * float(row["optimality_gap"]) for row in after],
        }


def thesis() -> Iterable[dict[int, Cell]]:
    """The studies with five seeds."""

    def gaps(study: str, column: str, *keys: tuple[str, str]) -> list[float]:
        rows = data(f"{study}/table")
        return [float(the(rows, **{column: value, "group": group})["gap"]) for value, group in keys]

    def with_ends(row: dict[str, str]) -> list[float]:
        return numbers(row, "gap", "gap_low", "gap_high")

    tours = [expected_tour_length(load_maze(f"{size}x{size}"), 3) for size in range(3, 10)]
    yield {2: tours}
    assert {float(row["gap"]) for row in data("tabular/table")} == {0.0}
    yield {2: "0 in every seed"}
    goals = data("maze_by_goals/table")
    ten = [the(goals, num_goals="10", group=name) for name in ("ppo", "dqn", "a2c")]
    yield {2: [n for row in ten for n in with_ends(row)]}
    joints = [("1", name) for name in ("ddpg", "a2c", "td3", "ppo", "sac")]
    joints += [("2", name) for name in ("ppo", "a2c", "td3", "sac", "ddpg")]
    yield {2: gaps("reacher_by_joints", "joints", *joints)}
    best = the(data("reacher_noise_tau/table"), tau="0.1", group="gaussian")
    zero = [
        float(row["value"])
        for row in data("thesis/former_values")
        if row["setting"] == "gaussian, tau 0.0"
    ]
    yield {2: [*with_ends(best), min(zero), max(zero)]}
    yield from ({}, {}, {})  # in words


SETTINGS = ("algorithm", "maze", "observation", "rewards")
"""What differs between runs of the studies of the thesis."""


def thesis_studies() -> dict[str, list[Row]]:
    """The runs with eleven seeds, by study."""
    rows = [*read_recorded(RESULTS / "data" / "thesis" / "runs.csv").values()]
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(str(row["study"]), []).append(row)
    return found


def thesis_claims() -> Iterable[dict[int, Cell]]:
    """Every claim, decided again."""
    studies = thesis_studies()
    plan = load_replication([*studies])
    made = {
        name: StudyRows(Layout(""), rows, rows, varying=[*SETTINGS])
        for name, rows in studies.items()
    }
    for each in decide_all(plan, made):
        for cell in each.cells:
            shown: list[float] = []
            for group in cell.groups if each.claim.than else ():
                values = group.values(each.claim)
                shown += [fmean(map(fmean, values)), *distance_interval(values)]
            if not each.claim.than:
                shown = [float(cell.meets or 0), float(len(cell.groups[0].mazes[0]))]
            p: Cell = "< 0.001" if cell.corrected < 0.001 else [cell.corrected]
            what = (each.study.id.removeprefix("figure-"), each.claim.text.replace("*", "\\*"))
            yield dict(enumerate((*what, named(cell.groups[0].cell), shown, p, cell.verdict)))


def thesis_gaps() -> Iterable[dict[int, Cell]]:
    """The gap of every setting."""
    for study, rows in thesis_studies().items():
        varying = [name for name in SETTINGS if len({row[name] for row in rows}) > 1]
        for setting in dict.fromkeys(tuple(row[name] for name in varying) for row in rows):
            own = [row for row in rows if tuple(row[name] for name in varying) == setting]
            gaps = [100.0 * row["optimality_gap"] for row in own]
            yield {
                0: study.removeprefix("figure-"),
                1: ", ".join(map(str, setting)),
                2: [fmean(gaps), *distance_interval([gaps])],
                3: sorted([min(gaps), max(gaps)], key=abs),
                4: [median(row["frames"] / 1e6 for row in own)],
            }


def elo_runs() -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Elo and minus exploitability of all snapshots, by seed and role."""
    found: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for row in data("elo/snapshots"):
        pair = (float(row["elo"]), -float(row["exploitability"]))
        found.setdefault(row["seed"], {}).setdefault(row["role"], []).append(pair)
    return found


def elo_orders() -> Iterable[dict[int, Cell]]:
    for seed, roles in elo_runs().items():
        whole, later = (
            [float(kendalltau(*zip(*roles[role][first:], strict=True)).statistic)
             for role in ("chaser", "evader")]
            for first in (0, 20)
        )  # fmt: skip
        supports = fmean(whole) > 0.5 and fmean(later) < 0.2
        yield {0: seed, 1: whole, 2: later, 3: "yes" if supports else "no"}


def elo_pairs() -> Iterable[dict[int, Cell]]:
    for least, most in ((1, 1), (2, 3), (4, 7), (8, 15), (16, 39)):
        shares = []
        for role in ("chaser", "evader"):
            parted = [
                (one[0] - other[0]) * (one[1] - other[1]) < 0.0
                for roles in elo_runs().values()
                for place, one in enumerate(roles[role])
                for other in roles[role][place + least : place + most + 1]
            ]
            shares.append(100.0 * fmean(parted))
        yield {0: f"{least}" if least == most else f"{least} to {most}",
               1: [shares[0]], 2: [shares[1]]}  # fmt: skip


def capture_rules(*columns: str) -> Iterable[dict[int, Cell]]:
    rows = data("rules/capture")
    for maze, rule in dict.fromkeys((row["maze"], row["rule"]) for row in rows):
        line: dict[int, Cell] = {0: maze, 1: rule, 2: "", 3: "", 4: "", 5: ""}
        for row in rows:
            if (row["maze"], row["rule"]) == (maze, rule):
                shares = [100.0 * float(row[columns[0]])] if row[columns[0]] else []
                line[1 + int(row["chasers"])] = shares and [*shares, float(row[columns[1]])]
        yield line


def classical_domain() -> Iterable[dict[int, Cell]]:
    for row in data("rules/classical"):
        yield {
            0: row["order"],
            1: row["prey_moves"],
            2: numbers(row, "mean_steps"),
            3: numbers(row, "worst_start"),
            4: numbers(row, "scripted_steps", "scripted_ci95"),
        }


def exits() -> Iterable[dict[int, Cell]]:
    for row in data("rules/escape"):
        best = numbers(row, "best_chasers"), numbers(row, "equilibrium")
        yield dict(enumerate((row["chasers"], row["exits"], *best, numbers(row, "scripted"),
                              numbers(row, "best_evader"))))  # fmt: skip


LEARNERS = ("separate", "ippo", "mappo", "joint", "vdn")
RULES = ("cell", "n_catch", "surround")
Units = dict[tuple[str, int], dict[tuple[str, str], dict[str, str]]]


def team_units() -> Units:
    """The runs of every random unit (a maze with its seed; of 5x5-open a seed) by learner and rule;
    units with a missing run are left out."""
    units: Units = {}
    for row in data("teams/runs"):
        unit = units.setdefault((row["kind"], int(row["seed"])), {})
        unit[row["learner"], row["rule"]] = row
    return {key: unit for key, unit in units.items() if len(unit) == len(LEARNERS) * len(RULES)}


def teams() -> Iterable[dict[int, Cell]]:
    units = team_units()
    for kind, rule in product(dict.fromkeys(kind for kind, _ in units), RULES):
        own = [unit for key, unit in units.items() if key[0] == kind]

        def over(column: str, *key: str, own: list[dict[Any, dict[str, str]]] = own) -> float:
            return fmean(float(unit[key][column]) for unit in own)

        yield {
            0: kind,
            1: rule,
            2: [len(own)],
            3: [over("optimal_steps", "ippo", rule)],
            **{
                4 + n: [100 * over(c, name, rule) for c in ("optimality_gap", "members_gap")]
                for n, name in enumerate(LEARNERS)
            },
        }


LEAST_GAP, RATIO, SHARE = 0.001, log(1.25), 0.1
"""Smaller gaps count as this one; margins of claims: a ratio of gaps, a difference of shares."""


def team_claims() -> list[tuple[float, float, list[float], bool]]:
    """Of every claim of the page, in order: its sign (1 if it says that the values are above 0),
    its margin, the values of the units, and whether they are logarithms of ratios."""

    def gap(unit: dict[Any, dict[str, str]], learner: str) -> float:
        gaps = [float(unit[learner, rule]["optimality_gap"]) for rule in RULES]
        return fmean(log(max(gap, LEAST_GAP)) for gap in gaps)

    def share(unit: dict[Any, dict[str, str]], *rules: str) -> float:
        own = [unit[key] for key in product(LEARNERS, rules)]
        team, members = (
            sum(float(row[column]) for row in own) for column in ("optimality_gap", "members_gap")
        )
        return 1.0 - members / team

    units = list(team_units().values())
    claims = [
        (sign, RATIO, [gap(unit, one) - gap(unit, other) for unit in units], True)
        for sign, one, other in (
            (-1.0, "joint", "ippo"),
            (-1.0, "mappo", "ippo"),
            (1.0, "separate", "ippo"),
            (-1.0, "vdn", "ippo"),
        )
    ]
    hard = ("n_catch", "surround")
    claims.append((1.0, SHARE, [share(unit, *hard) - 0.5 for unit in units], False))
    differences = [share(unit, *hard) - share(unit, "cell") for unit in units]
    return [*claims, (1.0, SHARE, differences, False)]


def teams_decided() -> Iterable[dict[int, Cell]]:
    claims = team_claims()
    ps = holm([sign_flip_p(values) for _, _, values, _ in claims])
    for (sign, margin, values, ratio), p in zip(claims, ps, strict=True):
        center = fmean(values)
        shown = [center, *mean_interval([values])]
        low, high = mean_interval([values], 0.9)
        if p < LEVEL and sign * center < 0.0:
            verdict = "refuted"
        elif p < LEVEL:
            verdict = "confirmed" if sign * center >= margin else "confirmed, within the margin"
        else:
            verdict = "equal within the margin" if -margin < low <= high < margin else "undecided"
        yield {
            1: [exp(value) if ratio else value for value in shown],
            2: [len([v for v in values if sign * v > 0.0]), len(values)],
            3: [p],
            4: verdict,
        }


def team_budgets() -> Iterable[dict[int, Cell]]:
    units = team_units().values()
    for name in LEARNERS:

        def each(column: str, rule: str, name: str = name) -> list[float]:
            return [float(unit[name, rule][column] or 0.0) for unit in units]

        yield {
            0: name,
            **{1 + n: [median(each("seconds", rule))] for n, rule in enumerate(RULES)},
            **{4 + n: [100 * median(each("last_share", rule))] for n, rule in enumerate(RULES)},
            7: [100 * fmean(v for rule in RULES for v in each("unsolved_share", rule))],
        }


def pursuit_v5() -> Iterable[dict[int, Cell]]:
    rows = data("pursuit_v5/runs")
    for learner, seconds in dict.fromkeys((row["learner"], row["seconds"]) for row in rows):
        runs = [row for row in rows if (row["learner"], row["seconds"]) == (learner, seconds)]
        places = ("pettingzoo", "simulator")
        inside, here = ([row for row in runs if row["played_in"] == place] for place in places)
        shown = inside or here

        def means(part: Data, *names: str) -> list[float]:
            return [mean(float(row[name]) for row in part) for name in names] if part else []

        returns = [float(row["mean_return"]) for row in inside]
        ends = mean_interval([returns]) if len(returns) > 1 else ()
        total, steps = means(shown, "total_return", "mean_steps")
        trained = sum(means(shown, "agent_steps")) / 1e6
        yield {
            1: [*means(inside, "mean_return"), *ends] or "",
            2: means(here, "mean_return") or "",
            3: [total + 0.8 * steps],  # without the urgency reward of -0.1 of eight agents
            4: means(shown, "mean_caught"),
            5: [steps],
            6: [trained] if trained else "",
        }


def published() -> Iterable[dict[int, Cell]]:
    for row in data("pursuit_v5/published"):
        known = {2: row["episodes"], 3: row["hours"]}
        yield {
            0: row["method"],
            1: numbers(row, "best_mean"),
            **{place: [float(text)] if text else "" for place, text in known.items()},
        }


def limited_views() -> Iterable[dict[int, Cell]]:
    rows = data("partial_observability/bounds")
    (full,) = numbers(the(rows, radius=""), "lower")
    for row in rows:
        lower, upper, width = numbers(row, "lower", "upper", "width")
        more = sorted({round(100 * (bound / full - 1), 1) for bound in (lower, upper)})
        names = {"5x5": row["radius"] or "full"}
        yield {
            0: names.get(row["maze"], f"{row['maze']}, radius {row['radius']}"),
            1: [lower],
            2: [upper],
            3: [100 * width],
            4: more if row["maze"] == "5x5" else "",
            5: numbers(row, "seconds"),
        }


def scripted_views() -> Iterable[dict[int, Cell]]:
    rows = data("partial_observability/scripted")
    names = [*dict.fromkeys(row["chaser"] for row in rows if row["view"] == "radius 2")]
    for view in dict.fromkeys(row["view"] for row in rows):
        own = {row["chaser"]: numbers(row, "mean_steps", "ci95")
               for row in rows if row["view"] == view}  # fmt: skip
        yield {0: view} | {1 + place: own.get(name, "") for place, name in enumerate(names)}


def front_page() -> Iterable[dict[int, Cell]]:
    rows = data("front_page/runs")
    for name in sorted({row["variant"] for row in rows}):
        own = [row for row in rows if row["variant"] == name]

        def mean_of(column: str, own: Data = own) -> float:
            return fmean(float(row[column]) for row in own)

        def middle_of(column: str, own: Data = own) -> float:
            return median(float(row[column]) for row in own)

        steps = ("random", "scripted", "mean", "optimal")
        gaps = sorted((100 * float(row["optimality_gap"]) for row in own), key=abs)
        assert len(gaps) == 10
        yield {
            0: name,
            1: [float(own[0]["budget_seconds"]), mean_of("frames") / 1e6],
            **{2 + place: [middle_of(f"{kind}_steps")] for place, kind in enumerate(steps)},
            6: [gaps[0], median(gaps), gaps[-1]],
        }


OURS = "Pursuit"
"""The simulator by itself, in the file of the other libraries."""


def peers() -> Iterable[dict[int, Cell]]:
    rows = data("speed/peers")
    for peer, task in dict.fromkeys((row["peer"], row["task"]) for row in rows):
        if peer == OURS:
            continue
        own = [row for row in rows if (row["peer"], row["task"]) == (peer, task)]
        speeds = {
            what: median(float(row["steps_per_second"]) for row in own if row["what"] == what)
            for what in dict.fromkeys(row["what"] for row in own)
        }
        theirs = speeds["peer"]
        line: dict[int, Cell] = {0: peer, 1: task, 2: [in_millions(theirs)], 3: "", 4: ""}
        for place, what in ((3, "one game"), (5, "batch")):
            if what in speeds:
                line |= {place: [in_millions(speeds[what])], place + 1: [speeds[what] / theirs]}
        yield line


def simulator() -> Iterable[dict[int, Cell]]:
    rows = [row for row in data("speed/peers") if row["peer"] == OURS]
    for what in dict.fromkeys(row["what"] for row in rows):
        own = [float(row["steps_per_second"]) / 1e6 for row in rows if row["what"] == what]
        yield {0: what, 1: [median(own)]}


def inverse_kinematics() -> Iterable[dict[int, Cell]]:
    methods = ("thesis' inverse kinematics", "cyclic", "transpose", "pseudo-inverse", "damped")
    for joints in (1, 2, 3, 4, 6, 8):
        contest = contest_of(ReacherSettings(joints=joints), episodes=2000, seed=0)
        steps = {score.name: score.mean_steps for score in contest.baselines()}
        best = steps["optimal"]
        yield {
            0: str(joints),
            1: [best],
            **{
                2 + place: [steps[method], 100.0 * (steps[method] / best - 1.0)]
                for place, method in enumerate(methods)
            },
            7: [steps["random"]],
        }


def arm() -> Iterable[dict[int, Cell]]:
    rows = data("reacher_bars/runs")
    for name in dict.fromkeys(row["variant"] for row in rows):
        own = [row for row in rows if row["variant"] == name]
        gaps = sorted(100.0 * float(row["optimality_gap"]) for row in own)
        frames = fmean(float(row["frames"]) / 1e6 for row in own)
        assert len(own) == 10
        yield {
            0: name.partition(", ")[2],
            1: numbers(own[0], "optimal_steps"),
            2: [float(own[0]["budget_seconds"]), frames],
            3: [gaps[0], median(gaps), gaps[-1]],
        }


def in_millions(speed: float) -> float:
    """As it is printed: large speeds in millions."""
    return speed / 1e6 if speed >= 1e6 else speed


TABLES: dict[tuple[str, int], Callable[[], Iterable[dict[int, Cell]]]] = {
    ("libraries", 0): libraries,
    ("frames_and_states", 0): frames_and_states,
    ("hyperparameters", 3): small_budgets,
    ("rules", 0): lambda: capture_rules("forced", "mean_steps"),
    ("rules", 1): lambda: capture_rules("turns_forced", "turns_rounds"),
    ("rules", 2): classical_domain,
    ("rules", 3): exits,
    ("teams", 0): teams,
    ("teams", 1): teams_decided,
    ("teams", 2): team_budgets,
    ("elo", 0): elo_orders,
    ("elo", 1): elo_pairs,
    ("thesis", 0): thesis_claims,
    ("thesis", 1): thesis_gaps,
    ("thesis", 2): thesis,
    ("arm", 0): inverse_kinematics,
    ("arm", 1): arm,
    ("partial_observability", 0): limited_views,
    ("partial_observability", -1): scripted_views,
    ("front_page", 0): front_page,
    ("../../README", 1): front_page,
    ("speed", 0): simulator,
    ("speed", 1): peers,
    ("pursuit_v5", 0): pursuit_v5,
    ("pursuit_v5", 1): published,
}
"""How the numbers of a table, given by its page and place, follow from the data."""
ELSEWHERE = {"index", "self_play_mixing", "curricula"}
"""Pages without tables of results, or whose tables have a test of their own."""
PAGES = [page.stem for page in sorted(RESULTS.glob("*.md")) if page.stem not in ELSEWHERE]


SLOW = {("arm", 0)}
"""Tables that are computed again instead of read."""


@pytest.mark.parametrize(
    ("page", "place"),
    [pytest.param(*key, marks=[pytest.mark.slow] if key in SLOW else []) for key in TABLES],
)
def test_a_table_follows_from_the_data(page: str, place: int) -> None:
    shown, expected = tables_of(page)[place], list(TABLES[page, place]())
    for cells, wanted in zip(shown, expected, strict=True):
        for column, cell in wanted.items():
            check_cell(cells[column], cell)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_says_which_runs_are_not_kept(page: str) -> None:
    """Of a table that does not follow from data."""
    first = (RESULTS / f"{page}.md").read_text(encoding="utf-8").split("\n\n")[1]
    whole = all((page, place) in TABLES for place in range(len(tables_of(page))))
    assert whole or NOT_KEPT in first


def test_gaps_after_several_budgets_are_those_of_the_runs() -> None:
    text = " ".join((RESULTS / "speed.md").read_text(encoding="utf-8").split())
    rows, found = data("budgets/runs"), data("budgets/cross_entropy_search")
    learners = {row["learner"] for row in rows}
    assert learners == {"ppo", "a2c", "reinforce", "dqn", "q_learning", "cross_entropy"}
    assert len(rows) == len(learners) * 4 * 5
    assert {row["gap_percent"] for row in rows if row["learner"] != "cross_entropy"} == {"0.00"}
    gaps = {
        frames: [
            float(row["gap_percent"])
            for row in rows
            if (row["learner"], row["frames"]) == ("cross_entropy", frames)
        ]
        for frames in ("4000000", "2000000", "500000")
    }
    low, high = min(gaps["4000000"]), max(gaps["4000000"])
    assert f"needs 4 million (gaps of {low} to {high:.2f} %)" in text
    assert f"{min(gaps['2000000']):,.0f} to {max(gaps['2000000']):,.0f} %" in text
    assert f"{min(gaps['500000']):,.0f} to {max(gaps['500000']):,.0f} %" in text
    least = min(float(row["gap_percent"]) for row in found)
    assert (
        f"Of {len(found)} random settings at 2 million frames the best has {least:,.0f} %" in text
    )
