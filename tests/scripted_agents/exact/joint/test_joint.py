"""Whole games solved exactly: against other exact solvers, and games played in the simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from simulated import MARKED

from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    RandomAgent,
    SearchingChaser,
    TablePolicy,
    TourRunner,
    best_response,
    best_team_response,
    count_joint_states,
    evaluate_joint,
    evaluate_team,
    expected_tour_length,
    mean_over_starts,
    mean_over_team_starts,
    solve_joint,
    tour_lengths,
)
from scripted_agents.exact.joint import solver as joint
from scripted_agents.exact.joint import sweeps as joint_sweeps
from scripted_agents.games import game_of_task

ORDERS = ("simultaneous", "chasers_first")
SCRIPTED: dict[str, Policy] = {
    "chaser": AStarChaser(0.2),
    "evader": AStarEvader(0.2),
    "runner": NearestGoalRunner(0.2),
}
IN_A_HEIST: dict[str, Policy] = {"chaser": AStarChaser(0.2), "evader": NearestGoalRunner(0.2)}


# -- other exact solvers ---------------------------------------------------------------------------


@pytest.mark.parametrize("stay", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_duels_are_those_of_best_response(order: Any, stay: bool) -> None:
    task = make_task("chase", maze="4x4", move_order=order, stay_action=stay, min_start_distance=2)
    maze, size = task.mazes[0], task.max_cells
    for role, other in (("chaser", "evader"), ("evader", "chaser")):
        table = SCRIPTED[other].action_probabilities(maze, stay)  # type: ignore[attr-defined]
        for horizon, discount in ((200, 1.0), (9, 0.9), (None, 0.95)):
            rest = (horizon, discount, stay, order)
            known = best_response(role, maze, table, *rest)  # type: ignore[arg-type]
            for given in (SCRIPTED[other], table):
                found = solve_joint(task, role, {other: given}, horizon, discount)
                values = found.values.reshape(size, size)
                np.testing.assert_allclose(values, known.values, rtol=1e-8)
                mean = mean_over_starts(known.values, maze, 2)
                assert found.mean_over_starts == pytest.approx(mean, rel=1e-8)


def test_without_an_end_or_a_discount_it_says_where_the_end_can_be_put_off() -> None:
    task = make_task("chase", maze="4x4")
    found = solve_joint(task, "chaser", SCRIPTED, None)
    table = AStarEvader(0.2).action_probabilities(task.mazes[0])
    known = best_response("chaser", task.mazes[0], table, None).values
    np.testing.assert_allclose(found.values, known.ravel(), rtol=1e-8)
    with pytest.raises(ValueError, match="can be delayed forever"):
        solve_joint(task, "evader", SCRIPTED, None)
    with pytest.raises(ValueError, match="can be delayed forever"):
        evaluate_joint(task, {"chaser": AStarChaser(), "evader": AStarEvader()}, None)


def test_a_runner_alone_needs_the_steps_of_the_shortest_tour() -> None:
    for name, goals in (("3x3", 3), ("4x4", 2)):
        task = make_task("maze", maze=name, num_goals=goals)
        for horizon in (200, None):
            found = solve_joint(task, "runner", {}, horizon)
            mean = expected_tour_length(task.mazes[0], goals)
            assert found.mean_over_starts == pytest.approx(mean, abs=1e-9)
            games, real = found.states.games(0, found.states.count)
            tours = tour_lengths(task.mazes[0], games.position[:, 0], games.goal)
            np.testing.assert_allclose(found.values[real], tours[real], atol=1e-9)


def test_rewards_are_not_rounded_to_float32() -> None:
    """In closed form: a tour of n steps returns -0.1 (n - 1) + 1; a shared goal a third of 0.7."""
    alone = make_task("maze", maze="4x4", num_goals=1)
    found = solve_joint(alone, "runner", {}, objective="return").mean_over_starts
    tour = float(expected_tour_length(alone.mazes[0], 1))
    assert found == pytest.approx(1.0 - 0.1 * (tour - 1.0), abs=1e-12)
    rewards = "runner.step=-0.1,runner.goal=0.7,chaser.step=-0.3,chaser.capture=0.2,evader.step=0.1"
    race = Task(maze="2x2", num_runners=3, num_goals=1, rewards=rewards)
    assert set(game_of_task(race).rewards.ravel().tolist()) == {-0.1, 0.7, 0.7 / 2, 0.7 / 3}
    chase = Task(maze="2x2", num_chasers=2, num_evaders=1, rewards=rewards)
    paid = {-0.3, 0.2, 0.2 / 2, 0.1, -1.0}
    assert set(game_of_task(chase).rewards.ravel().tolist()) <= paid | {0.0}


@pytest.mark.parametrize("order", ORDERS)
def test_values_of_teams_are_by_cells(order: Any) -> None:
    task = make_task("chase", maze="3x3", num_chasers=2, move_order=order)
    games = Simulator(task, 50, 2**62).games
    for role in ("chaser", "chaser_1", "evader"):
        best = best_team_response(task, role, SCRIPTED, 50)
        found = solve_joint(task, role, SCRIPTED, 50)
        assert best.role == role and best.policies[best.agents[0]] is best.policy
        assert best.mean_over_starts == found.mean_over_starts
        np.testing.assert_array_equal(best.values[tuple(games.position.T)], found.values_of(games))
        np.testing.assert_array_equal(best.values_of(games), found.values_of(games))
    values = evaluate_joint(task, SCRIPTED, 50)
    known_mean = mean_over_team_starts(evaluate_team(task, SCRIPTED, 50), task)
    assert values.length == pytest.approx(known_mean, rel=1e-12)


# -- games that are played -------------------------------------------------------------------------


def played(task: Task, policies: dict[str, Policy], games: int = 4000) -> tuple[Any, Any, Any]:
    """Of every game: steps in which each agent was free [games, agents], returns, whether ended."""
    simulator = Simulator(task, games, 2**62 + 5, auto_restart=False)
    seats = zip(task.agent_names, task.seat_roles, strict=True)
    filled = [policies.get(name, policies.get(role)) for name, role in seats]
    actions = np.zeros((games, task.num_agents), dtype=np.int32)
    steps = np.zeros((games, task.num_agents))
    for _ in range(task.max_steps):
        steps += ~simulator.ended[:, None] & (simulator.active != 0)
        simulator.act(filled, actions)
        simulator.step(actions)
    return steps, simulator.returns, simulator.terminated


def near(samples: Any, mean: float) -> bool:
    """Whether a mean lies within four standard errors of that of samples."""
    return abs(samples.mean() - mean) <= 4.0 * samples.std() / len(samples) ** 0.5 + 1e-4


PLAYED = [
    (make_task("chase", maze="3x3", num_evaders=2), "chaser", SCRIPTED, "steps"),
    (make_task("chase", maze="3x3-tree", num_evaders=2), "evader_1", SCRIPTED, "steps"),
    (make_task("race", maze="3x3", max_steps=30), "runner_0", SCRIPTED, "steps"),
    (make_task("race", maze="3x3", max_steps=30), "runner_1", SCRIPTED, "return"),
    (make_task("heist", maze="3x3", max_steps=40), "evader", IN_A_HEIST, "return"),
    (
        make_task("heist", maze="3x3", stay_action=True, move_order="chasers_first", max_steps=40),
        "chaser",
        IN_A_HEIST,
        "return",
    ),
]


@pytest.mark.parametrize("case", PLAYED, ids=lambda case: f"{case[0].name}-{case[1]}-{case[3]}")
def test_the_policy_that_is_found_reaches_the_value_that_is_found(case: Any) -> None:
    task, agents, policies, objective = case
    found = solve_joint(task, agents, policies, task.max_steps, objective=objective)
    assert found.reaches_values
    seats = [task.seat(name) for name in found.agents]
    against = policies | dict.fromkeys(found.agents, found.policy)
    steps, returns, _ = played(task, against)
    samples = steps[:, seats].max(axis=1) if objective == "steps" else returns[:, seats].sum(axis=1)
    assert near(samples, found.mean_over_starts)
    scripted = evaluate_joint(task, policies, task.max_steps)
    name = found.agents[0]
    if objective == "return":  # no less than anybody else
        assert found.mean_over_starts >= scripted.returns[name] - 1e-9
    simulator = Simulator(task, 3, 1)
    values = found.values_of(simulator.games)
    assert values.shape == (3,) and (values != 0.0).all()


def test_the_values_of_given_policies_are_those_of_games() -> None:
    tasks = [case[0] for case in PLAYED]
    crowd = Task(maze="2x2", num_chasers=1, num_evaders=1, num_runners=1, num_goals=1, max_steps=9)
    for task in (tasks[0], tasks[2], tasks[5], crowd):
        policies = IN_A_HEIST if task.name == "heist" else SCRIPTED
        found = evaluate_joint(task, policies, task.max_steps)
        steps, returns, ended = played(task, policies)
        assert near(steps.max(axis=1), found.length) and near(ended, found.ended)
        for seat, name in enumerate(task.agent_names):
            assert near(steps[:, seat], found.steps[name])
            assert near(returns[:, seat], found.returns[name])


def test_a_stationary_solution_may_be_played_against() -> None:
    task = make_task("race", maze="3x3", num_goals=2)
    best = solve_joint(task, "runner_0", SCRIPTED, None, 0.95, "return")
    both = {"runner_0": best.policy, "runner_1": SCRIPTED["runner"]}
    assert evaluate_joint(task, both, None, 0.95).returns["runner_0"] == pytest.approx(
        best.mean_over_starts, rel=1e-8
    )
    timed = solve_joint(task, "runner_0", SCRIPTED, 20)
    with pytest.raises(ValueError, match="step"):
        evaluate_joint(task, {**both, "runner_0": timed.policy})


# -- what they stand on ----------------------------------------------------------------------------


def test_an_opponent_in_a_race_may_be_a_table_of_pairs_of_cells() -> None:
    """Solved as its docstring offers, and played for what it is worth in the simulator."""
    task = make_task("race", maze="3x3", num_goals=2, max_steps=30)
    maze = task.mazes[0]
    table = np.random.default_rng(0).dirichlet(np.ones(4), size=(9, 9))
    best = solve_joint(task, "runner_0", {"runner_1": table}, 30, objective="return")
    given = evaluate_joint(task, {"runner_0": NearestGoalRunner(0.1), "runner_1": table}, 30)
    for policy, expected in (
        (best.policy, best.mean_over_starts),
        (NearestGoalRunner(0.1), given.returns["runner_0"]),
    ):
        simulator = Simulator(task, 4000, seed=3, auto_restart=False)
        actions = np.zeros((4000, 2), dtype=np.int32)
        while not simulator.ended.all():
            simulator.act([policy, TablePolicy(maze, table)], actions)
            simulator.step(actions)
        returns = simulator.returns[:, 0]
        assert returns.mean() == pytest.approx(expected, abs=4 * returns.std() / 4000**0.5)
    alone = make_task("maze", maze="3x3", num_goals=1)
    with pytest.raises(ValueError, match="no agent but runner_0"):
        evaluate_joint(alone, {"runner": table}, 30)


def test_states_have_numbers_and_numbers_have_states() -> None:
    crowd = Task(maze="2x2", num_chasers=1, num_evaders=1, num_runners=1, num_goals=1)
    for task in (
        crowd,
        make_task("race", maze="2x2", num_goals=2),
        make_task("heist", num_evaders=2, maze="3x3"),
    ):
        others = dict.fromkeys(task.seat_roles, RandomAgent())
        states = solve_joint(task, task.agent_names[0], others, 1, objective="return").states
        assert states.count == count_joint_states(task)
        games, _ = states.games(0, states.count)
        assert (states.numbers(games) == np.arange(states.count)).all()
        games.goal[:] = games.goal[:, ::-1].copy()  # whatever their order
        assert (states.numbers(games) == np.arange(states.count)).all()
    assert count_joint_states(make_task("race", maze="5x5")) == 625 * (25 + 300 + 2300)
    assert count_joint_states(make_task("chase", maze="5x5", num_evaders=2)) == 25**3 + 2 * 25**2


@pytest.mark.parametrize(
    "task",
    [
        make_task("heist", maze=MARKED, start="marks", num_goals=3),
        make_task("chase", maze=MARKED, start="marks", num_evaders=2),
        make_task("chase", maze="3x3", num_chasers=2, min_start_distance=3),
    ],
)
def test_starts_are_those_that_the_simulator_draws(task: Task) -> None:
    others = dict.fromkeys(task.seat_roles, RandomAgent())
    states = solve_joint(task, task.agent_names[0], others, 1, objective="return").states
    starts = np.concatenate(list(states.starts()))
    drawn_ones = states.numbers(Simulator(task, 20_000, 3).games)
    assert set(drawn_ones.tolist()) <= set(starts.tolist())
    if len(starts) < 1000:
        assert set(drawn_ones.tolist()) == set(starts.tolist())
    sample = np.zeros(states.count)
    sample[starts] = np.random.default_rng(0).random(len(starts))
    assert near(sample[drawn_ones], float(states.mean_over_starts(sample)))


@pytest.mark.parametrize("name", ["chase", "race", "heist"])
def test_scripted_agents_play_their_distributions(name: str) -> None:
    more: dict[str, Any] = {"num_evaders": 2, "num_chasers": 2} if name == "chase" else {}
    task = make_task(name, maze="4x4", stay_action=True, **more)
    policies = IN_A_HEIST if name == "heist" else SCRIPTED
    games = Simulator(task, 1, 8)
    many = Simulator(task, 20_000, 5)
    many.place(games.positions[0], games.goals[0] if task.num_goals else None)
    for seat, role in enumerate(task.seat_roles):
        policy: Any = policies[role]
        chances = policy.distribution(task, many.games, seat)
        assert (chances == chances[0]).all()
        shares = np.bincount(policy.act(many.view(seat)), minlength=5) / 20_000
        np.testing.assert_allclose(shares, chances[0], atol=0.02)


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    task = make_task("heist", maze="3x3", num_goals=2)
    for horizon, discount in ((25, 1.0), (None, 0.9)):
        rest: Any = (horizon, discount, "return")
        alone = solve_joint(task, "chaser", IN_A_HEIST, *rest)
        with monkeypatch.context() as limits:
            limits.setattr(joint_sweeps, "THREADED_STATES", 0)
            threaded = solve_joint(task, "chaser", IN_A_HEIST, *rest)
        np.testing.assert_array_equal(alone.values, threaded.values)
    monkeypatch.setattr(joint_sweeps, "MAX_STORE_BYTES", 1000)
    with pytest.raises(ValueError, match=r"transitions of .* states needs .* the limit is 1,000"):
        solve_joint(task, "chaser", IN_A_HEIST, objective="return")


def test_a_plan_that_does_not_fit_is_that_of_the_first_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task = make_task("race", maze="3x3", num_goals=2)
    whole = solve_joint(task, "runner_0", SCRIPTED, 100)
    for room in (3, 90):  # less than the sweeps that it takes to settle, and more
        monkeypatch.setattr(joint, "MAX_PLAN_BYTES", room * whole.states.count)
        first = solve_joint(task, "runner_0", SCRIPTED, 100)
        assert not first.reaches_values and len(first.policy.choices) == 1
        np.testing.assert_array_equal(first.policy.choices[0], whole.policy.choices[0])
        np.testing.assert_array_equal(first.values, whole.values)


def test_refusals_name_value_rule_and_remedy() -> None:
    race, heist = make_task("race", maze="3x3"), make_task("heist", maze="3x3")
    with pytest.raises(ValueError, match=r"10,449 states .*at most 1,000 are solved: take"):
        solve_joint(race, "runner_0", SCRIPTED, most_states=1000)
    with pytest.raises(ValueError, match=r"states .*at most 100,000,000 are solved"):
        solve_joint(make_task("race", maze="9x9"), "runner_0", SCRIPTED)
    with pytest.raises(ValueError, match="8 agents as one have 65,536 joint actions"):
        solve_joint(make_task("race", maze="4x4", num_runners=8, num_goals=1), "runner", {})
    with pytest.raises(ValueError, match="runner_1 has no policy"):
        solve_joint(race, "runner_0", {})
    with pytest.raises(ValueError, match=r"use NearestGoalRunner \(astar\)"):
        solve_joint(race, "runner_0", {"runner": TourRunner()})
    with pytest.raises(ValueError, match="memory or no distribution"):
        solve_joint(heist, "evader", {"chaser": SearchingChaser()}, objective="return")
    with pytest.raises(ValueError, match="take objective='return'"):
        solve_joint(heist, "evader", IN_A_HEIST)
    with pytest.raises(ValueError, match="horizon"):
        solve_joint(race, "runner_0", SCRIPTED, 0)
    with pytest.raises(ValueError, match=r"discount=1\.5"):
        solve_joint(race, "runner_0", SCRIPTED, 5, 1.5)
    with pytest.raises(ValueError, match="mazes"):
        count_joint_states(make_task("race", maze=("3x3", "4x4")))
    best = solve_joint(race, "runner_0", SCRIPTED, 5)
    other = make_task("race", maze="4x4")
    with pytest.raises(ValueError, match="another maze"):
        Simulator(other, 1).act([best.policy, None], np.zeros((1, 2), dtype=np.int32))
    with pytest.raises(ValueError, match="not for 1"):
        Simulator(race, 1).act([None, best.policy], np.zeros((1, 2), dtype=np.int32))


class DrawnAlways:
    """An evader with fixed chances."""

    own = np.array([0.1, 0.2, 0.3, 0.4])

    def act(self, view: Any) -> Any:  # only its distributions are evaluated
        raise AssertionError

    def distribution(self, task: Task, games: Any, seat: int) -> Any:
        return np.tile(self.own, (len(games.steps), 1))


class DrawnTogether(DrawnAlways):
    """Two evaders as one player, whose joint distribution is the product of independent ones."""

    def joint_distribution(self, task: Task, games: Any) -> Any:
        return np.tile(np.outer(self.own, self.own).ravel(), (len(games.steps), 1))


def test_evaders_that_draw_together_independently_play_as_independent_evaders() -> None:
    """A captured evader has no part in the joint action of the others."""
    task = make_task("chase", maze="3x3", num_chasers=2, num_evaders=2)
    together = DrawnTogether()
    alone = {"evader_0": DrawnTogether(), "evader_1": DrawnTogether()}  # two players
    found, expected = (
        evaluate_joint(task, {"chaser": AStarChaser(0.2), **evaders}, 50)
        for evaders in ({"evader": together}, alone)
    )
    for seat in ("evader_0", "evader_1", "chaser_0"):
        assert found.steps[seat] == pytest.approx(expected.steps[seat], rel=1e-12)
        assert found.returns[seat] == pytest.approx(expected.returns[seat], rel=1e-12)
    assert found.length == pytest.approx(expected.length, rel=1e-12)


class DrawnWhileFree(DrawnAlways):
    """Rows of zeros where the evader is captured and plays no more."""

    def distribution(self, task: Task, games: Any, seat: int) -> Any:
        return np.where(games.active[:, seat, None] != 0, self.own, 0.0)


def test_rows_of_captured_evaders_do_not_count() -> None:
    task = make_task("chase", maze="3x3", num_evaders=2)
    with np.errstate(invalid="raise"):
        found, expected = (
            evaluate_joint(task, {"chaser": AStarChaser(0.2), "evader": policy}, 50)
            for policy in (DrawnWhileFree(), DrawnAlways())
        )
    assert found.returns == expected.returns and found.length == expected.length


def test_a_policy_of_states_plays_the_first_action_where_a_game_is_over() -> None:
    task = make_task("chase", maze="2x2", num_evaders=2)
    policy = solve_joint(task, "chaser_0", SCRIPTED, None, 0.9).policy
    simulator = Simulator(task, 1, auto_restart=False)
    simulator.active[:, 1:] = 0
    assert policy.distribution(task, simulator.games, 0).tolist() == [[1.0, 0.0, 0.0, 0.0]]
