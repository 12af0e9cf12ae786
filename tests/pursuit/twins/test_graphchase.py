"""Exits here and in GraphChase.

The rules are those of `AnyGraphEnv` of `env/any_graph_env.py` in the repository
GraphChase/GraphChasePlatform at commit 76cf8d8, stated here in plain Python, as its environment is
no package that could be installed: evader and defenders move at once, to a neighbor or nowhere; an
evader in the node of a defender is captured, also on an exit; else it wins on an exit; at the
horizon the defenders win.
"""

from __future__ import annotations

import networkx as nx
import numpy as np

from pursuit.mazes.maze import Maze
from pursuit.rules.layout import ESCAPED, WAS_CAPTURED
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task

DEFENDERS, HORIZON, GAMES = 2, 6, 3000
GRAPH = nx.Graph([(0, 1), (1, 2), (2, 3), (3, 0), (2, 4), (4, 5), (5, 6), (6, 3), (1, 7), (7, 5)])
EXITS = (0, 6)


def outcome_in_graphchase(nodes: list[int], steps: int) -> float | None:
    """The defenders' reward after a step to these nodes, the evader's last; None if it goes on."""
    *defenders, evader = nodes
    if evader in defenders:
        return 1.0
    if evader in EXITS:
        return -1.0
    return 1.0 if steps == HORIZON else None


def task() -> Task:
    maze = Maze.from_graph(GRAPH, length=None)
    numbers = {name: cell for cell, name in enumerate(maze.cell_names)}
    return Task(
        maze,
        num_chasers=DEFENDERS,
        num_evaders=1,
        stay_action=True,
        exits=[numbers[str(node)] for node in EXITS],
        max_steps=HORIZON,
        rewards="win_loss",
    )


def test_random_games_end_equally() -> None:
    """But for one rule: a defender and the evader that pass each other on an edge are a capture
    here. And at the horizon nobody is paid here, while the defenders win there."""
    rules = task()
    maze = rules.mazes[0]
    node = np.array([int(name) for name in maze.cell_names])
    simulator, rng = Simulator(rules, GAMES, seed=1, auto_restart=False), np.random.default_rng(3)
    ends = {"captured": 0, "escaped": 0, "out of time": 0, "swapped": 0, "on an exit": 0}
    playing = np.ones(GAMES, dtype=bool)
    for step in range(1, HORIZON + 1):
        before = simulator.positions.copy()
        simulator.step(rng.integers(rules.num_actions, size=(GAMES, DEFENDERS + 1)))
        for game in np.flatnonzero(playing):
            old, new = node[before[game]], node[simulator.positions[game]]
            for a, b in zip(old, new, strict=True):
                assert a == b or GRAPH.has_edge(a, b)
            theirs = outcome_in_graphchase(new.tolist(), step)
            paid, event = simulator.rewards[game], simulator.events[game, DEFENDERS]
            swapped = any(old[i] == new[-1] and new[i] == old[-1] for i in range(DEFENDERS))
            if swapped and old[-1] != new[-1]:
                assert event == WAS_CAPTURED
                ends["swapped"] += 1
            elif theirs is None:
                assert event == 0
                assert (paid == 0).all()
                assert not simulator.terminated[game]
                assert not simulator.truncated[game]
                continue
            elif simulator.truncated[game]:
                assert (theirs, event, step) == (1.0, 0, HORIZON)
                assert (paid == 0).all()
                ends["out of time"] += 1
            else:
                assert simulator.terminated[game]
                assert event == (WAS_CAPTURED if theirs > 0 else ESCAPED)
                assert paid.tolist() == [theirs] * DEFENDERS + [-theirs]
                ends["captured" if theirs > 0 else "escaped"] += 1
                ends["on an exit"] += theirs > 0 and new[-1] in EXITS
            playing[game] = False
    assert not playing.any()
    assert min(ends.values()) > 20
