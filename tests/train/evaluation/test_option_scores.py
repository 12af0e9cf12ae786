"""Scores, references and NashConv of tasks with options of the rules: turns, exits, slips."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pursuit.mazes.maze import Maze
from pursuit.replays.recorder import Recorder
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent, TablePolicy
from scripted_agents.exact.references import reference_of
from train.evaluation.contest import GameContest
from train.evaluation.games import Escapes, won_by
from train.evaluation.matchups import exact_match, match, pair_payoffs, play_pair
from train.evaluation.self_play_metrics import exploited
from train.play.session import Session
from train.self_play.parts import self_play_settings_of

WEST = 3
CORRIDOR = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")
SHORT = Maze.from_text("+-+-+-+\n|     |\n+-+-+-+")
CHASERS = AStarChaser(0.2)
EVADERS = AStarEvader(0.2)
CASES: dict[str, Task] = {
    "turns": make_task("chase", maze="3x3", move_order="turns", stay_action=True, max_steps=30),
    "drawn exits": make_task("escape", maze="3x3", max_steps=30),
    "exits in turns": make_task(
        "escape", maze="3x3", num_exits=1, move_order="turns", stay_action=True, max_steps=9
    ),
    "slips": make_task("chase", maze="3x3", slip={"evader": 0.3, "chaser": 0.1}, max_steps=30),
    "adjacent": make_task("chase", maze="3x3", num_chasers=2, capture="adjacent", max_steps=30),
}


def moves_west(maze: Maze, actions: int = 4) -> TablePolicy:
    """A policy that always moves west."""
    table = np.zeros((maze.num_cells, maze.num_cells, actions))
    table[..., WEST] = 1.0
    return TablePolicy(maze, table)


@pytest.mark.parametrize("case", CASES)
def test_exact_results_are_those_of_simulated_games(case: str) -> None:
    task, pair = CASES[case], {"chaser": CHASERS, "evader": EVADERS}
    exact, games = exact_match(task, pair), 4000
    assert exact is not None
    lengths, caught = play_pair(task, CHASERS, EVADERS, games)
    payoffs = pair_payoffs(task, CHASERS, EVADERS, games)
    for mean, sample in (
        (exact.steps, lengths), (exact.caught, caught), (exact.payoff, payoffs),
    ):  # fmt: skip
        assert abs(sample.mean() - mean) <= 4.5 * sample.std() / games**0.5 + 1e-6
    assert lengths.max() <= task.max_steps  # rounds


def test_in_turns_lengths_count_rounds() -> None:
    # Both move west, the chaser first. It captures a neighbor at once, and else reaches cell 0
    # after the evader, in round c; an evader at e > c enters the chaser's cell 0 in round e.
    task = Task(CORRIDOR, 1, 1, move_order="turns", stay_action=True, max_steps=6)
    west = moves_west(CORRIDOR, 5)
    contest = GameContest(task, "chaser", {"evader": west}, episodes=200)
    lengths, won = contest.play(west)
    chaser, evader = contest.starts().positions.T
    rounds = np.where(chaser == evader + 1, 1, np.maximum(chaser, evader))
    assert won.all() and (lengths == rounds).all() and len(set(rounds.tolist())) == 3
    exact = contest.score("own", west)
    cells = np.argwhere(~np.eye(4, dtype=bool)).T
    mean = np.where(cells[0] == cells[1] + 1, 1, cells.max(axis=0)).mean()
    assert exact.exact and exact.mean_steps == pytest.approx(mean)


def test_the_best_chaser_at_an_exit_has_a_closed_form() -> None:
    # Chasers move first, the evader always west to the exit in cell 0. Of the nine starts it
    # escapes only from 1 with the chaser in 3: nearer, the chaser is in time.
    task = Task(
        CORRIDOR, 1, 1, move_order="chasers_first", exits=[0], rewards="win_loss", max_steps=20
    )
    contest = GameContest(task, "chaser", {"evader": moves_west(CORRIDOR)}, episodes=50)
    assert contest.exact_reference.kind == "team"
    best = contest.optimal(contest.measure)
    assert best is not None and best.outcome == pytest.approx(7 / 9)
    assert contest.optimal() is None  # steps are no aim here
    # With 20 steps nothing is lost by the discount: it is captured from every other start.
    gap = contest.objective_gap(0.9).missing_return
    assert gap == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("role", ["chaser", "evader"])
@pytest.mark.parametrize("case", ["drawn exits", "exits in turns"])
def test_the_best_outcome_is_reached_and_beats_all_others(case: str, role: str) -> None:
    task = CASES[case]
    others = {"chaser": EVADERS, "evader": CHASERS}[role]
    other = {"chaser": "evader", "evader": "chaser"}[role]
    contest = GameContest(task, role, {other: others}, episodes=2000)
    best = contest.optimal(contest.measure)
    assert best is not None and best.outcome is not None
    response = contest.best_in(contest.measure)
    assert response is not None
    sample = contest.values(response.policy)
    assert abs(sample.mean() - best.outcome) <= 4.5 * sample.std() / len(sample) ** 0.5 + 1e-6
    assert sum(best.rates.values()) == pytest.approx(1.0)
    sign = 1.0 if role == "chaser" else -1.0
    for score in contest.baselines():
        assert sign * (score.outcome or 0.0) <= sign * best.outcome + 1e-9
        assert sum(score.rates.values()) == pytest.approx(1.0)


def test_nash_conv_of_an_escape_is_the_sum_of_both_gains() -> None:
    task, pair = CASES["drawn exits"], {"chaser": CHASERS, "evader": EVADERS}
    best = []
    for role, other in (("chaser", "evader"), ("evader", "chaser")):
        contest = GameContest(task, role, {other: pair[other]}, episodes=2)
        found = contest.optimal(contest.measure)
        assert found is not None and found.outcome is not None
        best.append(found.outcome)
    assert exploited(task, CHASERS, EVADERS, 0.9)["nash_conv"] == pytest.approx(best[0] - best[1])


def test_nash_conv_of_a_forced_capture_is_zero() -> None:
    # Two chasers are adjacent to the evader of a corridor of three cells after the first step,
    # whatever anybody does: all policies are equally good, and each step counts 1.
    task = Task(SHORT, 2, 1, capture="adjacent", slip=0.2)
    found = exploited(task, RandomAgent(), RandomAgent(), 0.9)
    assert found == {"nash_conv": pytest.approx(0.0, abs=1e-9)}


def test_a_game_with_an_escape_is_not_won_by_the_chasers() -> None:
    task = Task(CORRIDOR, 1, 2, exits=[3], rewards="win_loss")
    games = Simulator(task, 1, auto_restart=False)
    games.place([1, 0, 2])  # the chaser between; east: the second evader escapes
    escapes = Escapes(games)
    moves = iter([[2, 2, 2], [3, 2, 2]])
    step = escapes.after(lambda: games.step([next(moves)]))
    step()
    assert escapes.seen.tolist() == [[False, True]] and not games.ended[0]
    step()  # the chaser and the first evader swap cells
    assert escapes.captured.tolist() == [[True, False]] and games.terminated[0]
    assert [bool(won_by(games, seat, escapes.seen)[0]) for seat in range(3)] == [
        False, False, True,
    ]  # fmt: skip
    assert match(task, CHASERS, EVADERS, 50).plain().keys() >= {"escaped", "outcome"}


def test_without_options_results_have_no_new_fields() -> None:
    task = make_task("chase", maze="3x3")
    assert "escaped" not in match(task, CHASERS, EVADERS, 50).plain()
    score = GameContest(task, "chaser", {"evader": EVADERS}, episodes=2).score("own", CHASERS)
    assert not {"outcome", "escape_rate"} & set(score.plain())


def test_the_optimum_of_a_runner_that_slips_is_no_tour() -> None:
    # From the middle a move reaches the goal with q = 1 - slip / 2, and from the end there is only
    # one move: E1 = 1 + (1 - q) E0, E0 = 1 + E1; with slip 0.5 these are 5/3 and 8/3.
    task = Task(SHORT, num_runners=1, num_goals=1, slip=0.5, max_steps=500)
    contest = GameContest(task, "runner", {}, episodes=20)
    assert contest.exact_reference.kind == "joint" and contest.tours is None
    assert contest.best_in() is not None
    mean = (2 * 1 + 2 * 5 / 3 + 2 * 8 / 3) / 6
    assert contest.best_in().mean_over_starts == pytest.approx(mean)
    assert contest.score("own", NearestGoalRunner()).mean_steps > 1.0


@pytest.mark.parametrize("case", ["drawn exits", "slips", "exits in turns"])
def test_recorded_games_are_played_back(case: str) -> None:
    games = Simulator(CASES[case], 3, seed=5)
    recorder = Recorder(games)
    rng = np.random.default_rng(0)
    for _ in range(60):
        games.step(rng.integers(0, games.task.num_actions, (3, games.num_agents)))
    replay = recorder.stop()
    assert len(replay.episodes) > 2 and replay.check() == []
    again = replace(replay, task=replay.world.task(replay.world.settings(replay.task)))
    assert again.task.options == replay.task.options and again.check() == []


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_a_user_plays_only_the_own_half_of_rounds(role: str) -> None:
    task = CASES["turns"]
    other: Any = {"chaser": ("evader", EVADERS), "evader": ("chaser", CHASERS)}[role]
    contest = GameContest(task, role, dict([other]), episodes=2)
    session = Session(contest, "astar", {"chaser": CHASERS, "evader": EVADERS}[role], 3)
    moves = 0
    while not session.over:
        session.move(moves % 4)
        moves += 1
    outcome = session.outcomes[-1]
    assert outcome.steps == session.step == -(-int(session.simulator.steps[0]) // 2)
    assert moves <= outcome.steps <= moves + 1 and outcome.optimal_steps is not None


def test_references_name_the_kind_or_the_reason() -> None:
    pair = {"chaser": CHASERS, "evader": EVADERS}
    assert all(reference_of(task, "chaser", pair).kind == "team" for task in CASES.values())
    seen = replace(CASES["drawn exits"], view_radius=1)
    found = reference_of(seen, "chaser", pair)
    assert (found.kind, found.reason) == ("none", "limited view")


def test_self_play_with_exits_is_scored_by_captures() -> None:
    settings = self_play_settings_of(task="escape", maze="3x3", frames=1000)
    assert settings.task.rewards == "win_loss"
    with pytest.raises(ValueError, match="win_loss"):
        self_play_settings_of(task="escape", maze="3x3", frames=1000, rewards="zero_sum")
