"""Self-play in small games: a chase in both of its forms, and games with known equilibria."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trained_games import Chase

from pursuit.mazes.maze import load_maze
from pursuit.tasks.task import make_task
from scripted_agents import best_response, evaluate_exactly, solve_chase
from scripted_agents.games import (
    SmallGame,
    enumerate_game,
    equilibrium,
    game_of_task,
    nash_conv,
    respond,
    returns_of,
)
from train.evaluation.exploitability import exploitability
from train.kinds import start
from train.runs.folder import SELF_PLAY
from train.self_play.parts import self_play_settings_of

DISCOUNT = 0.95


# -- the chase in both forms -----------------------------------------------------------------------


def written(maze: str) -> SmallGame:
    return enumerate_game(Chase(maze))


def of_task(maze: str) -> SmallGame:
    return game_of_task(make_task("chase", maze=maze, rewards="zero_sum"))


def cells_of(game: SmallGame) -> list[tuple[int, int]]:
    """The cells of chaser and evader in every state; in games of tasks goals follow."""
    return [state[0] if isinstance(state[0], tuple) else state for state in game.states]  # type: ignore[misc, index]


def table_in(game: SmallGame, player: int, table: Any, moves: Any) -> Any:
    """A table [own cell, other cell, move] as one of the game, which can list only one of the moves
    that lead to the same cell."""
    rows = []
    for number, cells in enumerate(cells_of(game)):
        own, other = cells[player], cells[1 - player]
        legal = [int(action) for action in game.actions[player][number]]  # type: ignore[call-overload]
        if len(legal) == 4:
            rows.append(table[own, other])
        else:
            rows.append([table[own, other, moves[own] == moves[own, a]].sum() for a in legal])
    return np.concatenate(rows)


@pytest.mark.parametrize("form", [written, of_task])
@pytest.mark.parametrize("name", ["3x3", "5x5-tree"])
def test_all_exact_results_of_a_chase_are_those_of_the_maze_solvers(name: str, form: Any) -> None:
    maze, game = load_maze(name), form(name)
    pairs = tuple(np.array(cells_of(game)).T)
    known = solve_chase(maze, DISCOUNT)
    np.testing.assert_allclose(-equilibrium(game, DISCOUNT).values, known.values[pairs], atol=1e-9)
    random = np.random.default_rng(0)
    tables = random.dirichlet(np.full(4, 0.5), size=(2, maze.num_cells, maze.num_cells))
    names = game.players
    own = {
        name: table_in(game, seat, tables[seat], maze.neighbors[:, :4])
        for seat, name in enumerate(names)
    }
    met = evaluate_exactly(maze, *tables, horizon=None, discount=DISCOUNT)
    returns = returns_of(game, own, DISCOUNT)
    np.testing.assert_allclose(returns, np.stack([-met[pairs], met[pairs]], axis=1), atol=1e-9)
    for seat, role in enumerate(("chaser", "evader")):
        sign, other = (-1, 1)[seat], {names[1 - seat]: own[names[1 - seat]]}
        best = best_response(role, maze, tables[1 - seat], horizon=None, discount=DISCOUNT)  # type: ignore[arg-type]
        found = respond(game, names[seat], other, DISCOUNT)
        np.testing.assert_allclose(sign * found.values, best.values[pairs], atol=1e-9)
    gains = exploitability(maze, *tables, discount=DISCOUNT)
    found_gains = nash_conv(game, own, DISCOUNT)
    assert found_gains.nash_conv == pytest.approx(gains.nash_conv, abs=1e-8)


def nash_conv_after(folder: Path, **given: Any) -> float:
    """Of self-play with episodes of 20 steps, as the maze form has by default."""
    common = {"frames": 100_000, "episode_steps": 20, "threads": 1, **given}
    run = start(SELF_PLAY, self_play_settings_of(**common), folder)
    run.train()
    return float(run.trainee.evaluate()["nash_conv"])


@pytest.mark.slow
def test_self_play_solves_a_small_chase_in_both_forms(tmp_path: Path) -> None:
    """From a NashConv of 17.4 to one of less than 1e-8, with each of four seeds."""
    small = {"num_games": 64, "minibatch_size": 256}
    for observation in ("index", "observe"):
        found = nash_conv_after(
            tmp_path / observation, game="trained_games:Chase", observation=observation, **small
        )
        assert found < 1e-6
    assert nash_conv_after(tmp_path / "maze", maze="3x3", **small) < 1e-6


@pytest.mark.slow
def test_self_play_learns_a_chase_equally_fast_in_both_forms(tmp_path: Path) -> None:
    """With the same observation. The standard deviation over four seeds was 0.64 in the maze and
    0.46 in the game, at means of 11.1 and 11.8; 14.7 is that of untrained policies. With the number
    of the state as the observation the mean was 3.4."""
    small = {"num_games": 64, "minibatch_size": 256}
    means = []
    for form in (
        {"maze": "5x5-tree", "observation": "one_hot"},
        {"game": "trained_games:Chase(maze='5x5-tree')", "observation": "observe"},
    ):
        runs = (
            nash_conv_after(tmp_path / f"{len(means)}-{seed}", seed=seed, **small, **form)
            for seed in (0, 1)
        )
        means.append(np.mean([*runs]))
    assert max(means) < 13.5
    assert abs(means[0] - means[1]) < 3 * 0.65  # the standard error of a difference of two means
