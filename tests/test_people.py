"""People against runs and in leagues, by the games that they have played."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import make_run

from pursuit.policy import Policy
from scripted_agents import AStarChaser, AStarEvader, RandomAgent
from train.commands.main import main
from train.commands.play import PlayCommand, session_for, settings_of
from train.play.kept import LIST, Keeper
from train.play.seats import game_of_run, session_of
from train.self_play.league import with_guests
from train.self_play.people import enter_people, play_along
from train.self_play.ratings import elo_ratings, guest_half_width, openskill_ratings, pairwise_wins
from train.settings.task import TaskSettings


def play_as(policy: Policy, folder: Path, games: int, name: str = "Ann", **settings: Any) -> None:
    """Games of a person who moves as a policy does."""
    task = TaskSettings(**settings)
    session, keeper = session_of(task, "astar", 2**62), Keeper(folder, name, task)
    for _ in range(games):
        while not session.over:
            session.move(int(policy.act(session.simulator.view(session.own))[0]))
        keeper.keep(session)
        session.next_game()


def test_a_person_who_moves_as_an_entry_does_is_rated_as_that_entry(tmp_path: Path) -> None:
    play_as(AStarChaser(0.0), tmp_path / "ann", 30, maze="4x4")
    settings = TaskSettings(maze="4x4")
    session = session_of(settings, "astar", 0)
    (person,) = enter_people([tmp_path / "ann"], session.task)
    assert (person.name, person.role, len(person.games)) == ("Ann", "chaser", 30)
    (results,) = play_along([person], {"chaser": [RandomAgent(), AStarChaser(0.0)]})
    assert results.steps.shape == (3, 30)
    assert (results.steps[1] == results.steps[2]).all()
    assert results.steps[0].mean() > results.steps[1].mean()


def test_the_command_rates_people_with_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    play_as(AStarChaser(0.0), Path("ann"), 12, maze="4x4", opponent_epsilon=0.3)
    play_as(RandomAgent(), Path("bob"), 8, "Bob", maze="4x4", role="evader", opponent="random")
    play_as(AStarEvader(0.0), Path("bob"), 4, "Bob", maze="4x4", role="evader")
    main(["league", "ann", "bob", "astar", "random", "--games", "15", "--out", "l"])
    content = json.loads(Path("l/league.json").read_text())
    assert content["chasers"] == content["evaders"] == ["astar", "random"]
    ann = content["chaser_ratings"][-1]
    bob = content["evader_ratings"][-1]
    assert (ann["name"], ann["games_by_hand"], bob["name"], bob["games_by_hand"]) == (
        *("Ann", 12),
        *("Bob", 12),
    )
    by_name = {row["name"]: row["elo"] for row in content["chaser_ratings"]}
    assert (
        by_name["random"] < by_name["Ann"] and ann["elo_low"] < by_name["astar"] < ann["elo_high"]
    )
    assert ann["steps_against_nash"] is None
    printed = capsys.readouterr().out
    assert "Ann (by hand: 12)" in printed and "Bob (by hand: 12)" in printed
    main(["league", "astar", "random", "--maze", "4x4", "--games", "15", "--out", "alone"])
    alone = json.loads(Path("alone/league.json").read_text())
    assert alone["payoff"] == content["payoff"] and alone["nash"] == content["nash"]


def test_a_guest_changes_no_comparison_of_others_and_has_wide_doubts() -> None:
    rng = np.random.default_rng(0)
    wins = pairwise_wins(rng.integers(0, 20, (3, 4, 50)))
    wide, _, (part,) = with_guests(wins, 0, [rng.integers(0, 20, (4, 6))])
    assert (wide[:3, :3] == wins).all() and not wide[3].any() and not wide[:, 3].any()
    assert not part[:3, :3].any()
    assert np.allclose(part[3, :3] + part[:3, 3], 1.0)
    assert len(elo_ratings(wide, 0, [part])) == 4
    # By hand: against equals a game and a half win each way are two draws' worth of information.
    expected = 1.96 * 400 / np.log(10) / np.sqrt(2 * 0.25)
    assert guest_half_width(1500.0, [1500.0, 1500.0], 1) == pytest.approx(expected)
    assert guest_half_width(1500.0, [1500.0], 99) < expected / 7


def test_who_wins_all_games_by_hand_is_rated_above_those_who_played_along() -> None:
    results = np.tile(np.array([[5], [5]])[:, :, None], (1, 1, 30))
    games = np.concatenate([np.full((2, 12), 5), np.full((1, 12), 9)])
    (one, _), (two, _), (guest, doubt) = openskill_ratings(results, 0, [games])
    assert guest > max(one, two) + doubt
    assert openskill_ratings(results, 0) == openskill_ratings(results, 0, [])


def test_games_that_do_not_fit_or_were_changed_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    play_as(AStarChaser(0.0), Path("ann"), 2, maze="3x3")
    play_as(AStarChaser(0.0), Path("astar-like"), 1, "astar", maze="3x3")
    play_as(AStarChaser(0.0), Path("heist"), 1, maze="3x3", task="heist", num_goals=1)
    play_as(AStarChaser(0.0), Path("team"), 1, maze="3x3", num_chasers=2)
    play_as(AStarChaser(0.0), Path("other"), 1, maze="4x4")
    good = Path("ann", LIST).read_text()

    def refused(words: str, *entries: str) -> None:
        with pytest.raises(SystemExit) as ended:
            main(["league", *entries, "astar", "random", "--games", "2"])
        said = capsys.readouterr().err
        assert ended.value.code == 2 and words in said and said.count("\n") == 1, said

    refused("as an entry is called", "astar-like")
    refused("num_goals=1", "ann", "heist")
    refused("one against one", "ann", "team")
    refused("in maze 4x4, and the league in 3x3", "ann", "other")
    for old, new, words in (
        ('"game": 0', '"game": 9', "does not begin as game 9"),
        ('"seed": 4611686018427387904', '"seed": "x"', "a whole number expected"),
        ('"file": "game-0001.json"', '"file": "../ann/game-0001.json"', "are in this folder"),
        ('"opponent": null', '"opponent": "evil.code:Name"', "--allow evil"),
        ('"format": 1', '"format": 2', "format 1 needed"),
        ('"role": "auto"', '"role": 3', "restore it from a copy"),
        ("{", "[", "damaged"),
        ('"task": "chase"', '"task": "reacher"', "is of an arm"),
    ):
        assert old in good
        Path("ann", LIST).write_text(good.replace(old, new, 1))
        refused(words, "ann")
    Path("ann", LIST).write_text(good)
    replay = Path("ann", "game-0002.json")
    text = replay.read_text()
    changed = text.replace('"digest": "', '"digest": "0')
    assert changed != text
    replay.write_text(changed)
    refused("plays differently now", "ann")
    replay.unlink()
    refused("cannot be read", "ann")


def test_a_person_plays_the_game_of_a_run_against_it(tmp_path: Path) -> None:
    run = make_run(tmp_path / "pair", frames=2000, task={"max_steps": 50})
    run.train()
    pair, chaser = str(tmp_path / "pair"), str(tmp_path / "pair" / "chaser")
    for against in (pair, chaser):
        game = game_of_run(against)
        assert game is not None
        assert (game.maze, game.role, game.max_steps, game.opponent) == ("3x3", "evader", 50, None)
    assert game_of_run("astar") is None
    game = game_of_run(pair)
    given = PlayCommand(game, against=pair, seed=0)  # type: ignore[arg-type]
    session = session_for(given, settings_of(given))
    while not session.over:
        session.move(0)
    (outcome,) = session.outcomes
    assert outcome.agent == "pair" and outcome.least is not None
    assert session.players() == {"chaser_0": chaser}
    with pytest.raises(ValueError, match="learned in maze 3x3, and the games are in 4x4"):
        session_of(TaskSettings(maze="4x4", role="evader", opponent=chaser), "astar", 0)
    with pytest.raises(ValueError, match="learned to be 'chaser'; 'evader' is asked for"):
        session_of(TaskSettings(maze="3x3", role="evader"), chaser, 0)
