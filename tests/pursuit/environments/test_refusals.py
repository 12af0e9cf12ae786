"""Invalid values raise ValueError with the value and the rule; nothing is changed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from refusals import ARRAY, CELLS, FLAG, MAZES, NUMBER, TEXT, WHOLE, Call, faults_of
from simulated import TASKS, refused

from pursuit import chase_v0
from pursuit.environments.parallel import PursuitParallelEnv
from pursuit.environments.single_agent import SingleAgentEnv, SingleAgentVectorEnv
from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.observations.observations import Encoder
from pursuit.simulator.simulator import Simulator, SimulatorState
from pursuit.tasks.task import Rewards, Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BestResponder,
    NearestGoalRunner,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
    TablePolicy,
    TourRunner,
    best_response,
    cop_number,
    evaluate_exactly,
    expected_tour_length,
    mean_over_starts,
    shortest_path,
    shortest_tour,
    solve_chase,
    solve_in_turns,
    solve_matrix_game,
    tour_length,
    tour_lengths,
)
from scripted_agents.environments import scripted_policy


@pytest.mark.parametrize(
    "wrong",
    [
        {"positions": np.full((3, 2), 25, dtype=np.int32)},
        {"positions": np.full((3, 2), -1, dtype=np.int32)},
        {"positions": np.zeros((3, 2))},
        {"goals": np.zeros((3, 1), dtype=np.int32)},
        {"maze_index": np.full(3, -1, dtype=np.int32)},
        {"maze_index": np.full(3, 1, dtype=np.int32)},
        {"steps": np.full(3, -1, dtype=np.int32)},
        {"epsilon": np.full((3, 2), np.inf)},
        {"next_epsilon": np.full((3, 2), 2.0)},
        {"next_maze": np.full(3, 1, dtype=np.int32)},
        {"next_num_goals": np.full(3, 1, dtype=np.int32)},
        {"next_goals_around_marks": np.full(3, 2, dtype=np.int32)},
        {"next_min_start_distance": np.full(3, 11, dtype=np.int32)},
        {"next_max_start_distance": np.full(3, 1, dtype=np.int32)},
        {"streams": np.zeros((3, 2), dtype=np.uint64)},
        {"terminated": None},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_an_invalid_state_is_refused_and_changes_nothing(wrong: dict[str, Any]) -> None:
    simulator = Simulator(TASKS["chase"], 3, seed=1)
    with refused(simulator):
        simulator.set_state(SimulatorState(**vars(simulator.get_state()) | wrong))


MAZE = load_maze("3x3")
CHASE = make_task("chase", maze="3x3")
TABLE = RandomAgent().action_probabilities(MAZE)
OPEN = np.ones((2, 2), dtype=bool)


def calls() -> Iterator[Call]:
    simulator = Simulator(CHASE, 2)
    env = chase_v0.parallel_env(maze="9x9")
    env.reset(seed=0)
    policies = {"evader": RandomAgent()}
    single, vector = (
        kind(CHASE, "chaser", policies) for kind in (SingleAgentEnv, SingleAgentVectorEnv)
    )
    single.reset(seed=0)
    vector.reset(seed=0)
    counts = ("num_chasers", "num_evaders", "num_runners", "num_goals", "max_steps")
    yield (
        make_task,
        {"name": "chase"},
        {
            "name": TEXT,
            "maze": MAZES[1:],
            **dict.fromkeys([*counts, "min_start_distance"], WHOLE),
            "stay_action": FLAG,
            "move_order": TEXT,
            "start": TEXT,
            "rewards": (
                None,
                5,
                [],
                "nonsense",
                {"chaser": 1.0},
                {"chaser": lambda *_: 0.0},
                {5: Rewards()},
            ),
        },
    )
    yield Task, {"num_runners": 1, "num_goals": 1}, {"name": (None, 5, [])}
    numbers = dict.fromkeys(("step", "capture", "goal", "distance"), NUMBER)
    yield Rewards, {}, {**numbers, "on_completion": FLAG}
    yield CHASE.seat, {"agent": 0}, {"agent": (None, "x", 1.5, [], 2, -1, True)}
    yield CHASE.count, {"role": "chaser"}, {"role": TEXT}
    batches = {"num_games": (*WHOLE, 0, -1), "seed": (*WHOLE, -1, 2**64, False, [1])}
    batches |= {"first_game": (*WHOLE, -1), "auto_restart": (0, None, "yes")}
    yield Simulator, {"task": CHASE}, {"task": (None, "chase", 5), **batches}
    yield simulator.reset, {}, {"seed": WHOLE[1:], "games": ("a", 1.5, {}, [9], [0.5], True)}
    yield simulator.seed, {"seed": 1}, {"seed": WHOLE, "games": ("a", 1.5, {}, [9])}
    yield simulator.step, {"actions": [[0, 0]] * 2}, {"actions": (*ARRAY, [0, 0], [[9, 9]] * 2)}
    yield (
        simulator.seed_starts,
        {"games": None, "seeds": 1},
        {"seeds": (*ARRAY, -1, 2**63, [1] * 3)},
    )
    yield simulator.set_state, {"state": simulator.get_state()}, {"state": (None, 5, {})}
    yield simulator.get_state, {}, {"games": ("a", 1.5, {}, [9])}
    yield (
        simulator.observe,
        {},
        {"encoding": TEXT, "seat": ("x", 1.5, [], 9), "out": (5, [], np.zeros(3), np.zeros(()))},
    )
    yield simulator.observe_final, {}, {"encoding": TEXT, "games": ("a", 1.5, {}, [9])}
    yield simulator.encoder, {"encoding": "index"}, {"encoding": TEXT}
    yield simulator.view, {"seat": 0}, {"seat": (None, "x", 1.5, [], 9)}
    acting = {"policies": [None, None], "actions": np.zeros((2, 2), dtype=np.int32)}
    wrong_policies = ([], [None], [5, None], ["a", None], None, 5)
    yield simulator.act, acting, {"policies": wrong_policies, "actions": (None, 5, [], np.zeros(2))}
    yield Encoder, {"task": CHASE, "encoding": "index"}, {"task": (None, 5), "encoding": TEXT}
    yield load_maze, {"maze": "3x3"}, {"maze": (*MAZES, "", "a\0b", "/", ["3x3"])}
    yield Maze.from_text, {"text": MAZE.to_text()}, {"text": (None, 5, b"+-+", "", "a")}
    grids = (None, 5, "ab", [[0, 1]], {}, OPEN[0], np.ones((2, 2, 2), dtype=bool))
    yield (
        Maze,
        {"walkable": OPEN, "open_south": OPEN[:1], "open_east": OPEN[:, :1]},
        {
            **dict.fromkeys(("walkable", "open_south", "open_east"), grids),
            "start": (5, (0,), "ab", (0.5, 1), (9, 9), {}),
            "goals": (5, ((0,),), ("ab",), ((9, 9),)),
        },
    )
    yield MAZE.distances_from, {"cell": 0}, {"cell": (None, 1.9, "a", True, 9, -1, [0], 2**70)}
    yield (
        generate_maze,
        {"algorithm": "prim", "height": 3},
        {
            "algorithm": TEXT,
            "height": (*WHOLE, 0, 10**9),
            "width": (*WHOLE[1:], 0, 10**9),
            "loops": (*NUMBER, -0.1, 1.1),
            "no_dead_ends": FLAG,
            "seed": WHOLE[:-2],
        },
    )
    kinds = {"observation": TEXT, "render_mode": TEXT[1:]}
    yield PursuitParallelEnv, {"task": CHASE}, {"task": (None, 5), **kinds}
    places = (5, "ab", {"positions": [0, 99]}, {"positions": None}, {"positions": {}})
    resets = {"seed": WHOLE[1:], "options": places}
    yield env.reset, {}, resets
    pairs: dict[str, Any] = {"chaser_0": 0, "evader_0": 0}
    wrong = (
        None,
        5,
        [],
        {},
        {**pairs, "evader_0": 9},
        {**pairs, "x": 0},
        {**pairs, "chaser_0": {}},
    )
    yield env.step, {"actions": pairs}, {"actions": wrong}
    for kind in (SingleAgentEnv, SingleAgentVectorEnv):
        given = {"task": CHASE, "agent": "chaser", "policies": policies}
        seats = {"agent": (None, "x", 9, []), "policies": (None, 5, {}, {"evader": 5}, {5: 5})}
        yield kind, given, {"task": (None, 5), **kinds, **seats}
    yield SingleAgentVectorEnv, given, {"num_envs": (*WHOLE, 0)}
    yield single.reset, {}, resets
    yield vector.reset, {}, {"seed": (*WHOLE[1:], [1, 2]), "options": places}
    yield single.step, {"action": 0}, {"action": (None, 9, -1, 1.5, "a", [], {})}
    yield vector.step, {"actions": [0]}, {"actions": (*ARRAY, 0, [9], [0, 0], [0.5])}
    shares = (*NUMBER, -0.1, 1.1, True)
    for agent in (AStarChaser, AStarEvader, TourRunner, NearestGoalRunner):
        yield agent, {}, {"epsilon": shares}
    yield AStarEvader, {}, {"alert_distance": (*WHOLE, -1), "look_radius": (*WHOLE, 0)}
    for agent in (AStarChaser(), TablePolicy(MAZE, TABLE), OptimalChaser()):
        yield agent.action_probabilities, {"maze": MAZE}, {"maze": MAZES, "stay_action": FLAG}
    table = {"table": (*ARRAY, TABLE[0], -TABLE, TABLE * 2), "maze": MAZES, "epsilon": shares}
    yield TablePolicy, {"maze": MAZE, "table": TABLE}, table
    for exact in (OptimalChaser, OptimalEvader):
        yield exact, {}, {"epsilon": shares, "discount": (*NUMBER, 0, 2), "move_order": TEXT}
    yield BestResponder, {"opponent": AStarEvader()}, {"opponent": (None, 5), "role": TEXT[1:]}
    yield scripted_policy, {"name": "astar", "role": "chaser"}, {"name": TEXT, "role": TEXT}
    walk = {"start": (None, 1.9, "a", 99, []), "goal": (None, 1.9, "a", 99, [])}
    yield shortest_path, {"maze": MAZE, "start": 0, "goal": 1}, {"maze": MAZES, **walk}
    tours = {"start": walk["start"], "goals": (*CELLS, [2.7], 5)}
    for tour in (tour_length, shortest_tour):
        yield tour, {"maze": MAZE, "start": 0, "goals": [1]}, {"maze": MAZES, **tours}
    many = {"starts": (*CELLS, [-1]), "goals": (*ARRAY, [1], [[99]], [[-2]], [[1.5]])}
    given = {"maze": MAZE, "starts": [0], "goals": [[1]]}
    yield tour_lengths, given, {"maze": MAZES, **many}
    means = {"num_goals": (*WHOLE, 0, 9), "samples": (*WHOLE, 1)}
    yield expected_tour_length, {"maze": MAZE, "num_goals": 1}, {"maze": MAZES, **means}
    horizons = {"horizon": (*WHOLE[1:-2], 0), "discount": (*NUMBER, 0, 2), "move_order": TEXT}
    given = {"role": "chaser", "maze": MAZE, "opponent_table": TABLE}
    yield (
        best_response,
        given,
        {
            "role": TEXT,
            "maze": MAZES,
            "opponent_table": table["table"],
            "stay_action": FLAG[1:],
            **horizons,
        },
    )
    tables = dict.fromkeys(("chaser_table", "evader_table"), table["table"])
    given = {"maze": MAZE, "chaser_table": TABLE, "evader_table": TABLE}
    yield evaluate_exactly, given, {"maze": MAZES, **tables, **horizons}
    given = {"values": np.ones((9, 9)), "maze": MAZE}
    starts = {"min_start_distance": (*WHOLE, 99), "values": (*ARRAY, np.ones(9))}
    yield mean_over_starts, given, {"maze": MAZES, **starts}
    games = {**horizons, "stay_action": FLAG, "num_chasers": (*WHOLE, 0)}
    yield solve_chase, {"maze": MAZE}, {"maze": MAZES, **games, "discount": NUMBER}
    turns = {"stay_action": FLAG, "num_chasers": (*WHOLE, 0)}
    yield solve_in_turns, {"maze": MAZE}, {"maze": MAZES, **turns}
    yield cop_number, {"maze": MAZE}, {"maze": MAZES, "stay_action": FLAG, "most": (*WHOLE, 0)}
    yield solve_matrix_game, {"payoff": [[1.0]]}, {"payoff": (*ARRAY, [], 5, [[np.nan]])}


def test_every_wrong_value_is_a_value_error_and_every_unknown_keyword_a_type_error() -> None:
    faults, count = faults_of(calls())
    assert not faults, "\n".join(["", *faults])
    assert count > 800
