"""A batch and an interface of the user's are enough for all environments."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from claims import AnyFree, Claims, ClaimsBatch, ClaimsInterface
from conformance import check_parallel_env
from diagonals import diagonal
from gymnasium.spaces import Box
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode
from pettingzoo.test import api_test, parallel_seed_test, seed_test

from pursuit.environments.parallel import GameParallelEnv
from pursuit.environments.single_env import GameEnv
from pursuit.environments.turn_based import turn_based_makers
from pursuit.environments.vector import GameVectorEnv

OTHERS = {"red": AnyFree(), "blue": AnyFree()}


def interface(games: int = 1) -> ClaimsInterface:
    return ClaimsInterface(ClaimsBatch(Claims(), games, auto_restart=False))


def single(**modes: Any) -> GameEnv:
    return GameEnv(interface(), "green", OTHERS, **modes)


def parallel(**modes: Any) -> GameParallelEnv:
    return GameParallelEnv(interface(), **modes)


@pytest.mark.parametrize("masks", [False, True])
def test_checks_of_pettingzoo_gymnasium_and_our_own(masks: bool) -> None:
    check_parallel_env(parallel(mask_in_observation=masks))
    parallel_seed_test(parallel)
    raw_env, env = turn_based_makers(parallel)
    api_test(env(mask_in_observation=masks), num_cycles=50)
    seed_test(raw_env, num_cycles=20)
    check_env(single(mask_in_observation=masks, render_mode="ansi"))
    assert env().metadata["name"] == "claims_v0"


def test_what_the_environments_show_is_the_game() -> None:
    env = parallel(render_mode="ansi")
    seen, infos = env.reset(seed=3)
    owner = env.simulator.owner[0]
    assert (infos["blue"]["action_mask"] == (owner == 3)).all() and env.has_masks
    assert env.state() in env.state_space and env.state_space == Box(0, 1, (135,), np.float32)
    assert (env.state() == np.concatenate([*seen.values()])).all()
    first, second = np.flatnonzero(owner == 3)[:2]
    _, rewards, *_ = env.step({"red": first, "green": second, "blue": second})
    assert rewards == {"red": 1.0, "green": 0.0, "blue": 0.0}
    row, footer = env.render().splitlines()
    assert row[first] + row[second] == "rx" and footer == "step 1 / 6"
    picture = GameParallelEnv(env.interface, "rgb_array").render()
    assert picture.shape == (516, 480, 3) and (picture < 128).any()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_batch_is_as_many_single_environments(mode: AutoresetMode) -> None:
    envs = GameVectorEnv(interface(4), "green", OTHERS, autoreset_mode=mode)
    singles, random = [single() for _ in range(4)], np.random.default_rng(0)
    seen, infos = envs.reset(seed=[*range(4)])
    for seed, env in enumerate(singles):
        first, info = env.reset(seed=seed)
        assert (first == seen[seed]).all()
        assert (info["action_mask"] == infos["action_mask"][seed]).all()
    lengths = []
    for _ in range(6):
        chosen = np.array([random.choice(np.flatnonzero(row)) for row in envs.action_masks()])
        seen, rewards, terminated, truncated, infos = envs.step(chosen)
        over = terminated | truncated
        final = infos.get("final_info", infos)
        for game, env in enumerate(singles):
            last, *results, info = env.step(chosen[game])
            assert results == [rewards[game], terminated[game], truncated[game]]
            if over[game] and mode is AutoresetMode.SAME_STEP:
                assert (infos["final_obs"][game] == last).all()
            else:
                assert (seen[game] == last).all()
            if over[game]:
                assert info["episode_return"] == final["episode_return"][game]
                lengths.append(info["episode_length"])
        if over.any():  # only games that go on are compared
            break
    assert lengths


def test_stable_baselines_takes_the_batch() -> None:
    pytest.importorskip("stable_baselines3")
    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    env = StableBaselinesVecEnv(GameVectorEnv(interface(4), "green", OTHERS))
    env.seed(0)
    assert env.reset().shape == (4, 45) and env.action_masks().shape == (4, 9)
    dones = np.zeros(4, dtype=bool)
    while not dones.any():
        seen, _, dones, infos = env.step(env.action_masks().argmax(axis=1))
    ended = infos[int(dones.argmax())]
    assert ended["episode"]["l"] <= 6 and ended["terminal_observation"].shape == seen[0].shape


@pytest.mark.parametrize(
    ("kind", "copied"),
    diagonal((single, parallel), (copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env)))),
)
def test_copies_go_on_alike(kind: Any, copied: Any) -> None:
    env = kind()
    env.reset(seed=1)
    twin = copied(env)
    action = dict.fromkeys(env.agents, 2) if kind is parallel else 2
    for _ in range(3):
        assert data_equivalence(env.step(action), twin.step(action), exact=True)
    assert twin.interface.simulator is twin.simulator is not env.simulator


def test_refusals() -> None:
    env, envs, team = single(), GameVectorEnv(interface(2), 1, OTHERS), parallel()
    for each in (env, envs, team):
        with pytest.raises(ValueError, match="step before reset"):
            each.step({})
        with pytest.raises(ValueError, match="unknown option 'square'"):
            each.reset(options={"square": 1})
        each.reset(seed=0)
    for call, wrong in (
        (env.step, 9),
        (env.step, 1.0),
        (envs.step, np.array([0, 9])),
        (team.step, {"red": 0, "green": 0, "blue": -1}),
    ):
        with pytest.raises(ValueError, match="integers from 0 to 8"):
            call(wrong)
    for policies in ({}, {"red": AnyFree()}, OTHERS | {"green": AnyFree()}, None):
        with pytest.raises(ValueError, match=r"a policy for each of \['red', 'blue'\]"):
            GameEnv(interface(), "green", policies)
    with pytest.raises(ValueError, match="give one of"):
        GameEnv(interface(), "white", OTHERS)
