"""Options of the rules in all environments: conformance, masks, observations, states."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from conformance import check_parallel_env
from diagonals import diagonal
from option_tasks import random_task
from pettingzoo.test import api_test
from reference_options import Rulebook

import pursuit
from pursuit import chase_v0, escape_v0
from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.mazes.maze import Maze
from pursuit.mazes.maze_arrays import lay_out
from pursuit.observations.masks import action_masks
from pursuit.observations.observations import ENCODINGS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents.environments import make_vector_env

LINE = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
TWO: dict[str, Any] = {"num_chasers": 2, "num_evaders": 2}
OPTIONS: dict[str, dict[str, Any]] = {
    "escape": {},
    "fixed exits of several mazes": {"maze": ["5x5", "4x4"], "exits": [6, 9], **TWO},
    "turns, drawn exits": {"move_order": "turns", "stay_action": True, "num_exits": 3, **TWO},
    "block, adjacent": {
        "collisions": "block", "capture": "adjacent", "n_catch": 2, "mask_bumps": True,
        "stay_action": True, **TWO,
    },
    "surround, slip, after chasers": {
        "capture": "surround", "slip": {"evader": 0.3}, "move_order": "chasers_first",
        "capture_check": "after_chasers", **TWO,
    },
    "limited views": {"view_radius": 2, "num_exits": 4, **TWO},
}  # fmt: skip


@pytest.mark.parametrize(("name", "observation"), diagonal(OPTIONS, ENCODINGS))
def test_environments_with_options_conform(name: str, observation: str) -> None:
    settings = {"maze": "4x4", "max_steps": 20, "observation": observation, **OPTIONS[name]}
    check_parallel_env(escape_v0.parallel_env(**settings), episodes=1, max_steps=45)
    api_test(escape_v0.env(**settings), num_cycles=60)


# -- masks -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("move_order", ["simultaneous", "chasers_first", "turns"])
def test_masked_moves_never_change_the_cell(move_order: str) -> None:
    """Whatever all others do, by the reference; so a masked move is one that is certainly lost."""
    rng, masked = np.random.default_rng(4), 0
    for _ in range(40):
        task = random_task(rng, move_order=move_order, collisions="block", max_steps=8)
        simulator = Simulator(task, seed=int(rng.integers(99)), auto_restart=False)
        rules = Rulebook(task)
        while not simulator.ended[0]:
            state = rules.read(simulator)
            masks = action_masks(simulator.games, lay_out(task.mazes), task)[0]
            assert masks.any(axis=1).all()
            for seat in rules.movers(state):
                for action in np.flatnonzero(~masks[seat]).tolist():
                    masked += rules.leads_to[state.cells[seat]][action] != state.cells[seat]
                    for _ in range(6):
                        moves = rng.integers(task.num_actions, size=task.num_agents)
                        moves[seat] = action
                        after = rules.step(state, tuple(moves.tolist())).state
                        assert after.cells[seat] == state.cells[seat], (task, state, seat, action)
            waits = set(range(task.num_agents)) - set(rules.movers(state))
            for seat in waits if move_order == "turns" else ():
                if state.active[seat] and rules.beside[state.cells[seat]]:
                    assert masks[seat].tolist() == [False] * task.num_moves + [True]
            simulator.step(rng.integers(task.num_actions, size=(1, task.num_agents)))
    assert masked > 20


def test_masks_hide_agents_out_of_view() -> None:
    """Two placements that an agent cannot distinguish have one mask."""
    task = Task(
        LINE, 2, 1, capture="adjacent", collisions="block", stay_action=True,
        view_radius={"chaser_0": 1, "chaser_1": 0, "evader": 9},
    )  # fmt: skip
    simulator = Simulator(task, 2)
    simulator.place([[1, 2, 4], [1, 4, 3]])
    world = lay_out(task.mazes)
    masks = action_masks(simulator.games, world, task)
    assert masks[:, 0, 2].tolist() == [False, True]  # chaser_0 sees chaser_1 east of it
    assert masks[:, 1, 3].tolist() == [True, True]  # chaser_1 sees nobody
    assert masks[:, 2, 3].tolist() == [True, True] and masks[1, 2, 2].item() is False


def test_masks_of_turns_are_in_the_infos_of_all_environments() -> None:
    settings: dict[str, Any] = {"maze": "4x4-tree", "move_order": "turns", "stay_action": True}
    env = chase_v0.parallel_env(**settings)
    _, infos = env.reset(seed=1)
    stay = [0, 0, 0, 0, 1]
    assert infos["evader_0"]["action_mask"].tolist() == stay
    assert infos["chaser_0"]["action_mask"].sum() > 1
    infos = env.step({"chaser_0": 4, "evader_0": 4})[4]
    assert infos["chaser_0"]["action_mask"].tolist() == stay
    turn_based = chase_v0.env(**settings)
    turn_based.reset(seed=1)
    for agent, waits in (("chaser_0", False), ("evader_0", True), ("chaser_0", True)):
        assert turn_based.agent_selection == agent
        assert (turn_based.infos[agent]["action_mask"].tolist() == stay) is waits
        turn_based.step(4)
    single = gymnasium.make("pursuit/Evader-v0", **settings)
    _, info = single.reset(seed=1)
    assert info["action_mask"].tolist() == stay
    vector = gymnasium.make_vec("pursuit/Chaser-v0", num_envs=3, **settings)
    _, info = vector.reset(seed=1)
    assert (info["action_mask"].sum(axis=1) > 1).all()
    _, _, _, _, info = vector.step(np.full(3, 4))
    assert info["action_mask"].astype(int).tolist() == [stay] * 3
    vec_env = StableBaselinesVecEnv(make_vector_env("chase", "evader", 2, **settings))
    vec_env.reset()
    assert np.array(vec_env.env_method("action_masks")).astype(int).tolist() == [stay] * 2


# -- observations and states -----------------------------------------------------------------------


def test_the_state_has_exits_and_escapes() -> None:
    env = escape_v0.parallel_env(maze=LINE, num_exits=1, stay_action=True, num_evaders=2)
    env.reset(options={"positions": [0, 2, 3], "exits": [4]})
    assert env.state().tolist()[:4] == [1.0, 3.0, 4.0, 5.0]
    _, rewards, terminations, _, _ = env.step({"chaser_0": 4, "evader_0": 4, "evader_1": 2})
    assert terminations == {"chaser_0": False, "evader_0": False, "evader_1": True}
    assert rewards == {"chaser_0": -1.0, "evader_0": 0.0, "evader_1": 1.0}
    assert env.agents == ["chaser_0", "evader_0"] and env.state().tolist()[:4] == [1, 3, 0, 5]
    assert env.state_space.contains(env.state())


def test_an_escape_has_two_exits() -> None:
    assert pursuit.make_task("escape").num_exits == 2
