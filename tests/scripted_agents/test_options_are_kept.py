"""Exact functions keep to every option of the rules, and agree with the joint solver, or refuse.

The joint solver itself is held against brute force (`exact/joint/test_options_brute_force.py`).
"""

from __future__ import annotations

import inspect
from typing import Any

import pytest

import scripted_agents
from pursuit import load_maze, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    BestResponder,
    OptimalChaser,
    OptimalEvader,
    TablePolicy,
    action_values,
    best_response,
    double_oracle,
    evaluate_exactly,
    evaluate_joint,
    evaluate_team,
    fictitious_play,
    mean_over_starts,
    mean_over_team_starts,
    solve_chase,
    solve_hidden_chase,
    solve_joint,
    table_of,
    team_survival,
)

MAZE = load_maze("3x3")
HORIZON = 30
BOTH = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.2)}
ORDERS = ("simultaneous", "chasers_first")
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "stay": {"stay_action": True},
    "chasers first": {"move_order": "chasers_first"},
    "turns": {"move_order": "turns", "stay_action": True},
    "adjacent": {"capture": "adjacent"},
    "surround": {"capture": "surround"},
    "two catch": {"n_catch": 2, "num_chasers": 2},
    "after chasers": {"move_order": "chasers_first", "capture_check": "after_chasers"},
    "exits": {"exits": (2,)},
    "drawn exits": {"num_exits": 1},
    "block": {"collisions": "block", "capture": "adjacent"},
    "slip": {"slip": 0.3},
    "one slips": {"slip": "evader=0.3"},
    "far starts": {"min_start_distance": 2},
    "marks": {"start": "marks"},
    "view": {"view_radius": 1},
    "sight": {"line_of_sight": "chaser"},
    "two evaders": {"num_evaders": 2},
}


def duel(order: str, stay: bool, **settings: Any) -> Any:
    return make_task("chase", maze=MAZE, move_order=order, stay_action=stay, **settings)


def tables(stay: bool) -> tuple[Any, Any]:
    return tuple(agent.action_probabilities(MAZE, stay) for agent in BOTH.values())


def by_best_response(order: Any, stay: bool) -> tuple[float, float]:
    found = best_response("chaser", MAZE, tables(stay)[1], HORIZON, move_order=order)
    return mean_over_starts(found.values, MAZE), responded("chaser_0", order, stay)


def by_action_values(order: Any, stay: bool) -> tuple[float, float]:
    found = action_values("evader", MAZE, tables(stay)[0], HORIZON, move_order=order)
    return mean_over_starts(found.values, MAZE), responded("evader_0", order, stay)


def responded(agent: str, order: str, stay: bool) -> float:
    return solve_joint(duel(order, stay), agent, BOTH, HORIZON).mean_over_starts


def by_evaluate_exactly(order: Any, stay: bool) -> tuple[float, float]:
    values = evaluate_exactly(MAZE, *tables(stay), HORIZON, move_order=order)
    joint = evaluate_joint(duel(order, stay), BOTH, HORIZON)
    return mean_over_starts(values, MAZE), joint.length


def by_hidden_chase(order: Any, stay: bool) -> tuple[float, float]:
    """With a view of everything."""
    found = solve_hidden_chase(
        MAZE, tables(stay)[1], 9, discount=0.9, stay_action=stay, move_order=order, seconds=1.0
    )
    joint = solve_joint(duel(order, stay), "chaser_0", BOTH, None, 0.9)
    return (found.lower + found.upper) / 2, joint.mean_over_starts


def by_table_of(order: Any, stay: bool) -> tuple[float, float]:
    """A best response depends on the order of moves; in the other order it is worse."""
    policy = BestResponder(BOTH["evader"], "chaser", discount=0.99)
    values = evaluate_exactly(
        MAZE, table_of(policy, MAZE, stay, order), tables(stay)[1], HORIZON, move_order=order
    )
    joint = evaluate_joint(duel(order, stay), {**BOTH, "chaser": policy}, HORIZON)
    return mean_over_starts(values, MAZE), joint.length


def responses(order: str, stay: bool, chaser: Any, evader: Any) -> list[float]:
    """Discounted steps of the evader's best response to a chaser, and of the chaser's to an evader,
    by the joint solver."""
    task, both = duel(order, stay), {"chaser": TablePolicy(MAZE, chaser)}
    both["evader"] = TablePolicy(MAZE, evader)
    return [
        solve_joint(task, agent, both, None, 0.9).mean_over_starts
        for agent in ("evader_0", "chaser_0")
    ]


def by_solve_chase(order: Any, stay: bool) -> tuple[Any, Any]:
    """In an equilibrium no best response changes the value."""
    game = solve_chase(MAZE, 0.9, stay, None, order)
    value = game.mean_over_starts
    return [value, value], responses(order, stay, game.chaser_policy, game.evader_policy)


def by_double_oracle(order: Any, stay: bool) -> tuple[Any, Any]:
    game = double_oracle(MAZE, 0.9, stay, order).solution
    value = game.mean_over_starts
    return [value, value], responses(order, stay, game.chaser_policy, game.evader_policy)


def by_fictitious_play(order: Any, stay: bool) -> tuple[float, float]:
    play = fictitious_play(MAZE, 20, 0.9, stay, order)
    most, least = responses(order, stay, play.chaser_policy, play.evader_policy)
    return float(play.nash_convs[-1]), most - least


DUELS = {
    action_values: by_action_values,
    best_response: by_best_response,
    double_oracle: by_double_oracle,
    evaluate_exactly: by_evaluate_exactly,
    fictitious_play: by_fictitious_play,
    solve_chase: by_solve_chase,
    solve_hidden_chase: by_hidden_chase,
    table_of: by_table_of,
}
"""What functions of a maze with an order of moves say, and what the joint solver says."""


def test_all_functions_with_an_order_of_moves_are_here() -> None:
    public = [getattr(scripted_agents, name) for name in dir(scripted_agents)]
    functions = {each for each in public if inspect.isfunction(each)}
    assert {f for f in functions if "move_order" in inspect.signature(f).parameters} == set(DUELS)


@pytest.mark.parametrize("function", DUELS, ids=lambda function: function.__name__)
@pytest.mark.parametrize("order", [*ORDERS, "turns", "evaders_first"])
@pytest.mark.parametrize("stay", [False, True])
def test_an_order_of_moves_is_kept_or_refused(function: Any, order: str, stay: bool) -> None:
    if order not in ORDERS:
        with pytest.raises(ValueError, match="give 'simultaneous' or 'chasers_first'") as told:
            DUELS[function](order, stay)
        assert ("solve_joint" in str(told.value)) == (order == "turns")
        return
    found, expected = DUELS[function](order, stay)
    assert found == pytest.approx(expected, rel=2e-3 if function is solve_hidden_chase else 1e-6)


@pytest.mark.parametrize("name", OPTIONS)
def test_options_of_a_task_are_kept_or_refused(name: str) -> None:
    task = make_task("chase", maze=MAZE, **OPTIONS[name])
    joint = evaluate_joint(task, BOTH, HORIZON)
    teams: list[Any] = [
        lambda: mean_over_team_starts(evaluate_team(task, BOTH, HORIZON), task),
        lambda: mean_over_team_starts(team_survival(task, BOTH, HORIZON)[0], task),
    ]
    for value in teams:
        if name in ("exits", "drawn exits", "turns", "marks", "two evaders"):
            with pytest.raises(ValueError, match="chases of one evader"):
                value()
        else:
            assert value() == pytest.approx(joint.length, rel=1e-9)
    for policy in (
        OptimalChaser(),
        OptimalEvader(),
        BestResponder(BOTH["evader"], "chaser", discount=0.9),
    ):
        agent = task.agent_names[0 if policy.role == "chaser" else -1]
        against = {**BOTH, policy.role: policy}
        if not task.is_duel or task.options != make_task("chase", maze=MAZE).options:
            with pytest.raises(ValueError, match=r"not known|plays"):
                evaluate_joint(task, against, HORIZON)
            continue
        best = solve_joint(task, agent, BOTH, None, policy.discount).mean_over_starts
        found = evaluate_joint(task, against, None, policy.discount).length
        other = {"chaser": "evader", "evader": "chaser"}[policy.role]
        response = BestResponder(BOTH[other], policy.role, discount=policy.discount)
        reached = evaluate_joint(task, {**BOTH, policy.role: response}, None, policy.discount)
        assert reached.length == pytest.approx(best, rel=1e-6)
        assert found >= best - 1e-9 if policy.role == "chaser" else found <= best + 1e-9
