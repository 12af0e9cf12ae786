"""Stable-Baselines3 trains on the arm, and SuperSuit vectorises it."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

pytest.importorskip("stable_baselines3")
from stable_baselines3 import PPO, TD3
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy

from pursuit import ReacherTask, ReacherVectorEnv, reacher_v0
from pursuit.environments.stable_baselines import StableBaselinesVecEnv

ID = "pursuit/Reacher-v0"
FORMS: list[dict[str, Any]] = [{}, {"joints": 1}, {"joints": 8}, {"discrete_actions": True}]

pytestmark = pytest.mark.filterwarnings("error::UserWarning")


def test_stable_baselines_checks_and_trains() -> None:
    for form in FORMS:
        check_env(gymnasium.make(ID, **form).unwrapped)
    for settings in ({}, {"discrete_actions": True}):
        envs = gymnasium.make_vec(ID, num_envs=8, max_steps=20, **settings)
        env = StableBaselinesVecEnv(envs.unwrapped)
        model = PPO("MlpPolicy", env, n_steps=32, batch_size=64, n_epochs=2, device="cpu")
        model.learn(512)
        assert model.num_timesteps == 512 and len(model.ep_info_buffer or []) > 5
        _, lengths = evaluate_policy(
            model, env, n_eval_episodes=8, return_episode_rewards=True, warn=False
        )
        assert max(lengths) <= 20
        with pytest.raises(ValueError, match="every action is legal"):
            env.action_masks()
    env = StableBaselinesVecEnv(ReacherVectorEnv(ReacherTask(max_steps=20), 4))
    learner = TD3("MlpPolicy", env, learning_starts=40, batch_size=32, device="cpu").learn(120)
    assert learner.num_timesteps == 120


@pytest.mark.parametrize("mode", AutoresetMode)
def test_ends_of_episodes_of_stable_baselines(mode: AutoresetMode) -> None:
    task = ReacherTask(max_steps=4, tolerance=0.5)
    env = StableBaselinesVecEnv(ReacherVectorEnv(task, 9, autoreset_mode=mode))
    reference = ReacherVectorEnv(task, 9, autoreset_mode="SAME_STEP")
    env.seed(3)
    assert (env.reset() == reference.reset(seed=[*range(3, 12)])[0]).all()
    rng, kinds = np.random.default_rng(0), set()
    for _ in range(40):
        actions = rng.uniform(-1, 1, (9, 2)).astype(np.float32)
        observations, rewards, dones, infos = env.step(actions)
        seen, amounts, terminations, truncations, expected = reference.step(actions)
        assert (observations == seen).all() and (rewards == amounts).all()
        assert (dones == (terminations | truncations)).all()
        for arm in np.flatnonzero(dones):
            kinds.add(infos[arm]["TimeLimit.truncated"])
            assert infos[arm]["TimeLimit.truncated"] == truncations[arm]
            assert (infos[arm]["terminal_observation"] == expected["final_obs"][arm]).all()
            assert infos[arm]["episode"]["l"] == expected["final_info"]["episode_length"][arm]
    assert kinds == {True, False}


def test_supersuit_vectorises_the_team_of_joints() -> None:
    supersuit = pytest.importorskip("supersuit")
    envs = supersuit.pettingzoo_env_to_vec_env_v1(reacher_v0.parallel_env(joints=3, max_steps=7))
    twin = reacher_v0.parallel_env(joints=3, max_steps=7)
    observed, _ = envs.reset(seed=0)
    twin.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(20):
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32)
        observed, rewards, terminations, truncations, _ = envs.step(actions)
        seen, amounts, *ends, _ = twin.step(dict(zip(twin.agents, actions, strict=True)))
        assert rewards.tolist() == [np.float32(reward) for reward in amounts.values()]
        for flags, expected in zip((terminations, truncations), ends, strict=True):
            assert flags.tolist() == [*expected.values()]
        if not twin.agents:
            seen, _ = twin.reset()
        assert (observed == np.stack([*seen.values()])).all()
