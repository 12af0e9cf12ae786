"""Stable-Baselines3 trains on the arm, and SuperSuit vectorises it."""

from typing import Any

import gymnasium
import numpy as np
import pytest

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
