"""Leagues of small games, against matrix games with known payoffs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train.commands.main import main
from train.kinds import start
from train.runs.folder import RUN, SELF_PLAY
from train.runs.parts import settings_of
from train.self_play.league import enter, play_league, rate
from train.self_play.parts import self_play_settings_of

PURE = [f"round_games:{name}" for name in ("rock", "paper", "scissors")]
TWICE = "round_games:Rounds(rounds=2)"


def league_of(names: list[str], game: str, games: int = 20) -> Any:
    sides, entries = enter(names, game=game)
    return play_league(sides, entries, games, 0)


def test_rock_paper_scissors_has_its_matrix_its_equilibrium_and_its_cycle() -> None:
    table = league_of([*PURE, "uniform"], TWICE)
    column = 2.0 * np.array([[0, 1, -1], [-1, 0, 1], [1, -1, 0]])  # of the second player
    assert table.payoff[:3, :3] == pytest.approx(column)
    assert table.payoff[3] == pytest.approx(0.0) and table.payoff[:, 3] == pytest.approx(0.0)
    # Pure policies get the exact return in every game.
    assert (table.lengths[:3, :3] == column[:, :, None]).all()
    content = rate(league_of(PURE, TWICE))
    assert content["row_policies"] == content["column_policies"]
    for role in ("row", "column"):
        assert content["nash"][f"{role}_mixture"] == pytest.approx([1 / 3] * 3, abs=1e-3)
        assert len(content[f"{role}_cycle"]) == 3
        assert [one["payoff_against_nash"] for one in content[f"{role}_ratings"]] == pytest.approx(
            [0.0] * 3, abs=2e-3
        )
    assert len(content["cycle"]) == 6 and content["cycle"][0].startswith("row ")
    assert "never_caught" not in content and content["unit"] == "return of column"


def test_sampled_returns_have_the_exact_mean() -> None:
    sides, entries = enter(["uniform", PURE[0]], game=TWICE)
    mixed, rock = entries[0].policy, entries[3].policy
    assert (entries[0].role, entries[3].role) == ("row", "column")
    found = sides.pair(mixed, rock, 3000, 2**62, 0).sampled
    # Each round is -1, 0 or 1 with equal chances: mean 0, variance 2/3.
    assert abs(found.mean()) < 4.0 * (4.0 / 3.0 / 3000.0) ** 0.5
    assert np.bincount((found + 2).astype(int)) / 3000 == pytest.approx(
        np.array([1, 2, 3, 2, 1]) / 9, abs=0.04
    )


def test_a_general_sum_game_has_the_payoffs_of_both_and_no_ratings() -> None:
    content = rate(league_of(["round_games:ballet", "uniform"], "round_games:Clash"))
    assert content["payoffs"] == {
        "one": [[2.0, 1.0], [1.0, 0.75]],
        "two": [[1.0, 0.5], [0.5, 0.75]],
    }
    assert set(content) == {"one_policies", "two_policies", "payoffs"}


def test_runs_enter_for_the_players_that_they_learned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    tiny: dict[str, Any] = {
        "game": TWICE,
        "frames": 512,
        "num_games": 16,
        "minibatch_size": 64,
        "max_steps": 7,
    }
    start(SELF_PLAY, self_play_settings_of(**tiny), "both").train()
    start(RUN, settings_of(**tiny, player="column", opponent=PURE[0]), "one").train()
    main(["league", "both", "one", "uniform", "--game", TWICE, "--games", "10", "--out", "l"])
    said = capsys.readouterr().out
    assert f"return of column in game {TWICE}, at most 7 (exact)" in said
    content = json.loads((tmp_path / "l" / "league.json").read_text())
    assert content["row_policies"] == ["both", "uniform"]
    assert content["column_policies"] == ["both", "one", "uniform"]
    assert content["game"] == TWICE and content["task"] == "game"
    names = {path.name for path in (tmp_path / "l").glob("*.csv")}
    assert names == {"table.csv", "row_policies.csv", "column_policies.csv"}
    page = (tmp_path / "l" / "report.html").read_text(encoding="utf-8")
    assert f"<h1>League in {TWICE}</h1>" in page and "Column Policies" in page
    for arguments, message in (
        (["one", "--game", TWICE], "no policy of row among the entries"),
        (["one"], "no policy of row among the entries"),  # the game is that of the run
        (["one", "uniform", "--game", "round_games:Clash"], "one: trained as 'column'"),
        (["both", "astar"], "'astar': neither a folder of a run"),
    ):
        with pytest.raises(SystemExit):
            main(["league", *arguments, "--out", "m"])
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["uniform", "--game", "round_games:OddOneOut"], "has 3 players; a league needs two"),
        (["uniform", "--game", "round_games:Clash", "--maze", "3x3"], "it is for games in mazes"),
        (["equilibrium", "--game", "round_games:Clash"], "two players with opposite rewards"),
        (["astar", "--game", TWICE], "'astar': neither a folder of a run"),
        (["round_games:ballet", "--game", TWICE], "column plays 'ballet' in 0"),
        (["uniform", "--game", "round_games:Nothing"], "has no 'Nothing'"),
        (["uniform", "uniform", "--game", TWICE], "two entries are called 'uniform'"),
    ],
)
def test_wrong_leagues_are_refused_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["league", *arguments])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and message in said and said.count("\n") == 1
