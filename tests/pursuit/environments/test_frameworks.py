"""Stable-Baselines3 and SuperSuit train on these environments."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

pytest.importorskip("stable_baselines3")
pytest.importorskip("supersuit")
import supersuit
from diagonals import diagonal
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from pursuit import chase_v0, race_v0
from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from scripted_agents.environments import make_env, make_vector_env

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
NORTH, SOUTH, EAST, WEST = range(4)

pytestmark = pytest.mark.filterwarnings("error::UserWarning")


def vec_env(num_envs: int = 4, **settings: Any) -> StableBaselinesVecEnv:
    return StableBaselinesVecEnv(make_vector_env("chase", "chaser", num_envs, **settings))


def ppo(env: Any, policy: str = "MlpPolicy") -> PPO:
    return PPO(policy, env, n_steps=32, batch_size=64, n_epochs=2, seed=0, device="cpu")


@pytest.mark.parametrize(
    ("seat", "observation"), diagonal([("chase", "chaser"), ("maze", "runner")], ENCODINGS)
)
def test_the_check_of_stable_baselines(seat: tuple[str, str], observation: str) -> None:
    with warnings.catch_warnings():
        # It recommends what suits its convolutional policy, which is not meant for small grids.
        for advice in ("Your observation", "It seems that your obs", "Treating image", "The minim"):
            warnings.filterwarnings("ignore", message=advice, category=UserWarning)
        check_env(make_env(*seat, observation=observation))


@pytest.mark.parametrize("observation", ["one_hot", "planes"])
def test_ppo_of_stable_baselines_trains(observation: str) -> None:
    env = vec_env(8, maze="3x3", max_steps=20, observation=observation)
    model = ppo(env).learn(512)
    assert model.num_timesteps == 512
    assert len(model.ep_info_buffer or []) > 5  # "episode" in the infos: no Monitor is needed
    # The buffer bootstraps after truncation from "terminal_observation".
    rewards, lengths = evaluate_policy(
        model, env, n_eval_episodes=8, return_episode_rewards=True, warn=False
    )
    assert len(rewards) == len(lengths) == 8 and max(lengths) <= 20


FORMS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "chase": ("Chaser", {"maze": "3x3"}, {"positions": [0, 8]}),
    "masks": ("Maze", {"maze": "3x3", "num_goals": 1}, {"positions": [0], "goals": [4]}),
    "observed masks": (
        "Race",
        {"mask_in_observation": True},
        {"positions": [0, 3], "goals": [7, 8, 9]},
    ),
    "caught": ("Evader", {"maze": "3x3", "num_evaders": 2}, {"positions": [0, 2, 8]}),
    "arm": ("Reacher", {"tolerance": 0.7}, {"angles": [0.5, 1.0], "target": [1.0, 0.5]}),
}
MASKED = {"mask_bumps": True, "stay_action": True}


def same(one: Any, other: Any) -> None:
    """Arrays, infos and lists of them: equal, except for the wall clock of episodes."""
    if isinstance(other, dict):
        assert one.keys() == other.keys()
        for key in other.keys() - {"t"}:
            same(one[key], other[key])
    elif isinstance(other, list):
        assert len(one) == len(other)
        for mine, wanted in zip(one, other, strict=True):
            same(mine, wanted)
    else:
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_every_call_does_what_the_vec_env_of_stable_baselines_does(form: str) -> None:
    name, settings, start = FORMS[form]
    name, settings = f"pursuit/{name}-v0", {"max_steps": 9, **settings}
    settings |= MASKED if form == "masks" else {}
    envs = gymnasium.make_vec(name, num_envs=3, render_mode="rgb_array", **settings)
    ours = StableBaselinesVecEnv(envs.unwrapped)
    theirs = DummyVecEnv(
        [lambda: Monitor(gymnasium.make(name, render_mode="rgb_array", **settings))] * 3
    )
    both = (ours, theirs)
    assert envs.metadata["autoreset_mode"] is ours.metadata["autoreset_mode"]
    assert ours.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert ours.metadata["render_fps"] == theirs.metadata["render_fps"]
    for options in (None, start, [{}, start, {}], [start, dict(start), {}]):
        assert ours.seed(7) == theirs.seed(7)
        for each in both:
            each.set_options(options)
        ours.action_space.seed(1)
        # The second reset continues, without the seeds and options of the first one.
        for _ in range(2):
            same(*(each.reset() for each in both))
            same(ours.reset_infos, theirs.reset_infos)
            for _ in range(12):
                actions = np.array([ours.action_space.sample() for _ in range(3)])
                (seen, *results, infos), (wanted, *expected, hints) = (
                    each.step(actions) for each in both
                )
                same(seen, wanted)
                same(results, expected)
                same(infos, hints)
                same(ours.reset_infos, theirs.reset_infos)
    same(*([*each.get_images()] for each in both))
    same(*(each.env_method("render", indices=[2]) for each in both))
    for indices in (None, 1, [0, 2]):
        for kind in (Monitor, gymnasium.Wrapper, VecMonitor):
            assert ours.env_is_wrapped(kind, indices) == theirs.env_is_wrapped(kind, indices)
        for attribute in ("observation_space", "action_space", "render_mode"):
            assert ours.get_attr(attribute, indices) == theirs.get_attr(attribute, indices)
        if form != "arm":
            same(*(each.env_method("action_masks", indices=indices) for each in both))
    ours.close()
    assert envs.unwrapped.closed


def test_what_a_batch_cannot_do_is_refused() -> None:
    env = vec_env(2)
    with pytest.raises(ValueError, match="all games share one environment"):
        env.set_attr("label", "mine", indices=[0])
    wrapped = RecordEpisodeStatistics(make_vector_env("chase", "chaser", 2))
    with pytest.raises(ValueError, match=r"envs\.unwrapped"):
        StableBaselinesVecEnv(wrapped)  # type: ignore[arg-type]
    with pytest.warns(UserWarning, match="no images: render_mode is 'ansi'"):
        assert vec_env(2, render_mode="ansi").get_images() == [None, None]


def test_the_rest_of_the_vec_env() -> None:
    env = vec_env(2, render_mode="rgb_array")
    env.reset()
    assert env.get_attr("num_envs") == [2, 2] and env.get_attr("num_envs", 0) == [2]
    env.set_attr("label", "mine")
    assert env.get_attr("label", [1]) == ["mine"]
    assert isinstance(env.render(), np.ndarray)
    env.close()


def test_wrappers_of_stable_baselines() -> None:
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        env = VecMonitor(vec_env(4, maze="3x3", max_steps=5))
    env.reset()
    for _ in range(5):
        *_, dones, infos = env.step(np.zeros(4, dtype=int))
    assert all("episode" in info for info, done in zip(infos, dones, strict=True) if done)


# -- SuperSuit -----------------------------------------------------------------------------------


def play(env: Any, steps: int = 60) -> list[Any]:
    """Steps of a vector environment with random actions, each checked for its shapes."""
    rng = np.random.default_rng(0)
    observed, _ = env.reset(seed=0)
    returned = []
    for _ in range(steps):
        assert observed.shape == (env.num_envs, *env.observation_space.shape)
        assert all(env.observation_space.contains(row) for row in observed)
        observed, rewards, terminations, truncations, infos = env.step(
            rng.integers(4, size=env.num_envs)
        )
        assert len(rewards) == len(terminations) == len(truncations) == env.num_envs
        returned.append((observed, rewards, terminations, truncations, infos))
    return returned


def test_supersuit_vectorises_one_against_one() -> None:
    env = supersuit.pettingzoo_env_to_vec_env_v1(chase_v0.parallel_env(maze="3x3", max_steps=15))
    twin = chase_v0.parallel_env(maze="3x3", max_steps=15)
    twin.reset(seed=0)
    rng = np.random.default_rng(0)
    ends = 0
    for observed, rewards, terminations, truncations, infos in play(env):
        actions = dict(zip(twin.agents, rng.integers(4, size=2), strict=True))
        expected = twin.step(actions)
        assert rewards.tolist() == [np.float32(reward) for reward in expected[1].values()]
        assert terminations.tolist() == [*expected[2].values()]
        assert truncations.tolist() == [*expected[3].values()]
        last = expected[0]
        if not twin.agents:
            ends += 1
            for info, agent in zip(infos, twin.possible_agents, strict=True):
                assert (info["terminal_observation"] == last[agent]).all()
            last, _ = twin.reset()
        assert (observed == np.stack([*last.values()])).all()
    assert ends > 3


def test_supersuit_black_death_keeps_captured_evaders() -> None:
    env = chase_v0.parallel_env(maze=CORRIDOR, num_evaders=2)
    dark = supersuit.black_death_v3(env)
    dark.reset(seed=0, options={"positions": [0, 1, 4]})
    actions = {"chaser_0": EAST, "evader_0": NORTH, "evader_1": NORTH}
    dark.step(actions)
    assert env.agents == ["chaser_0", "evader_1"]
    observations, rewards, *_ = dark.step(actions)
    assert not observations["evader_0"].any() and rewards["evader_0"] == 0
    assert rewards["evader_1"] == 1.0


@pytest.mark.parametrize("observation", ENCODINGS)
def test_supersuit_vectorises_teams_with_black_death(observation: str) -> None:
    env = chase_v0.parallel_env(
        maze="3x3", num_chasers=2, num_evaders=2, max_steps=15, observation=observation
    )
    play(supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(env)), steps=15)


@pytest.mark.parametrize("observation", ["cells", "planes"])
def test_supersuit_stacks_grids(observation: str) -> None:
    env = chase_v0.parallel_env(maze="3x3", max_steps=20, observation=observation)
    stacked = supersuit.frame_stack_v1(env, 2)
    shape = stacked.observation_space("chaser_0").shape
    play(supersuit.pettingzoo_env_to_vec_env_v1(stacked))
    assert np.prod(shape) == 2 * np.prod(env.observation_space("chaser_0").shape)


def test_supersuit_concatenates_copies_that_end_their_episodes() -> None:
    env = supersuit.pettingzoo_env_to_vec_env_v1(chase_v0.parallel_env(maze="3x3", max_steps=15))
    envs = supersuit.concat_vec_envs_v1(env, 3)
    returned = play(envs)
    ends = np.array([terminated | truncated for _, _, terminated, truncated, _ in returned])
    assert ends.shape == (60, 6) and (ends.sum(axis=0) > 3).all()
    starts = returned[0][0].reshape(3, 2, -1)
    assert len(np.unique(starts[:, 0], axis=0)) > 1  # seeded apart


def test_self_play_with_stable_baselines_through_supersuit() -> None:
    # Seats of one shape share a network here: the classic way of self-play with SuperSuit.
    env = supersuit.pettingzoo_env_to_vec_env_v1(race_v0.parallel_env(maze="3x3", max_steps=20))
    envs = supersuit.concat_vec_envs_v1(env, 2, base_class="stable_baselines3")
    with warnings.catch_warnings():  # SuperSuit's VecEnv cannot be seeded
        warnings.simplefilter("ignore", UserWarning)
        model = PPO("MlpPolicy", envs, n_steps=32, batch_size=64, n_epochs=2, device="cpu")
        model.learn(256)
    assert model.num_timesteps == 256
