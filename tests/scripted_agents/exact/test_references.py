"""Which exact reference an agent has in a game, or the reason why it has none."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from pursuit import ReacherTask, make_task
from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    NearestGoalRunner,
    SearchingChaser,
    TablePolicy,
    best_response,
    best_team_response,
    joint_nash_conv,
    solve_chase,
    solve_joint,
    solve_joint_game,
)
from scripted_agents.exact.limits import MAX_EVALUATED_WORK, MAX_WORK, work_of
from scripted_agents.exact.references import reference_of
from scripted_agents.games import equilibrium, game_of_task, nash_conv, respond
from train.evaluation.arm_contest import ArmContest

SCRIPTED: dict[str, Policy] = {
    "chaser": AStarChaser(0.1),
    "evader": AStarEvader(0.1),
    "runner": NearestGoalRunner(0.1),
}


def no_rewards(before: Any, actions: Any, after: Any) -> Any:
    return np.zeros(np.shape(actions))


def policies_in(task: Task) -> dict[str, Policy]:
    return {role: SCRIPTED[role] for role in task.seat_roles}


@pytest.mark.parametrize(
    ("name", "settings", "kind"),
    [
        ("maze", {"num_goals": 18}, "tour"),
        ("maze", {"num_goals": 3, "maze": ["3x3", "5x5"]}, "tour"),
        ("maze", {"start": "marks", "num_goals": 1}, "tour"),
        ("chase", {}, "duel"),
        ("chase", {"maze": ["3x3", "5x5"]}, "duel"),
        ("chase", {"num_chasers": 2}, "team"),
        ("chase", {"maze": "3x3", "num_evaders": 2}, "joint"),
        ("chase", {"maze": "3x3", "start": "marks"}, "joint"),
        ("race", {"maze": "3x3", "num_goals": 2}, "joint"),
        ("heist", {"maze": "3x3", "num_goals": 2}, "joint"),
        ("chase", {"view_radius": {"chaser": 1}}, "bounds"),
        ("chase", {"view_radius": {"evader": 1}}, "duel"),  # the chaser's own view is full
    ],
)
def test_the_first_agent_has_a_reference(name: str, settings: dict[str, Any], kind: str) -> None:
    task = make_task(name, **settings)
    found = reference_of(task, task.agent_names[0], policies_in(task), by_maze=True)
    assert found.kind == kind and (found.reason == "") == (kind != "bounds")


def test_reasons_name_the_number_and_the_limit() -> None:
    def reason(name: str, opponents: dict[str, Policy] | None = None, **settings: Any) -> str:
        task = make_task(name, **settings)
        given = policies_in(task) if opponents is None else opponents
        found = reference_of(task, task.agent_names[0], given)
        assert found.kind == "none"
        return found.reason

    assert reason("maze", num_goals=19) == "19 goals; shortest tours are exact for up to 18"
    for name in ("race", "chase"):  # duels only maze by maze
        assert reason(name, maze=["3x3", "5x5"]) == "2 mazes; whole games are solved in one"
    assert reason("chase", maze="15x15", view_radius=2) == "limited view"  # 225 cells, not 100
    states = 25**4 + 2 * 25**3  # both evaders free, or one of them
    assert reason("chase", num_chasers=2, num_evaders=2) == (
        f"{states:,} states, times joint actions {states * 4**4:,}; at most 5,000,000 are solved "
        "here"
    )
    assert "memory or no distribution" in reason(
        "chase", {"chaser": SearchingChaser(), "evader": AStarEvader()}, num_chasers=2
    )
    paid = {"maze": "3x3", "num_goals": 2, "rewards": no_rewards}
    assert reason("heist", **paid) == "user-defined rewards"  # its measure is the return


def test_more_work_is_done_for_final_results() -> None:
    task = make_task("chase", num_chasers=2, num_evaders=2)
    assert MAX_WORK < work_of(task) <= MAX_EVALUATED_WORK
    found = reference_of(task, "chaser_0", policies_in(task), MAX_EVALUATED_WORK)
    assert asdict(found) == {"kind": "joint", "reason": ""}


def test_the_arm_has_a_reference_with_continuous_actions() -> None:
    assert ArmContest(ReacherTask()).exact_reference.kind == "arm"
    found = ArmContest(ReacherTask(discrete_actions=True)).exact_reference
    assert found.kind == "none" and found.reason.startswith("discrete actions")


def test_results_of_all_solvers_have_one_form() -> None:
    duel, race = make_task("chase", maze="3x3"), make_task("race", maze="2x2", num_goals=1)
    team = make_task("chase", maze="2x2", num_chasers=2)
    maze, small = duel.mazes[0], game_of_task(make_task("chase", maze="2x2", rewards="zero_sum"))
    table = AStarEvader(0.1).action_probabilities(maze)
    sizes = [np.diff(small.offsets(number)) for number in range(2)]
    uniform = {
        name: np.repeat(1.0 / each, each) for name, each in zip(small.players, sizes, strict=True)
    }
    response = best_response("chaser", maze, table, 20)
    results: list[Any] = [
        response,
        solve_joint(race, "runner_0", SCRIPTED, 20),
        best_team_response(team, "chaser", SCRIPTED, 20),
        respond(small, "chaser_0", uniform),
        solve_chase(maze),
        solve_joint_game(race, 0.9),
        equilibrium(small, 0.9),
    ]
    for result in results:
        assert result.values.dtype == float and isinstance(result.mean_over_starts, float)
        assert result.policies
    for result in results[4:]:
        assert result.mixed.shape == result.values.shape and result.mixed.dtype == bool
    assert response.policies["chaser"] is response.policy
    assert TablePolicy(maze, response.policies["chaser"])
    for found in (joint_nash_conv(race, SCRIPTED, 20), nash_conv(small, uniform)):
        assert found.nash_conv == sum(found.gains.values()) >= 0.0


def test_astronomic_sizes_are_powers_of_ten() -> None:
    task = make_task("chase", maze="9x9", num_chasers=8, num_evaders=30)
    opponents: dict[str, Policy] = {"evader": AStarEvader()}
    reason = reference_of(task, "chaser", opponents, team=True).reason
    # Every evader is in one of 81 cells or captured, not all of them: 81**8 * (82**30 - 1) states.
    states = 81**8 * (82**30 - 1)
    power = len(str(states)) - 1
    assert reason.startswith(f"about 10^{power} states, times joint actions about 10^")
