"""Invalid arguments of all exact solvers, and of small games, raise ValueError in one line."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from refusals import ARRAY, FLAG, MAZES, NUMBER, TEXT, WHOLE, Call, faults_of

from pursuit import chase_v0
from pursuit.mazes.maze import load_maze
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BeliefChaser,
    BeliefOptimalChaser,
    NearestGoalRunner,
    RandomAgent,
    SearchingChaser,
    WaryEvader,
    action_values,
    alpha_rank,
    best_team_response,
    check_joint_states,
    check_optimal,
    count_joint_states,
    double_oracle,
    evaluate_joint,
    evaluate_team,
    fictitious_play,
    joint_nash_conv,
    least_steps,
    matrix_fictitious_play,
    mean_over_team_starts,
    meta_strategy,
    num_states,
    psro,
    solve_hidden_chase,
    solve_joint,
    solve_joint_game,
    table_of,
    team_survival,
    why_not_optimal,
    why_not_team_chase,
    work_of,
)
from scripted_agents.games import (
    ParallelGame,
    SmallGameEnv,
    enumerate_game,
    equilibrium,
    game_of_task,
    nash_conv,
    respond,
    returns_of,
)
from train.evaluation import exploitability, team_exploitability

MAZE = load_maze("2x2")
CHASE = make_task("chase", maze=MAZE, rewards="zero_sum")
RACE = make_task("race", maze=MAZE, num_goals=1)
TASKS = (None, "chase", 5, {}, [])
TABLE = RandomAgent().action_probabilities(MAZE)
PAIR: dict[str, Any] = {"chaser": AStarChaser(), "evader": AStarEvader()}
RUNNERS: dict[str, Any] = {"runner": NearestGoalRunner()}
POLICIES = (None, 5, [], "ab", {"x": AStarChaser()}, {5: 5}, {"chaser": 5, "evader": "a"})
HORIZON = {"horizon": (*WHOLE[1:-2], 0), "discount": (*NUMBER, -0.1, 0, 2)}
STATES = {"most_states": (*WHOLE[:-2], 0)}


def calls() -> Iterator[Call]:
    task, policies = {"task": TASKS}, {"policies": POLICIES}
    agents = (None, 5, [], {}, "x", ["x"], [None], 1.5, [[0]])
    yield (
        solve_joint,
        {"task": CHASE, "agents": "chaser", "policies": PAIR},
        {**task, **policies, **HORIZON, **STATES, "agents": agents, "objective": TEXT},
    )
    yield (
        evaluate_joint,
        {"task": CHASE, "policies": PAIR},
        {**task, **policies, **HORIZON, **STATES, "agents": agents[1:]},
    )
    yield (
        joint_nash_conv,
        {"task": RACE, "policies": RUNNERS},
        {**task, **policies, **HORIZON, **STATES, "sides": FLAG, "objective": TEXT},
    )
    yield solve_joint_game, {"task": RACE}, {**task, **STATES, "discount": HORIZON["discount"]}
    team = {"task": CHASE, "policies": PAIR}
    yield (
        best_team_response,
        {**team, "role": "chaser"},
        {**task, **policies, **HORIZON, "role": TEXT},
    )
    yield evaluate_team, team, {**task, **policies, **HORIZON}
    yield team_survival, {**team, "horizon": 3}, {**task, **policies, "horizon": (None, *WHOLE)}
    values = np.ones((4, 4))
    wrong = {"values": (*ARRAY, np.ones(3)), "least": (*WHOLE[1:], 99)}
    yield mean_over_team_starts, {"values": values, "task": CHASE}, {**task, **wrong}
    yield count_joint_states, {"task": CHASE}, task
    yield check_joint_states, {"task": CHASE}, {**task, "most": WHOLE[:-2]}
    yield why_not_team_chase, {"task": CHASE}, task
    yield work_of, {"task": CHASE}, task
    yield why_not_optimal, {"task": CHASE, "role": "chaser"}, {**task, "role": TEXT}
    yield check_optimal, {"task": CHASE, "role": "chaser"}, {**task, "role": TEXT}
    tables = (*ARRAY, TABLE[0], -TABLE, TABLE * 2)
    order = {"move_order": TEXT}
    yield (
        action_values,
        {"role": "chaser", "maze": MAZE, "opponent_table": TABLE},
        {"role": TEXT, "maze": MAZES, "opponent_table": tables, **order},
    )
    hidden: dict[str, Any] = {"maze": MAZE, "opponent_table": TABLE, "seconds": 1}
    yield (
        solve_hidden_chase,
        hidden,
        {
            "maze": MAZES,
            "opponent_table": tables,
            "view_radius": (*WHOLE[1:], -1),
            "line_of_sight": FLAG,
            "discount": (*NUMBER, 0, 1, 2),
            "seconds": (*NUMBER, -1),
            "width": NUMBER[1:],
            "role": TEXT,
            "stay_action": FLAG[1:],
            "min_start_distance": (*WHOLE, 99),
            "memory": WHOLE,
            **order,
        },
    )
    solved = solve_hidden_chase(**hidden)
    given = {"solution": solved}
    yield BeliefOptimalChaser, given, {"solution": (None, 5, hidden), "epsilon": (*NUMBER, 2)}
    often = {"iterations": (*WHOLE, 0)}
    discounts = {"discount": (*NUMBER, 0, 1, 2), "stay_action": FLAG}
    yield (
        fictitious_play,
        {"maze": MAZE, "iterations": 2},
        {"maze": MAZES, **often, **discounts, **order},
    )
    yield (
        double_oracle,
        {"maze": MAZE},
        {"maze": MAZES, **discounts, **order, "tolerance": (*NUMBER, -1)},
    )
    payoff = {"payoff": (*ARRAY, [], 5, [[np.nan]])}
    yield matrix_fictitious_play, {"payoff": [[1.0]], "iterations": 2}, {**payoff, **often}
    yield alpha_rank, {"payoff": [[1.0]]}, payoff
    yield meta_strategy, {"payoff": [[1.0]]}, {**payoff, "kind": TEXT}
    yield psro, {"payoff": [[1.0]]}, {**payoff, "meta": TEXT, "tolerance": (*NUMBER, -1)}
    yield (
        table_of,
        {"policy": AStarChaser(), "maze": MAZE, "stay_action": False, "move_order": "simultaneous"},
        {"policy": (None, 5, "a"), "maze": MAZES, "stay_action": FLAG},
    )
    yield num_states, {"num_cells": 9, "num_goals": 2}, {"num_cells": WHOLE, "num_goals": WHOLE}
    arm = {
        "angles": (*ARRAY, [np.nan]),
        "target": (*ARRAY, [1.0]),
        "max_turn": (*NUMBER, 0),
        "tolerance": (*NUMBER, -1),
    }
    yield least_steps, {"angles": [0.5, 0.5], "target": [1.0, 1.0]}, arm
    for searcher in (SearchingChaser, WaryEvader, BeliefChaser):
        yield searcher, {}, {"epsilon": (*NUMBER, -0.1, 1.1)}
    tables_wrong = {"chaser_table": tables, "evader_table": tables}
    given = {"maze": MAZE, "chaser_table": TABLE, "evader_table": TABLE}
    yield (
        exploitability,
        given,
        {"maze": MAZES, **tables_wrong, "discount": (*NUMBER, 0, 1, 2), **order},
    )
    yield (
        team_exploitability,
        {"task": CHASE, "chaser": AStarChaser(), "evader": AStarEvader()},
        {
            **task,
            "chaser": (None, 5, "a"),
            "evader": (None, 5, "a"),
            "discount": (*NUMBER, 0, 1, 2),
        },
    )
    yield from calls_of_small_games()


class Coin:
    """A player calls a coin; the other has no choice."""

    players = ("caller", "bank")

    def starts(self) -> list[Any]:
        return [(1.0, "start")]

    def legal_actions(self, state: Any, player: int) -> list[Any]:
        return ["head", "tail"] if player == 0 else [None]

    def transitions(self, state: Any, actions: Any) -> list[Any]:
        return [(0.5, state, (won, -won), won < 0) for won in (1.0, -1.0)]


def calls_of_small_games() -> Iterator[Call]:
    games = (None, 5, "ab", [], {}, Coin, object())
    flags = {"progress": FLAG[1:], "most_states": (*WHOLE, 0)}
    yield enumerate_game, {"game": Coin()}, {"game": games, **flags}
    small = enumerate_game(Coin())
    games = (*games, Coin())
    rows = {"caller": [0.5, 0.5], "bank": [1.0]}
    wrong = (
        None, 5, "ab", [], {"x": [1.0]}, {5: 5},
        *({**rows, "caller": row} for row in (
            None, 5, "ab", [], {}, ["0.5", "0.5"], [0.5 + 0j, 0.5], [[0.5, 0.5]], [None, 1.0],
            [np.nan, 1.0], [2.0, -1.0], lambda state: None, lambda state: "ab", lambda state: 5,
            lambda state: ["0.5", "0.5"], lambda state: [0.5j, 0.5], lambda state: {"edge": 1.0},
            lambda state: {"head": "1"}, lambda state: [[0.5], [0.5, 1]],
        )),
    )  # fmt: skip
    horizons = {"horizon": HORIZON["horizon"], "discount": (*HORIZON["discount"], 1)}
    for function in (returns_of, nash_conv):
        given: dict[str, Any] = {"game": small, "policies": rows}
        yield function, given, {"game": games, "policies": wrong, **horizons}
    names = (None, 5, [], {}, "x", ["caller", "caller"], ["x"], [5], [None], [[]], 1.5)
    given = {"game": small, "players": "bank", "policies": rows}
    yield respond, given, {"game": games, "players": names, "policies": wrong, **horizons}
    yield equilibrium, {"game": small}, {"game": games, **horizons}
    given = {"game": small, "player": "bank", "policies": rows}
    told = {"game": games, "player": (None, 5, [], {}, "x"), "policies": wrong}
    encodes = (5, "ab", [], lambda state: None, lambda state: "x", lambda state: 1j)
    yield SmallGameEnv, given, {**told, "max_steps": (*WHOLE[1:], 0), "encode": encodes}
    env = SmallGameEnv(small, "caller", rows)
    env.reset(seed=0)
    actions = (None, 0.9, 1.0, "0", "head", 2, -1, [], {}, True, 1j, np.nan, [0, 1], 2**70)
    yield env.step, {"action": 1}, {"action": actions}
    yield small.player, {"name": "bank"}, {"name": (None, 5, [], {}, "x")}
    yield game_of_task, {"task": RACE}, {"task": TASKS, "most_states": (*WHOLE, 0)}
    chase = chase_v0.parallel_env(maze="2x2")
    given = {"env": chase, "save": lambda env: 0, "restore": lambda env, state: None}
    told = {"env": (None, 5, Coin()), "seeds": (None, 5, [])}
    yield ParallelGame, given, {**told, "save": (None, 5, "a"), "restore": (None, 5, "a")}


def test_every_wrong_value_is_a_value_error_of_one_line() -> None:
    faults, count = faults_of(calls())
    assert not faults, "\n".join(["", *faults])
    assert count > 700
