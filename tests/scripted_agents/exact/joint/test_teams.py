"""Teams of chasers against one evader: exact values and answers against independent truths.

Brute force over all places in plain Python, linear programs, and games played in the simulator.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from matrix_values import matrix_value

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
    SearchingChaser,
    TablePolicy,
    best_response,
    best_team_response,
    check_optimal,
    evaluate_exactly,
    evaluate_team,
    mean_over_starts,
    mean_over_team_starts,
    solve_chase,
    why_not_optimal,
)
from train.evaluation import exploitability, team_exploitability
from train.evaluation.contest import GameContest
from train.evaluation.matchups import match, play_pair

ORDERS = ("simultaneous", "chasers_first")


def team_task(maze: Any = "3x3", chasers: int = 2, **more: Any) -> Task:
    return make_task("chase", maze=maze, num_chasers=chasers, **more)


# -- brute force -----------------------------------------------------------------------------------


def places(task: Task) -> Any:
    cells = range(task.max_cells)
    for place in itertools.product(cells, repeat=task.num_agents):
        if place[-1] not in place[:-1]:
            yield place


def after(task: Task, place: Any, actions: Any) -> Any:
    """The next place; None when the evader is caught. Written from the rules in words."""
    neighbors = task.mazes[0].neighbors
    moved = tuple(int(neighbors[c, a]) for c, a in zip(place, actions, strict=True))
    if task.move_order == "chasers_first" and place[-1] in moved[:-1]:
        return None
    swapped = task.move_order == "simultaneous" and any(
        now == place[-1] and moved[-1] == before
        for before, now in zip(place[:-1], moved[:-1], strict=True)
    )
    return None if swapped or moved[-1] in moved[:-1] else moved


def one_step(task: Task, values: Any, place: Any) -> Any:
    """[evader's actions, joint actions]: the value after each, 0 when caught."""
    rows = []
    for flee in range(task.num_actions):
        row = []
        for joint in itertools.product(range(task.num_actions), repeat=task.num_chasers):
            following = after(task, place, (*joint, flee))
            row.append(0.0 if following is None else values[following])
        rows.append(row)
    return np.array(rows)


def chances(task: Task, policies: Any, place: Any) -> tuple[Any, Any]:
    """[joint actions] and [actions] of agents that are tables over pairs of cells."""
    maze, evader = task.mazes[0], place[-1]
    tables = {
        role: policy.action_probabilities(maze, task.stay_action)
        for role, policy in policies.items()
    }
    joint = np.ones(1)
    for cell in place[:-1]:
        joint = np.multiply.outer(joint, tables["chaser"][cell, evader]).ravel()
    nearest = min(place[:-1], key=lambda cell: maze.distances[evader, cell])
    return joint, tables["evader"][evader, nearest]


def by_hand(task: Task, who: str | None, policies: Any, horizon: int) -> Any:
    """{place: expected steps} by backward induction in plain Python."""
    values = dict.fromkeys(places(task), 0.0)
    for _ in range(horizon):
        new = {}
        for place in values:
            payoff = one_step(task, values, place)
            joint, flee = chances(task, policies, place)
            if who == "chaser":
                value = (flee @ payoff).min()
            elif who == "evader":
                value = (payoff @ joint).max()
            else:
                value = flee @ payoff @ joint
            new[place] = 1.0 + value
        values = new
    return values


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("maze", "chasers", "stay"), [("2x2", 2, True), ("2x2-open", 3, False)])
def test_answers_and_values_are_those_of_brute_force(
    maze: str, chasers: int, stay: bool, order: Any
) -> None:
    task = team_task(maze, chasers, move_order=order, stay_action=stay)
    policies: Any = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.2)}
    for who in ("chaser", "evader", None):
        expected = by_hand(task, who, policies, 3)
        if who is None:
            values = evaluate_team(task, policies, 3)
        else:
            values = best_team_response(task, who, policies, 3).values
        for place, value in expected.items():
            assert values[place] == pytest.approx(value, abs=1e-12)
        mean = [v for place, v in expected.items() if len(set(place)) == len(place)]
        assert mean_over_team_starts(values, task) == pytest.approx(np.mean(mean))


@pytest.mark.parametrize("order", ORDERS)
def test_the_joint_game_is_that_of_linear_programs(order: Any) -> None:
    """A fixed point of Shapley's map, which has one only, by another solver of matrix games."""
    task = team_task("2x2-open", 2, move_order=order, stay_action=True)
    solved = solve_chase(task.mazes[0], 0.9, True, None, order, 2).values
    values = {place: float(solved[place]) for place in places(task)}
    for place, value in values.items():
        assert value == pytest.approx(
            1 + 0.9 * matrix_value(one_step(task, values, place)), abs=1e-7
        )


# -- agents that play the joint game ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("maze", "chasers", "order", "stay"),
    [
        ("3x3-open", 2, "simultaneous", False),
        ("3x3-open", 2, "chasers_first", True),
        ("2x2-open", 3, "simultaneous", True),
    ],
)
def test_optimal_agents_of_a_team_play_the_joint_equilibrium(
    maze: str, chasers: int, order: Any, stay: bool
) -> None:
    task = team_task(maze, chasers, move_order=order, stay_action=stay)
    pair: Any = {"chaser": OptimalChaser(), "evader": OptimalEvader()}
    game = solve_chase(task.mazes[0], 0.95, stay, None, order, chasers).values
    assert evaluate_team(task, pair, None, 0.95) == pytest.approx(game, abs=1e-8)
    # Nobody does better against them: that makes them optimal, whoever solved the game.
    assert best_team_response(task, "evader", pair, None, 0.95).values == pytest.approx(
        game, abs=1e-7
    )
    assert best_team_response(task, "chaser", pair, None, 0.95).values == pytest.approx(
        game, abs=1e-7
    )
    found = team_exploitability(task, pair["chaser"], pair["evader"])
    assert 0 <= found.nash_conv + 1e-9 < 1e-6
    assert found.mean_value == pytest.approx(found.mean_game_value)


def test_the_game_value_of_two_chasers_is_reproduced_by_play() -> None:
    """The chasers must draw together here: with draws of their own they would fall short."""
    task = team_task("3x3-open", max_steps=400, move_order="simultaneous")
    pair: Any = {"chaser": OptimalChaser(), "evader": OptimalEvader()}
    solved = solve_chase(task.mazes[0], num_chasers=2)
    assert solved.mixed.any()
    simulator = Simulator(task, 40_000, seed=3, auto_restart=False)
    starts = tuple(simulator.positions.T.copy())
    left, total, discount = np.ones(40_000, dtype=bool), np.zeros(40_000), 1.0
    actions = np.zeros((40_000, 3), dtype=np.int32)
    for _ in range(80):
        simulator.act([pair["chaser"], pair["chaser"], pair["evader"]], actions)
        simulator.step(actions)
        total[left] += discount
        left &= ~simulator.terminated
        discount *= 0.95
    error = total.mean() - solved.values[starts].mean()
    assert abs(error) < 4 * total.std() / 200


def test_5x5_with_two_chasers_the_optimal_evader_is_the_one_of_that_game() -> None:
    """The fault of 0.1.0: `optimal` fled from the first chaser alone, and was caught in no time."""
    task = team_task("5x5")
    alone = TablePolicy(task.mazes[0], OptimalEvader().action_probabilities(task.mazes[0]))
    team = best_team_response(task, "chaser", {"evader": alone}).policy
    met = match(task, OptimalChaser(), OptimalEvader())
    assert met.games == 0 and met.ci95 == 0
    lengths, caught = play_pair(task, OptimalChaser(), OptimalEvader(), 4000)
    assert lengths.mean() == pytest.approx(met.steps, abs=4 * lengths.std() / 4000**0.5)
    assert caught.mean() == pytest.approx(met.caught, abs=0.01)
    # A team made to catch the old one in no time does not hold against the true one.
    against_old, _ = play_pair(task, team, alone, 1000)
    against_true, _ = play_pair(task, team, OptimalEvader(), 1000)
    assert against_true.mean() > 5 * against_old.mean()


def test_epsilon_of_optimal_teams_is_part_of_what_is_solved() -> None:
    task = team_task("3x3-open", max_steps=60)
    pair: Any = {"chaser": OptimalChaser(0.4), "evader": OptimalEvader(0.3)}
    steps = mean_over_team_starts(evaluate_team(task, pair, 60), task)
    lengths, _ = play_pair(task, pair["chaser"], pair["evader"], 20_000)
    assert lengths.mean() == pytest.approx(steps, abs=4 * lengths.std() / 20_000**0.5)
    table = pair["chaser"].joint_distribution(task, Simulator(task, 50).games)
    parts = pair["chaser"].distribution(task, Simulator(task, 50).games, 1)
    assert table.reshape(-1, 4, 4).sum(axis=1) == pytest.approx(parts)


def test_a_game_does_not_depend_on_its_batch() -> None:
    """Nor does what teams draw together."""
    task = team_task("3x3-open", max_steps=30)
    policies: Any = [OptimalChaser(0.2)] * 2 + [OptimalEvader(0.2)]
    histories = []
    for games in (1, 7):
        simulator, actions = Simulator(task, games, seed=4), np.zeros((games, 3), dtype=np.int32)
        history = []
        for _ in range(60):
            simulator.act(policies, actions)
            simulator.step(actions)
            history.append((actions[0].tolist(), simulator.positions[0].tolist()))
        histories.append(history)
    assert histories[0] == histories[1]


def test_a_start_that_repeats_meets_a_team_that_draws_anew() -> None:
    """Level replay repeats starts; what an optimal team draws is no part of a start."""
    task = team_task("3x3-open")
    simulator, actions = Simulator(task, 1, seed=4), np.zeros((1, 3), dtype=np.int32)
    drawn = np.zeros(16)
    for _ in range(1000):
        simulator.seed_starts(None, 3)  # from there the team mixes two joint actions
        simulator.reset()
        simulator.act([OptimalChaser()] * 2 + [None], actions)
        drawn[actions[0, 0] * 4 + actions[0, 1]] += 1
    expected = OptimalChaser().joint_distribution(task, simulator.games)[0]
    assert np.count_nonzero(expected > 0.3) == 2
    assert drawn / 1000 == pytest.approx(expected, abs=4 * 0.5 / 1000**0.5)


# -- answers in play -------------------------------------------------------------------------------


@pytest.mark.parametrize("role", ["chaser", "evader", "chaser_1"])
def test_the_policy_of_an_answer_gets_its_value_in_play(role: str) -> None:
    task = team_task("4x4", max_steps=25)
    others: Any = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.2)}
    best = best_team_response(task, role, others, 25)
    filled = [
        best.policy if role in (name, name.split("_")[0]) else others[name.split("_")[0]]
        for name in task.agent_names
    ]
    simulator = Simulator(task, 20_000, seed=5, auto_restart=False)
    lengths = np.full(20_000, 25)
    actions = np.zeros((20_000, 3), dtype=np.int32)
    for step in range(1, 26):
        simulator.act(filled, actions)
        simulator.step(actions)
        lengths[simulator.terminated & (lengths > step)] = step
    assert lengths.mean() == pytest.approx(
        best.mean_over_starts, abs=4 * lengths.std() / 20_000**0.5
    )
    met = mean_over_team_starts(evaluate_team(task, others, 25), task)
    assert best.mean_over_starts > met if role == "evader" else best.mean_over_starts < met


def test_a_team_of_one_is_the_duel() -> None:
    task = make_task("chase", maze="4x4", min_start_distance=2)
    maze, chaser, evader = task.mazes[0], AStarChaser(0.2), AStarEvader(0.1)
    tables = chaser.action_probabilities(maze), evader.action_probabilities(maze)
    pair: Any = {"chaser": chaser, "evader": evader}
    values = evaluate_team(task, pair)
    assert values == pytest.approx(evaluate_exactly(maze, *tables).values)
    assert mean_over_team_starts(values, task) == pytest.approx(mean_over_starts(values, maze, 2))
    for number, role in enumerate(("evader", "chaser")):
        best = best_response(role, maze, tables[number])  # type: ignore[arg-type]
        assert best_team_response(task, role, pair).values == pytest.approx(best.values)
    one, two = exploitability(maze, *tables), team_exploitability(task, chaser, evader)
    assert two.nash_conv == pytest.approx(one.nash_conv, abs=1e-6)
    assert two.mean_game_value == pytest.approx(one.mean_game_value)


def test_a_contest_of_one_chaser_of_two_is_exact() -> None:
    task = team_task("3x3")
    others: Any = {"chaser": AStarChaser(0.2), "evader": AStarEvader(0.2)}
    contest = GameContest(task, "chaser", others, 4000)
    random, scripted, optimal = contest.baselines()
    assert all(score.exact for score in (random, scripted, optimal))
    assert optimal.name == "optimal" and optimal.mean_steps < scripted.mean_steps
    lengths, _ = contest.play(RandomAgent())
    assert lengths.mean() == pytest.approx(random.mean_steps, abs=4 * lengths.std() / 4000**0.5)


# -- where it is not known -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("task", "role", "message"),
    [
        (team_task("15x15"), "evader", "need [0-9,]+ bytes"),
        (team_task("5x5", num_evaders=2), "chaser", r"2 chaser\(s\) and 2 evader\(s\)"),
        (make_task("heist"), "evader", r"3 goal\(s\)"),
        (make_task("race"), "runner", "2 agents"),
        (make_task("maze", maze="9x9", num_goals=19), "runner", "19 goals"),
    ],
)
def test_optimal_is_refused_where_it_is_not_known(task: Task, role: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_optimal(task, role)
    if role != "runner":
        agent: Any = OptimalChaser() if role == "chaser" else OptimalEvader()
        actions = np.zeros((1, task.num_agents), dtype=np.int32)
        filled = [agent if own == role else RandomAgent() for own in task.seat_roles]
        with pytest.raises(ValueError, match=message):
            Simulator(task).act(filled, actions)


def test_optimal_is_known_where_it_is_solved() -> None:
    for task in (make_task("chase", maze="15x15"), team_task("9x9"), team_task("5x5", 3)):
        assert why_not_optimal(task, "chaser") is None
    assert why_not_optimal(make_task("maze", num_goals=18), "runner") is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t, p: best_team_response(t, "runner", p), "role 'runner'"),
        (lambda t, p: best_team_response(t, "chaser", {"chaser": p["chaser"]}), "has no policy"),
        (lambda t, p: best_team_response(t, "evader", p, horizon=0), "horizon=0"),
        (lambda t, p: best_team_response(t, "evader", p, None), "discount 1.0"),
        (lambda t, p: best_team_response(make_task("heist"), "evader", p), "without goals"),
        (lambda t, p: best_team_response(t, "evader", {"chaser": SearchingChaser()}), "no distr"),
        (lambda t, p: evaluate_team(team_task("15x15", 3), p), "at most 100,000,000 are solved"),
    ],
)
def test_what_cannot_be_answered_says_why(call: Any, message: str) -> None:
    policies = {"chaser": AStarChaser(), "evader": AStarEvader()}
    with pytest.raises(ValueError, match=message):
        call(team_task(), policies)


def test_twins_of_a_team_have_each_others_policies() -> None:
    """Only teams in order are solved; the others are they with names changed."""
    solved = solve_chase(load_maze("3x3-open"), num_chasers=2)
    chaser = solved.chaser_policy.reshape(9, 9, 9, 4, 4)
    for c, d, e in itertools.product(range(9), repeat=3):
        if c < d and e not in (c, d):
            assert (chaser[c, d, e] == chaser[d, c, e].T).all()
            assert (solved.evader_policy[e, c, d] == solved.evader_policy[e, d, c]).all()


def test_a_team_that_draws_together_holds_the_value_of_the_game() -> None:
    task = team_task("3x3-open")
    together = solve_chase(task.mazes[0], num_chasers=2)
    answer = best_team_response(task, "evader", {"chaser": OptimalChaser()}, None, 0.95)
    value = mean_over_team_starts(together.values, task, 1)
    assert mean_over_team_starts(answer.values, task, 1) == pytest.approx(value)
