"""Elo and exploitability of snapshots: against enumeration, equilibria and cases made by hand."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from self_play_runs import make_run

from pursuit import load_maze, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    RandomAgent,
    duel_wins,
    evaluate_exactly,
    mean_over_starts,
    solve_chase,
)
from train.commands.main import main
from train.commands.snapshots import snapshot_table
from train.evaluation import exploitability
from train.self_play.past import (
    GAMES,
    Standings,
    agreement,
    exploitabilities,
    parted,
    parted_by_distance,
    read_past,
    rows_of,
    standings,
    widest,
)
from train.self_play.ratings import elo_of, elo_ratings

MAZE = load_maze("5x5-tree")


def ends(maze: Any, chaser: Any, evader: Any, own: int, other: int, left: int) -> Any:
    """[left] chance that the game is over after each number of steps, by plain recursion."""
    found = np.zeros(left)
    if left == 1:
        return np.ones(1)  # cut
    for one, two in product(range(4), range(4)):
        chance = chaser[own, other, one] * evader[other, own, two]
        mine, theirs = maze.neighbors[own, one], maze.neighbors[other, two]
        if mine == theirs or (mine == other and theirs == own):
            found[0] += chance
        elif chance:
            found[1:] += chance * ends(maze, chaser, evader, mine, theirs, left - 1)
    return found


def test_whoever_captures_sooner_wins_as_plain_enumeration_counts_it() -> None:
    maze, horizon = load_maze("2x2-tree"), 3
    rng = np.random.default_rng(0)
    chasers, evaders = rng.dirichlet(np.ones(4), size=(2, 2, 4, 4))
    pairs = [(own, other) for own, other in product(range(4), range(4)) if own != other]
    sooner = np.zeros((2, 2))
    for evader, (own, other) in product(evaders, pairs):
        of = [ends(maze, chaser, evader, own, other, horizon) for chaser in chasers]
        for i, k in product(range(2), range(2)):
            for first, second in product(range(horizon), range(horizon)):
                won = 1.0 if first < second else 0.5 * (first == second)
                sooner[i, k] += of[i][first] * of[k][second] * won / (2 * len(pairs))
    wins, steps = duel_wins("chaser", maze, chasers, evaders, horizon)
    assert wins == pytest.approx(sooner)
    for i, j in product(range(2), range(2)):
        values = evaluate_exactly(maze, chasers[i], evaders[j], horizon)
        assert steps[i, j] == pytest.approx(mean_over_starts(values, maze))
    # The other side's steps are the same, and of two players each wins what the other does not.
    back, turned = duel_wins("evader", maze, evaders, chasers, horizon)
    assert turned == pytest.approx(steps.T) and back + back.T == pytest.approx(1.0)


def test_tables_of_four_and_of_five_actions_are_not_compared() -> None:
    four, five = (AStarChaser(0.2).action_probabilities(MAZE, stay) for stay in (False, True))
    evader = AStarEvader(0.2).action_probabilities(MAZE)
    with pytest.raises(ValueError, match=r"tables over 4 and 5 actions; .*give all of them"):
        duel_wins("chaser", MAZE, [four, five], [evader])


def test_who_moves_first_and_how_far_apart_they_start_is_as_in_the_game() -> None:
    chasers = [AStarChaser(epsilon).action_probabilities(MAZE) for epsilon in (0.0, 0.5)]
    evader = AStarEvader(0.2).action_probabilities(MAZE)
    _, steps = duel_wins("chaser", MAZE, chasers, [evader], 50, "chasers_first", 4)
    for number, chaser in enumerate(chasers):
        values = evaluate_exactly(MAZE, chaser, evader, 50, move_order="chasers_first")
        assert steps[number, 0] == pytest.approx(mean_over_starts(values, MAZE, 4))


def test_elo_of_chasers_that_err_more_and_more_falls() -> None:
    chasers = [AStarChaser(e).action_probabilities(MAZE) for e in (0.0, 0.25, 0.5, 1.0)]
    evaders = [AStarEvader(e).action_probabilities(MAZE) for e in (0.2, 1.0)]
    wins, _ = duel_wins("chaser", MAZE, chasers, evaders)
    elo = elo_of(wins, 200)
    assert (np.diff(elo) < -20.0).all() and elo.mean() == pytest.approx(1500.0)
    many = np.repeat(wins[:, :, None], 200, axis=2)  # games in which each wins its share
    assert elo == pytest.approx([rating for rating, _, _ in elo_ratings(many)])
    assert elo_of(wins[:1, :1], 200).tolist() == [1500.0]
    # The half win each way draws ratings together: 200 games are not the limit of many.
    assert np.ptp(elo) < np.ptp(elo_of(wins, 20_000))


@pytest.mark.parametrize("order", ["simultaneous", "chasers_first"])
def test_exploitability_is_nothing_in_an_equilibrium_and_else_that_of_the_pair(order: Any) -> None:
    task = make_task("chase", maze=MAZE, move_order=order)
    game = solve_chase(MAZE, 0.95, move_order=order)
    chance = RandomAgent().action_probabilities(MAZE)
    pair = exploitability(MAZE, chance, chance, move_order=order)
    for role, perfect, expected in (
        ("chaser", game.chaser_policy, pair.mean_chaser),
        ("evader", game.evader_policy, pair.mean_evader),
    ):
        found = exploitabilities(task, role, [perfect, chance], 0.95)
        assert found == pytest.approx([0.0, expected], abs=1e-6) and expected > 0.1


def standing(elo: list[float], gain: list[float]) -> Standings:
    count = len(elo)
    names = [str(number) for number in range(count)]
    return Standings(
        "chaser", names, np.arange(count), np.array(elo), np.array(gain), np.zeros((count, 1))
    )


def test_kendalls_tau_and_what_parts_of_a_case_made_by_hand() -> None:
    one = standing([1.0, 2.0, 3.0, 4.0], [9.0, 5.0, 6.0, 7.0])
    # By Elo 3, 2, 1, 0; by exploitability 1, 2, 3, 0: the three pairs among 1, 2, 3 part.
    assert {(a, b) for a, b in np.argwhere(parted(one)) if a < b} == {(1, 2), (1, 3), (2, 3)}
    found = agreement(one)
    assert found["whole"] == pytest.approx((3 - 3) / 6) and found["whole_p"] == 1.0
    assert found["second_half"] == pytest.approx(-1.0)
    assert found["elo_time"] == 1.0 and found["exploitability_time"] == 0.0
    shares = {row["least"]: (row["pairs"], row["parted"]) for row in parted_by_distance(one)}
    assert shares == {1: (3, pytest.approx(2 / 3)), 2: (3, pytest.approx(1 / 3))}
    assert widest(one, 1) == [(3, 1)]  # first by Elo, third by exploitability
    assert f"Elo ({GAMES} games a pair)" in snapshot_table(rows_of(one)).markdown()
    alike = standing([1.0, 2.0, 3.0], [3.0, 2.0, 1.0])
    assert agreement(alike)["whole"] == 1.0 and not parted(alike).any() and widest(alike) == []


@pytest.mark.slow
def test_the_command_orders_the_snapshots_of_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = make_run(tmp_path / "pair", task={"maze": "3x3-tree"}, frames=10_240)
    run.train()
    last = run.metrics.rows[-1]
    run.lock.release()
    past = read_past(tmp_path / "pair")
    assert past.frames["chaser"].tolist() == [2048.0, 4096.0, 6144.0, 8192.0, 10240.0]
    found = standings(past)
    for role, one in found.items():  # the last snapshot is taken as the budget ends
        assert one.exploitability[-1] == pytest.approx(last[f"{role}_exploitability"], abs=1e-5)
    assert found["chaser"].steps == pytest.approx(found["evader"].steps.T)
    capsys.readouterr()
    main(["snapshots", str(tmp_path / "pair")])
    told = capsys.readouterr().out
    assert "chaser: Kendall's tau" in told and "| evader | 1 | 4 |" in told
    out = tmp_path / "pair" / "snapshots"
    for file in ("table.csv", "table.tex", "payoff.csv", "snapshots.md", "snapshots.png"):
        assert (out / file).stat().st_size > 100
    content = json.loads((out / "snapshots.json").read_text())
    assert content["tau"]["evader"]["whole"] == agreement(found["evader"])["whole"]
    twice = [str(tmp_path / "pair")] * 2
    main(["snapshots", *twice, "--out", str(tmp_path / "both")])
    assert "| mean |" in (tmp_path / "both" / "snapshots.md").read_text()


def test_what_has_no_snapshots_to_order_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such folder"):
        read_past(tmp_path / "none")
    make_run(tmp_path / "few").lock.release()
    with pytest.raises(ValueError, match="0 snapshots of the chaser; at least 4"):
        read_past(tmp_path / "few")
    make_run(tmp_path / "frozen", evader="astar").lock.release()
    with pytest.raises(ValueError, match="only the chaser learned"):
        read_past(tmp_path / "frozen")
