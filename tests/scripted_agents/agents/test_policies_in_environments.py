"""Policies in the PettingZoo environment: what they do there is what they do in the simulator."""

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from pursuit import chase_v0, heist_v0
from pursuit.simulator.policy import Policy
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import AStarChaser, AStarEvader, NearestGoalRunner, RandomAgent


def one_way(action: int) -> Any:
    """A policy that always does the same."""
    return SimpleNamespace(act=lambda view: np.full(view.num_games, action, dtype=np.int32))


@pytest.mark.parametrize("module", [chase_v0, heist_v0])
def test_a_game_played_by_policies_is_that_of_the_simulator(module: Any) -> None:
    env = module.parallel_env(maze="4x4", num_chasers=2, num_evaders=2, observation="planes")
    policies: dict[str, Policy] = {"chaser": AStarChaser(0.3), "evader": AStarEvader(0.3)}
    by_seat = [policies[role] for role in env.task.seat_roles]
    simulator = Simulator(env.task, seed=7, auto_restart=False)
    actions = np.zeros((1, env.task.num_agents), dtype=np.int32)
    env.reset(seed=7)
    while env.agents:
        env.step(env.act(policies))
        simulator.act(by_seat, actions)
        simulator.step(actions)
        np.testing.assert_array_equal(env.unwrapped.simulator.positions, simulator.positions)
    assert simulator.ended[0] and env.act(policies) == {}


def test_a_name_goes_before_a_role_and_who_has_no_policy_is_left_out() -> None:
    env = chase_v0.parallel_env(maze="4x4", num_chasers=2, num_evaders=1)
    env.reset(seed=0)
    assert env.act({"chaser": one_way(1), "chaser_1": one_way(3)}) == {"chaser_0": 1, "chaser_1": 3}


def test_what_is_no_policy_is_refused() -> None:
    env = chase_v0.parallel_env()
    with pytest.raises(ValueError, match="reset"):
        env.act({"chaser": RandomAgent()})
    env.reset(seed=0)
    for policies, message in (
        ({"runner": RandomAgent()}, "chaser_0, evader_0"),
        ({"chaser": 3}, "method `act`"),
        ([RandomAgent()], "a dict"),
        ({"chaser": AStarEvader()}, "policy of the evader; chaser_0 needs one of the"),
    ):
        with pytest.raises(ValueError, match=message):
            env.act(policies)


def test_a_policy_of_another_role_is_refused_wherever_it_is_given() -> None:
    wrong, message = AStarChaser(), "policy of the chaser; evader_0 needs one of the"
    simulator = Simulator(make_task("chase"), 2, seed=0)
    actions = np.full((2, 2), 3, dtype=np.int32)
    for policies in ([None, wrong], [wrong, wrong]):
        with pytest.raises(ValueError, match=message):
            simulator.act(policies, actions)
    assert (actions == 3).all()
    learned = SimpleNamespace(act=wrong.act, agent="chaser_0")
    for opponent in (wrong, learned):
        with pytest.raises(ValueError, match="evader_0 needs one of the evader"):
            gymnasium.make("pursuit/Chaser-v0", opponent=opponent)
        with pytest.raises(ValueError, match="evader_0 needs one of the evader"):
            gymnasium.make_vec("pursuit/Chaser-v0", num_envs=2, opponent=opponent)
    heist = Simulator(make_task("heist", maze="4x4"), 2, seed=0)
    heist.act([None, NearestGoalRunner()], np.zeros((2, 2), dtype=np.int32))  # it collects goals
