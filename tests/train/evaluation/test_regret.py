"""What states cost sums up to the whole gap, and nothing is lost by whoever is optimal."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pursuit import load_maze
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    RandomAgent,
    TourRunner,
    best_response,
    duel_regret,
    evaluate_exactly,
    mean_over_starts,
)
from train.commands.main import main
from train.evaluation.regret import group_rows, regret_of, runner_gaps
from train.runs.parts import contest_of
from train.settings.task import TaskSettings

MAZE = load_maze("3x3")


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["simultaneous", "chasers_first"]))
def test_what_the_states_of_a_duel_cost_is_all_that_is_lost(seed: int, order: Any) -> None:
    rng = np.random.default_rng(seed)
    tables = rng.dirichlet(np.ones(5), size=(2, 9, 9))
    chaser, evader = tables
    steps = mean_over_starts(evaluate_exactly(MAZE, chaser, evader, 30, move_order=order), MAZE, 2)
    for role, own, other in (("chaser", chaser, evader), ("evader", evader, chaser)):
        found = duel_regret(role, MAZE, own, other, 30, order, 2)  # type: ignore[arg-type]
        best = best_response(role, MAZE, other, 30, move_order=order)  # type: ignore[arg-type]
        optimum = mean_over_starts(best.values, MAZE, 2)
        assert found.optimum == pytest.approx(optimum) and found.achieved == pytest.approx(steps)
        assert found.regret.sum() == pytest.approx(abs(steps - optimum))
        assert found.visits.sum() == pytest.approx(steps)  # a step is spent in each state
        assert (found.regret >= 0.0).all() and (found.visits[np.eye(9, dtype=bool)] == 0.0).all()


def test_a_policy_that_errs_in_one_state_loses_there_alone() -> None:
    evader = AStarEvader(0.2).action_probabilities(MAZE)
    own = best_response("chaser", MAZE, evader, 200).policy.copy()
    right = duel_regret("chaser", MAZE, own, evader, 200)
    assert right.regret.sum() == pytest.approx(0.0, abs=1e-9)
    state = np.unravel_index(np.argmax(right.action_gap * (right.visits > 0.1)), (9, 9))
    own[state] = np.roll(own[state], 1)
    wrong = duel_regret("chaser", MAZE, own, evader, 200)
    assert wrong.regret[state] > 0.0
    assert wrong.regret.sum() - wrong.regret[state] == pytest.approx(0.0, abs=1e-6)
    # What one wrong move costs is no less than the gap between the best and the second best.
    assert wrong.regret[state] >= wrong.visits[state] * wrong.action_gap[state] - 1e-9


RUNNER = TaskSettings(task="maze", maze="5x5", num_goals=3, max_steps=60)


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_what_a_runner_loses_is_its_steps_less_the_shortest_tours(epsilon: float) -> None:
    contest = contest_of(RUNNER, 300, 0)
    policy = NearestGoalRunner(epsilon)
    lengths, won = contest.play(policy)
    found = regret_of(contest, policy)
    assert found.achieved == pytest.approx(lengths.mean())
    assert found.optimum == pytest.approx(contest.tours.mean())
    assert found.lost.sum() == pytest.approx(lengths.mean() - found.optimum)
    assert found.visits.sum() == pytest.approx(lengths.mean())
    assert (found.lost >= 0.0).all()  # no step makes the rest shorter than by one
    for by in {row["by"] for row in group_rows(found)}:
        rows = [row for row in group_rows(found) if row["by"] == by]
        assert sum(row["lost"] for row in rows) == pytest.approx(found.lost.sum())
        assert sum(row["share"] for row in rows) == pytest.approx(1.0)
    if epsilon == 1.0:  # what late games lose is the limit less their tours
        lost = (60 - contest.tours[~won]).sum() / (lengths - contest.tours).sum()
        assert found.unsolved == pytest.approx(lost)


def test_whoever_takes_the_shortest_tour_loses_nothing() -> None:
    found = regret_of(contest_of(RUNNER, 100, 0), TourRunner())
    assert found.lost.sum() == 0.0 == found.unsolved and found.achieved == found.optimum


def test_the_action_gap_of_a_runner_in_a_corridor_is_the_way_back() -> None:
    maze = load_maze("3x3-tree")
    ends = [cell for cell in range(9) if (maze.neighbors[cell] != cell).sum() == 2]
    cells = np.array(ends)
    goals = maze.neighbors[cells, (maze.neighbors[cells] != cells[:, None]).argmax(axis=1)]
    assert (runner_gaps(maze, cells, goals[:, None]) == 2.0).all()  # a step away, and back


@pytest.mark.parametrize(
    ("task", "by"),
    [
        ("maze --num-goals 2", "goals left"),
        pytest.param("chase", "distance between both", marks=pytest.mark.slow),
    ],
)
def test_the_command_says_where(
    task: str, by: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = f"train --task {task} --maze 3x3 --frames 2000 --num-games 32 --minibatch-size 128 "
    main((command + f"--episodes 20 --threads 1 --out {tmp_path}/run").split())
    capsys.readouterr()
    main(f"regret {tmp_path}/run --episodes 50 --sampled".split())
    told = capsys.readouterr().out
    assert by in told and "The worst states" in told and "sampled policy" in told
    for file in ("table.csv", "states.csv", "regret.md", "map.png"):
        assert (tmp_path / "run" / "regret" / file).stat().st_size > 100


def test_what_has_no_such_optimum_is_refused() -> None:
    team = TaskSettings(task="chase", maze="3x3", num_chasers=2)
    with pytest.raises(ValueError, match="a duel of tables or of a runner alone"):
        regret_of(contest_of(team, 5, 0), RandomAgent())
    hidden = TaskSettings(task="chase", maze="3x3", view_radius="chaser=1")
    with pytest.raises(ValueError, match="limited sight"):
        regret_of(contest_of(hidden, 5, 0), AStarChaser())
