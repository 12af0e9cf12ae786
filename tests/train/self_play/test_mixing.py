"""How much an equilibrium mixes, in the first line of a run of self-play."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from self_play_runs import sides_of_task

from pursuit.mazes.maze import load_maze
from pursuit.tasks.task import make_task
from scripted_agents import solve_chase
from scripted_agents.games import GameTask, load_game, mixed_share
from train.commands.main import main
from train.evaluation.self_play_text import describe_mixing


def visits_of_a_duel(maze_name: str, order: str) -> tuple[float, float]:
    """The discounted visits of equilibrium play in mixed states, and in all, step by step."""
    maze = load_maze(maze_name)
    solved = solve_chase(maze, 0.95, move_order=order)  # type: ignore[arg-type]
    cells = maze.num_cells
    now = np.where(np.eye(cells, dtype=bool), 0.0, 1.0)
    now /= now.sum()
    mixed = total = 0.0
    for step in range(400):
        total += 0.95**step * now.sum()
        mixed += 0.95**step * now[solved.mixed].sum()
        after = np.zeros_like(now)
        for chaser, evader in zip(*np.nonzero(now > 0.0), strict=True):
            one = solved.chaser_policy[chaser, evader]
            two = solved.evader_policy[evader, chaser]
            for a, b in zip(*np.nonzero(np.outer(one, two) > 0.0), strict=True):
                to, away = maze.neighbors[chaser, a], maze.neighbors[evader, b]
                swapped = (to, away) == (evader, chaser) and order == "simultaneous"
                met = to == evader if order == "chasers_first" else False
                if not (to == away or swapped or met):
                    after[to, away] += now[chaser, evader] * one[a] * two[b]
        now = after
    return mixed, total


@pytest.mark.parametrize(
    ("maze", "order"), [("3x3-open", "chasers_first"), ("4x4-open", "chasers_first")]
)
def test_the_share_of_a_duel_is_that_of_its_equilibrium(maze: str, order: str) -> None:
    task = make_task("chase", maze=maze, move_order=order, rewards="zero_sum")
    mixed, total = visits_of_a_duel(maze, order)
    assert mixed > 0.0
    assert sides_of_task(task).mixed_share() == pytest.approx(mixed / total, abs=1e-6)


def test_games_whose_share_is_not_known_and_games_in_turns() -> None:
    zero_sum = {"maze": "3x3-open", "rewards": "zero_sum"}
    turns = make_task("chase", **zero_sum, move_order="turns", stay_action=True)
    assert sides_of_task(turns).mixed_share() == 0.0
    for task in (
        make_task("chase", maze="15x15", rewards="zero_sum"),
        make_task("chase", maze="3x3-open"),  # other rewards
        make_task("chase", **zero_sum, view_radius=1),
        make_task("heist", maze="3x3", num_goals=1, rewards="zero_sum"),
    ):
        assert sides_of_task(task).mixed_share() is None
        assert describe_mixing(None) == []
    soccer = GameTask(load_game("soccer(rows=2,columns=4)"), "soccer")
    assert sides_of_task(soccer).mixed_share() == mixed_share(soccer.game, 0.95)


def test_the_first_lines_of_a_run_say_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ["--frames", "1024", "--num-games", "32", "--minibatch-size", "256", "--no-report"]
    game = "rock_paper_scissors(memory=False,rock_win=2)"
    main(["self-play", "--game", game, *small, "--out", str(tmp_path / "rps")])
    assert "optimal play is random in 100 % of its visits" in capsys.readouterr().out
    main(["self-play", "--maze", "3x3-tree", *small, "--out", str(tmp_path / "tree")])
    assert "pure play is optimal in every state that it visits" in capsys.readouterr().out
