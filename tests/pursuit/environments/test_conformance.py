"""`check_parallel_env` passes for all environments and finds every faulty one."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np
import pettingzoo
import pytest
from broken_environments import BROKEN, Broken, returning
from conformance import ConformanceError, check_parallel_env
from diagonals import diagonal

from pursuit import chase_v0, heist_v0, maze_v0, race_v0
from pursuit.environments.parallel import PursuitParallelEnv
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS

MARKED = Maze.from_text("+-+-+-+\n|S    |\n+ +-+ +\n|    G|\n+-+-+-+")
ENCLOSED = Maze.from_text("+-+-+-+\n| |   |\n+-+-+-+")
OURS: dict[str, Callable[..., PursuitParallelEnv]] = {
    "chase": chase_v0.parallel_env,
    "two hunt three": lambda **settings: chase_v0.parallel_env(
        maze="4x4", num_chasers=2, num_evaders=3, move_order="chasers_first", **settings
    ),
    "several mazes": lambda **settings: chase_v0.parallel_env(
        maze=["3x3-open", "5x5", "4x4-tree"], stay_action=True, **settings
    ),
    "enclosed cells": lambda **settings: chase_v0.parallel_env(maze=ENCLOSED, **settings),
    "heist": lambda **settings: heist_v0.parallel_env(
        maze="3x3", num_evaders=2, rewards="distance", **settings
    ),
    "maze": lambda **settings: maze_v0.parallel_env(maze="3x3", **settings),
    "masks": lambda **settings: heist_v0.parallel_env(
        maze=["3x3", "4x4"], num_evaders=2, stay_action=True, mask_bumps=True, **settings
    ),
    "race": lambda **settings: race_v0.parallel_env(maze="3x3", stay_action=True, **settings),
}


@pytest.mark.parametrize(("name", "observation"), diagonal(OURS, ENCODINGS))
def test_the_environments_conform(name: str, observation: str) -> None:
    check_parallel_env(OURS[name](observation=observation, max_steps=40), max_steps=40)


def test_conformance_holds_after_a_copy() -> None:
    env = chase_v0.parallel_env(max_steps=40)
    env.reset(seed=1)
    check_parallel_env(deepcopy(env), max_steps=40)


def test_an_environment_of_pettingzoo_passes() -> None:
    env = pettingzoo.make("parallel", "classic/rps-v2")
    check_parallel_env(env, random_starts=False)


def test_fixed_starts_need_random_starts_false() -> None:
    env = chase_v0.parallel_env(maze=MARKED, start="marks", max_steps=20)
    check_parallel_env(env, random_starts=False)
    with pytest.raises(ConformanceError, match="16 seeds gave the same start"):
        check_parallel_env(env)


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_environment_is_found(name: str) -> None:
    methods, message = BROKEN[name]
    with pytest.raises(ConformanceError, match=message) as raised:
        check_parallel_env(Broken(**methods), max_steps=60)
    assert isinstance(raised.value, AssertionError)


def test_the_unmodified_test_environment_conforms() -> None:
    check_parallel_env(Broken(), episodes=4, max_steps=60)


def test_infos_may_contain_any_values() -> None:
    def note(infos: dict[str, Any], env: Broken) -> dict[str, Any]:
        odd = {"nan": np.full(3, np.nan), "nothing": np.array(None), "clock": iter(())}
        return {agent: {**info, **odd} for agent, info in infos.items()}

    check_parallel_env(Broken(**returning(4, note, note)), max_steps=60)


def test_masks_are_followed_in_every_other_episode() -> None:
    bumps: list[bool] = []

    def step(env: Broken, actions: dict[str, int]) -> Any:
        masks = {agent: info["action_mask"] for agent, info in env._infos().items()}
        bumps[-1] |= any(not masks[agent][action] for agent, action in actions.items())
        return PursuitParallelEnv.step(env, actions)

    def reset(env: Broken, seed: int | None = None, options: Any = None) -> Any:
        bumps.append(False)
        return PursuitParallelEnv.reset(env, seed, options)

    check_parallel_env(Broken(step=step, reset=reset), episodes=4, max_steps=60)
    of_pettingzoo = 4  # episodes of its own test come first
    assert bumps[of_pettingzoo:][:8] == 2 * [True, False, False, True]
