"""The analysis of the study of self-play by mixed share, on rows that are made here."""

from __future__ import annotations

from math import exp, log
from statistics import fmean
from typing import Any

import pytest
from analyses import DATA, RESULTS, script, text_of

from train.experiments.committed import grouped
from train.experiments.recorded import read_recorded
from train.experiments.tuning import score

Row = dict[str, Any]


STUDY = DATA / "self_play_mixing"
analysis = script("self_play_mixing")


def conv(method: str, share: float, game: str, seed: int) -> float:
    """NashConv in shares of the range of the rows below, so that the logarithm of PPO / MMD, with
    the constant added, is 0.3 + 2 * share."""
    base = 0.05 + 0.001 * (len(game) % 7)
    noise = exp(0.1 * (seed - 1)) * (1.0 if method in ("ppo", "mmd") else 1.0 + len(game) / 1000)
    if method == "ppo":
        return float((base + 1e-3) * noise * exp(0.3 + 2.0 * share) - 1e-3)
    return float((base + 1e-3) * noise - 1e-3)


def rows() -> list[Row]:
    """A row for every judged game, method and seed."""
    found = []
    for game, about in analysis.properties(STUDY).items():
        scale = 2.0 + len(game) % 3
        for method in ("ppo", *analysis.RIVALS):
            for seed in range(3):
                share = about["mixed_share"]
                value = scale * conv(method, share, game, seed)
                row: Row = {"game": game, "variant": method, "status": "complete", "seed": seed}
                row |= {"payoff_range": scale, "mixed_share": share, "curve": "", "frames": 10}
                for name in ("last", "average", "last_likely", "average_likely"):
                    row[f"nash_conv_{name}"] = value
                found.append(row | {"played_nash_conv": value})
    return found


def test_all_judged_runs_have_rows() -> None:
    both = [analysis.judged(STUDY, matrix) for matrix in (False, True)]
    assert sum(map(len, both)) == 558 + 28


def test_the_answer_follows_from_the_rows() -> None:
    about = analysis.properties(STUDY)
    own, matrix = analysis.judged(STUDY), analysis.judged(STUDY, matrix=True)
    logs = analysis.ratios(analysis.logs_of(own, "ppo"), analysis.logs_of(own, "mmd"))
    share = analysis.shares(own)
    page = " ".join(text_of("self_play_mixing").split())
    above = [game for game in logs if share[game] > 0.05]
    behind = [game for game in above if logs[game] >= 0.0]
    least, most = (100 * end(share[game] for game in above) for end in (min, max))
    assert f"in {len(above) - len(behind)} of {len(above)} fully observed zero-sum games" in page
    assert f"with a mixed share of {least:.0f} to {most:.0f} %" in page
    values = {row["what"]: row["value"] for row in analysis.contrary(own, matrix, about)}
    ratio, low, high = values["PPO / MMD, games above 5 %"]
    assert f"PPO ends at {ratio:.2f} [{low:.2f}, {high:.2f}] times the NashConv of MMD" in page
    exchanged = read_recorded(DATA / "self_play_entropy" / "runs.csv").values()
    ppo, small, large, mmd = (row["above 5 %"] for row in analysis.by_bonus(own, [*exchanged]))
    assert f"PPO is still nearer ({ppo:.2f} against {large:.2f} % of the range)" in page
    index = (RESULTS / "index.md").read_text(encoding="utf-8")
    assert f"multiplies that of PPO by {ppo / small:.2f}, that of MMD by {large / mmd:.2f}" in index
    slope, low, high = analysis.bootstrapped(logs, share)
    assert f"negative: {slope:.1f}, 95 % interval {low:.1f} to {high:.1f}." in page
    assert (
        f"Between the two settings of PPO it is {values['slope of PPO by default / PPO'][0]:.1f}"
        in page
    )
    ranges = [game["scaled_range"] for game in about.values()]
    assert f"up to {max(ranges) / min(ranges):.1f} times as strong" in page
    tuning = [*read_recorded(STUDY / "tuning.csv").values()]
    top, leads = max(row["rung"] for row in tuning), []
    for method in ("ppo", "mmd"):
        last = [row for row in tuning if (row["variant"], row["rung"]) == (method, top)]
        scores = sorted(score(runs) for runs in grouped(last, "trial").values())
        leads.append(exp(scores[1] - scores[0]))
    assert f"by a factor of {leads[0]:.1f} (PPO) and {leads[1]:.1f} (MMD)" in page
    ends = {m: analysis.near_ends(m, runs[0]) for m, runs in analysis.chosen(tuning).items()}
    near = "; ".join(f"{method}: {found}" for method, found in ends.items() if found)
    assert f"Near the end of a range: {near}." in page
    lines = {row["what"]: row for row in analysis.comparisons(own)}
    passed = [what for what, row in lines.items() if row["p_holm"] < 0.05]
    likely = [f"{method} / ppo, mixed share above 5 %" for method in ("mmd", "rnad", "pfsp")]
    populations = ["psro / ppo", "nfsp / ppo"]
    assert passed == ["ppo: threshold / no threshold", *likely, *populations]


def test_slopes_are_those_of_the_rows() -> None:
    found = {row["what"]: row for row in analysis.slopes(rows(), analysis.properties(STUDY))}
    assert len(analysis.properties(STUDY)) == 29
    for what in ("primary: bootstrap over games", "primary: HC3", "mazes only"):
        assert found[what]["slope"] == pytest.approx([2.0] * 3, abs=1e-6), what
    assert found["primary: HC3"]["games"] == 29
    assert found["Spearman's rank correlation"]["slope"] > 0.99  # games with share 0 are equal


def test_a_failed_run_counts_as_the_whole_range() -> None:
    own = rows()
    game, share = own[0]["game"], own[0]["mixed_share"]
    failed = {"game": game, "variant": "ppo", "status": "failed", "seed": 0}
    own[0] = failed | dict.fromkeys(("played_nash_conv", "payoff_range", "mixed_share", "curve"))
    rest = [log(conv("ppo", share, game, seed) + 1e-3) for seed in (1, 2)]
    expected = fmean([log(1.0 + 1e-3), *rest])
    assert analysis.logs_of(own, "ppo")[game] == pytest.approx(expected)
    assert analysis.shares(own)[game] == share


def test_strata_and_comparisons_hold_all_games_and_methods() -> None:
    own = rows()
    share = analysis.shares(own)
    counts = [
        sum(analysis.stratum(value) == name for value in share.values())
        for name, _ in analysis.STRATA
    ]
    assert counts == [7, 7, 7, 8]
    lines = {row["what"]: row for row in analysis.comparisons(own)}
    # The populations have no rows here.
    assert len(lines) == 3 + 4 * 4
    assert sum(row["games"] for what, row in lines.items() if what.startswith("mmd")) == 29
    ratio = lines["ppo / ppo with momentum"]["ratio"][0]
    factors = [0.3 + 2.0 * value - log(1.0 + len(game) / 1000) for game, value in share.items()]
    assert ratio == pytest.approx(exp(fmean(factors)))
    assert lines["mmd / ppo, mixed share above 5 %"]["ratio"][0] < 0.7
    assert all(row["p_holm"] >= row["p"] or row["p"] != row["p"] for row in lines.values())
    table = {row["method"]: row for row in analysis.by_stratum(own)}
    zero = [game for game, value in share.items() if value == 0.0]
    logs = [fmean(log(conv("mmd", 0.0, game, s) + 1e-3) for s in range(3)) for game in zero]
    assert table["mmd"]["0"] == pytest.approx(100.0 * (exp(fmean(logs)) - 1e-3))
