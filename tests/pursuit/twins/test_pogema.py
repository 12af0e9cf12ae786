"""`collisions="block"` and POGEMA's `collision_system="block_both"`.

POGEMA needs older versions of NumPy and Gymnasium, so its rule is stated here, as read in
`Pogema.move_agents` of `pogema/envs.py`, version 1.4.0. (Run with that version beside this test,
the moves were equal, too.) Its actions: 0 stays, 1 to 4 are north, south, west and east.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task

POGEMA_MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))  # row, column
OURS = np.array([4, 0, 1, 3, 2])  # our action for each of these
AGENTS, GAMES, STEPS = 8, 400, 5
# The evader is enclosed, so that the chasers are agents of one role on a map with obstacles.
MAP = """
.....#.
.#.....
...##..
.......
.#...##
.....#.
"""


def block_both(
    places: list[tuple[int, int]], actions: list[int], free: set[tuple[int, int]]
) -> list[tuple[int, int]]:
    """The places after a step: nobody enters a place that had an agent before, nor one that two or
    more agents want to enter; nobody enters an obstacle."""
    aims = [
        (row + POGEMA_MOVES[action][0], column + POGEMA_MOVES[action][1])
        for (row, column), action in zip(places, actions, strict=True)
    ]
    wanted = Counter(aims)
    return [
        aim if aim in free and wanted[aim] == 1 and aim not in places else place
        for place, aim in zip(places, aims, strict=True)
    ]


def test_random_positions_have_the_same_moves() -> None:
    drawn = [list(line) for line in MAP.split()]
    walkable = np.array(drawn) == "."
    height, width = walkable.shape
    open_south = np.ones((height - 1, width), dtype=bool)
    open_east = np.ones((height, width - 1), dtype=bool)
    maze = Maze(walkable, open_south, open_east)
    enclosed = int(maze.cell_numbers[5, 6])
    assert (maze.neighbors[enclosed] == enclosed).all()
    task = Task(
        maze, num_chasers=AGENTS, num_evaders=1, stay_action=True, collisions="block", max_steps=100
    )
    simulator = Simulator(task, GAMES, seed=2)
    rng = np.random.default_rng(7)
    others = np.delete(np.arange(maze.num_cells), enclosed)
    starts = [rng.permutation(others)[:AGENTS] for _ in range(GAMES)]
    simulator.place(np.concatenate([starts, np.full((GAMES, 1), enclosed)], axis=1))
    numbered = list(zip(maze.rows.tolist(), maze.columns.tolist(), strict=True))
    blocked = 0
    for _ in range(STEPS):
        actions = rng.integers(5, size=(GAMES, AGENTS))
        before = simulator.positions.copy()
        simulator.step(OURS[np.concatenate([actions, np.zeros((GAMES, 1), dtype=int)], axis=1)])
        assert not simulator.terminated.any()
        for game in range(GAMES):
            places = [numbered[cell] for cell in before[game, :AGENTS]]
            after = [numbered[cell] for cell in simulator.positions[game, :AGENTS]]
            assert after == block_both(places, actions[game].tolist(), set(numbered))
            free_moves = maze.neighbors[before[game, :AGENTS], OURS[actions[game]]]
            blocked += (free_moves != simulator.positions[game, :AGENTS]).sum()
    assert blocked > GAMES  # of 40 moves in each game
