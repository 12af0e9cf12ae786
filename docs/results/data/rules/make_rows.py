"""Compute the rows of docs/results/rules.md: exact values of chases with options of the rules.

    python docs/results/data/rules/make_rows.py [--short] [--out FOLDER]

It writes `capture.csv`, `classical.csv` and `escape.csv`. Rows that exist are kept, so that an
interrupted run goes on; `--short` adds only the rows that take about a second.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations, combinations_with_replacement, permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from pursuit.compilation.compiled import compiled
from pursuit.mazes.generation import generate_graph
from pursuit.mazes.maze import Maze, load_maze
from pursuit.tasks.task import Task
from scripted_agents import AStarChaser, AStarEvader, evaluate_joint, solve_joint
from scripted_agents.agents.table_policy import TablePolicy
from scripted_agents.exact.joint.equilibrium import team_chase_game
from scripted_agents.exact.joint.shapley_iteration import solve_infinite_horizon, solve_steps
from scripted_agents.exact.joint.states import joint_states_of
from scripted_agents.exact.joint.sweeps import Quantity
from train.evaluation.games import half_width
from train.evaluation.matchups import play_pair
from train.files import read_csv, write_csv
from train.machine import processor

OUT = Path(__file__).parent
DISCOUNT = 0.95
"""Of a step in the equilibrium values of `capture.csv`: 20 steps if there is never a capture."""
HORIZON = 100
"""Steps of a game in `escape.csv`."""
EPISODES, LONGEST = 4000, 2000
"""Of the simulations in `classical.csv`."""
Key = tuple[str, ...]
Row = dict[str, str]

# -- what captures -------------------------------------------------------------------------------

MAZES = ("3x3-open", "3x3", "4x4-open", "4x4", "5x5-open", "5x5")
RULES: dict[str, dict[str, Any]] = {
    "cell": {},
    "cell, n_catch=2": {"n_catch": 2},
    "adjacent": {"capture": "adjacent"},
    "surround": {"capture": "surround"},
    "surround, block": {"capture": "surround", "collisions": "block"},
}


def symmetries(maze: Maze) -> NDArray[np.int64]:
    """[n, cells]: the cells of a square maze after its rotations and reflections that keep it."""
    square = np.arange(maze.num_cells).reshape(maze.height, maze.width)
    turned = [np.rot90(side, turns).ravel() for side in (square, square.T) for turns in range(4)]
    near = maze.distances == 1
    return np.array([after for after in turned if (near[np.ix_(after, after)] == near).all()])


@compiled
def find_sure_states(following: Any, pairs: Any, shape: Any, sure: Any, found: Any) -> None:
    """Remove from `sure` [states] those in which the column player cannot end the game surely.

    The greatest set in which it has options that never leave the set, and by mixing these reaches
    the end with probability 1 (de Alfaro, Henzinger and Kupferman, 2007). `found` is scratch.
    """
    size, last = len(sure), -1
    while size != last:
        last, size, before = size, 0, -1
        found[:] = False
        while size != before:
            before = size
            for state in range(len(sure)):
                rows = shape[state, 2]
                if found[state] or not sure[state] or rows == 0:
                    continue
                columns, reached = shape[state, 0] // rows, 0
                for column in range(columns):
                    hits, stays = 0, True
                    for row in range(rows):
                        after = following[pairs[state] + row * columns + column]
                        stays &= after < 0 or sure[after]
                        hits |= (after < 0 or found[after]) << row
                    if stays:
                        reached |= hits
                found[state] = reached == (1 << rows) - 1
                size += found[state]
        for state in range(len(sure)):
            sure[state] = found[state]


def capture_in_turns(maze: Maze, chasers: int, rule: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """The game in which the evader sees the chasers' move before it moves, by retrograde analysis.

    Returns:
        [teams, chasers], the cells of the chasers in order, and [teams, evader cell] int64, the
        rounds until capture, the chasers to move; 0 if it cannot be forced.
    """
    cells, options = maze.num_cells, RULES[rule]
    teams = np.array(list(combinations_with_replacement(range(cells), chasers)))
    number = np.zeros((cells,) * chasers, dtype=np.int32)
    number[tuple(teams.T)] = np.arange(len(teams))
    parts = np.indices((5,) * chasers).reshape(chasers, -1)
    moved = np.stack([maze.neighbors[teams[:, c]][:, parts[c]] for c in range(chasers)], axis=2)
    after = number[tuple(np.moveaxis(np.sort(moved.astype(np.uint8), axis=2), 2, 0))]
    starts = np.arange(len(teams) + 1) * after.shape[1]
    many, size = np.ones(after.size, dtype=np.int32), (len(teams), len(teams))
    moves: Any = csr_array((many, after.ravel(), starts), shape=size)
    moves.sum_duplicates()
    if options.get("capture") == "surround":
        held = (teams[:, :, None] == np.arange(cells)).any(axis=1)
        captured = (held[:, None] | (maze.distances != 1)).all(axis=2)
    else:
        near = maze.distances[teams] <= int("capture" in options)
        captured = near.sum(axis=1) >= options.get("n_catch", 1)
    rounds = np.zeros(captured.shape, dtype=np.int64)
    new = captured
    while new.any():
        won = captured | (rounds > 0)
        trapped = captured | won[:, maze.neighbors[:, :5]].all(axis=2)
        new = (moves @ trapped.astype(np.int32) > 0) & (rounds == 0)
        rounds[new] = rounds.max() + 1
    return teams, rounds


def solved(task: Task) -> tuple[float, NDArray[Any]]:
    """The share of the starts from which the chasers capture with probability 1 whatever the evader
    does, and the equilibrium values of all starts."""
    payoff = Quantity([0] * task.num_agents, [1] * task.num_agents)
    game, twins = team_chase_game(task, payoff, DISCOUNT, symmetries(task.mazes[0]))
    sure, store = game.playing.copy(), game.store
    find_sure_states(store.following, store.pairs, store.shape, sure, np.zeros_like(sure))
    values, _ = solve_infinite_horizon(game)
    starts = twins[np.concatenate(list(joint_states_of(task).starts()))]
    return float(sure[starts].mean()), values[starts]


def capture_row(name: str, rule: str, chasers: str) -> list[Any]:
    """A row of `capture.csv`: the game at once, and the game in turns."""
    maze, count = load_maze(name), int(chasers)
    task = Task(maze=maze, num_chasers=count, num_evaders=1, stay_action=True, **RULES[rule])
    row: list[Any] = [None] * 4
    fits = count < 4 or maze.num_cells <= 16  # into 4 GB
    if fits:
        row[0], values = solved(task)
        row[1] = values.mean()
    if task.collisions == "share":
        teams, rounds = capture_in_turns(maze, count, rule)
        alone = np.diff(teams, axis=1).all(axis=1)
        held = (teams[:, :, None] == np.arange(maze.num_cells)).any(axis=1)
        rounds = rounds[alone[:, None] & ~held]
        row[2:] = (rounds > 0).mean(), rounds.max()
    elif fits:
        row[2], values = solved(replace(task, move_order="turns"))
        ends = values[values < 1.0 / (1.0 - DISCOUNT) - 1e-6]  # after whole numbers of rounds
        row[3] = round(np.log1p((DISCOUNT - 1.0) * ends.max(initial=0.0)) / np.log(DISCOUNT))
    return row


# -- the classical domain --------------------------------------------------------------------------


@compiled
def list_following(
    teams: Any, number: Any, moves: Any, minus: Any, near: Any, needed: int, phases: Any,
    work: Any, following: Any,
) -> None:  # fmt: skip
    """What follows each team of predators: `following` [teams, joint moves, moves of the prey].

    Cells are relative to the prey, the last agent, in cell 0. A move is cancelled if another agent
    was in its target before the phase, or has the same target. The prey is captured (-1) by
    `needed` predators next to it.

    Args:
        teams: [teams, predators], the cells in order; number: [cells ** predators], the team.
        moves: [cells, 5], the cell after each move; minus: [cells, cells], their difference; near:
            [cells], whether the prey's cell is next to it.
        needed: predators next to a captured prey; phases: [n, 2], the agents that move at once.
        work: [3, agents] int64, scratch; following: written.
    """
    count, (before, target, after) = teams.shape[1], work
    for team in range(len(teams)):
        before[count] = 0
        for i in range(count):
            before[i] = teams[team, i]
        for joint in range(following.shape[1]):
            for move in range(following.shape[2]):
                rest, after[count], target[count] = joint, 0, moves[0, move]
                for i in range(count):
                    after[i] = before[i]
                    target[i], rest = moves[before[i], rest % 5], rest // 5
                held = 0
                for phase in range(len(phases)):
                    first, last = phases[phase]
                    for i in range(first, last):
                        free = True
                        for j in range(count + 1):
                            moves_too = first <= j < last
                            cell = before[j] if moves_too else after[j]
                            same = moves_too and target[j] == target[i]
                            if j != i and (cell == target[i] or same):
                                free = False
                        if free:
                            after[i] = target[i]
                    held = 0
                    for i in range(count):
                        held += near[minus[after[i], after[count]]]
                    if held >= needed:
                        break
                place = 0
                for i in range(count):
                    place = place * len(moves) + minus[after[i], after[count]]
                following[team, joint, move] = -1 if held >= needed else number[place]


def least_mean_steps(
    size: int, predators: int, needed: int, order: str, prey_moves: int
) -> NDArray[np.float64]:
    """[teams] float64: the least expected steps until a random prey on a torus is captured, from
    each unordered set of different cells of the predators; cells are not shared."""
    torus = generate_graph("torus", size, size)
    rows, columns = np.divmod(np.arange(torus.num_cells), size)
    minus = (rows[:, None] - rows) % size * size + (columns[:, None] - columns) % size
    teams = np.array(list(combinations(range(1, torus.num_cells), predators)))
    number = np.full((torus.num_cells,) * predators, -1, dtype=np.int32)
    for places in permutations(range(predators)):
        number[tuple(teams[:, list(places)].T)] = np.arange(len(teams))
    following = np.empty((len(teams), 5**predators, prey_moves), dtype=np.int32)
    agents, moves = predators + 1, np.ascontiguousarray(torus.neighbors[:, :5])
    phases = [(0, predators), (predators, agents)] if order == "chasers_first" else [(0, agents)]
    list_following(
        teams, number.ravel(), moves, minus, torus.distances[0] == 1, needed, np.array(phases),
        np.zeros((3, agents), dtype=np.int64), following,
    )  # fmt: skip
    values, change = np.zeros(len(teams)), 1.0
    while change > 1e-9:
        before = values
        values = 1.0 + np.append(values, 0.0)[following].mean(axis=2).min(axis=1)
        change = float(np.abs(values - before).max())
    return values


def prey_table(cells: int, moves: int) -> NDArray[np.float64]:
    """[own cell, other cell, action]: a prey that draws from four moves, or from these and stay."""
    return np.broadcast_to((np.arange(5) < moves) / moves, (cells, cells, 5))


def classical_row(order: str, prey_moves: str) -> list[Any]:
    """A row of `classical.csv`: the optimum, and the scripted team by simulation."""
    values = least_mean_steps(5, 4, 4, order, int(prey_moves))
    task = Task(
        maze=generate_graph("torus", 5, 5), num_chasers=4, num_evaders=1, stay_action=True,
        capture="surround", collisions="block", move_order=order, max_steps=LONGEST,
    )  # fmt: skip
    prey = TablePolicy(task.mazes[0], prey_table(25, int(prey_moves)))
    steps, captured = play_pair(task, AStarChaser(), prey, EPISODES)
    scripted = (steps.mean(), half_width(steps), captured.mean())
    return [len(values), values.mean(), values.max(), *scripted]


# -- exits -----------------------------------------------------------------------------------------


def road_network() -> tuple[Maze, list[int]]:
    """The road network, and four exits: the first cell, and each time the cell farthest from all
    exits before."""
    maze, exits = generate_graph("roads", 5, 5, seed=0), [0]
    while len(exits) < 4:
        exits.append(int(maze.distances[exits].min(axis=0).argmax()))
    return maze, exits


def escape_row(chasers: str, exits: str) -> list[Any]:
    """A row of `escape.csv`: P(capture) - P(escape) within HORIZON steps, mean over the starts."""
    count, (maze, cells) = int(chasers), road_network()
    task = Task(
        maze=maze, num_chasers=count, num_evaders=1, exits=cells[: int(exits)],
        rewards="win_loss", stay_action=True, max_steps=HORIZON,
    )  # fmt: skip
    scripted = {"chaser": AStarChaser(), "evader": AStarEvader()}
    best = {role: solve_joint(task, role, scripted, HORIZON, objective="return").mean_over_starts
            for role in scripted}  # fmt: skip
    both = evaluate_joint(task, scripted, HORIZON, agents="evader").returns["evader_0"]
    game, twins = team_chase_game(task, Quantity([0] * count + [1], [0] * (count + 1)), 1.0)
    values, _ = solve_steps(game, HORIZON)
    equilibrium = -float(joint_states_of(task).mean_over_starts(values[twins]))
    return [best["chaser"] / count, equilibrium, -both, -best["evader"]]


# -- files -----------------------------------------------------------------------------------------

COLUMNS: dict[str, tuple[Callable[..., list[Any]], str, str]] = {
    "capture": (capture_row, "maze rule chasers", "forced mean_steps turns_forced turns_rounds"),
    "classical": (
        classical_row,
        "order prey_moves",
        "states mean_steps worst_start scripted_steps scripted_ci95 scripted_captured",
    ),
    "escape": (escape_row, "chasers exits", "best_chasers equilibrium scripted best_evader"),
}
"""By file: what computes a row, what names it, and what it holds beside `seconds`."""


def keys(short: bool = False) -> Iterator[tuple[str, Key]]:
    """The rows of all files: the file, and what names the row."""
    for maze in MAZES[: 2 if short else None]:
        for rule in RULES:
            for chasers in "12" if short else "1234":
                if RULES[rule].get("n_catch", 1) <= int(chasers):
                    yield "capture", (maze, rule, chasers)
    for chasers in "12" if short else "123":
        yield from (("escape", (chasers, exits)) for exits in "1234")
    for order in () if short else ("simultaneous", "chasers_first"):
        yield from (("classical", (order, moves)) for moves in "45")


def read(path: Path) -> list[Row]:
    """The rows of a file; none if there is no file."""
    return read_csv(path) if path.exists() else []


def add_row(folder: Path, name: str, key: Key) -> Row:
    """Compute a row, unless the file has it, and write it at the end of the file."""
    compute, names, columns = COLUMNS[name]
    path = folder / f"{name}.csv"
    rows, named = read(path), dict(zip(names.split(), key, strict=True))
    for row in rows:
        if named.items() <= row.items():
            return row
    begun = time.process_time()
    found = dict(zip(columns.split(), compute(*key), strict=True))
    found["seconds"] = round(time.process_time() - begun, 2)
    row = named | {
        column: "" if value is None else f"{value:.6f}".rstrip("0").rstrip(".")
        for column, value in found.items()
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(path, [*rows, row])
    return row


def main() -> None:
    """Compute all rows that are missing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="only rows that take about a second")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the files")
    options = parser.parse_args()
    for name, key in keys(options.short):
        print(name, *add_row(options.out, name, key).values(), sep=", ", flush=True)
    total = sum(
        float(row["seconds"]) for name in COLUMNS for row in read(options.out / f"{name}.csv")
    )
    print(f"{processor()}: {total / 60:.1f} core minutes for all rows")


if __name__ == "__main__":
    main()
