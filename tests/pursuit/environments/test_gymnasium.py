"""The Gymnasium environments of one agent, single and vectorised."""

from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
import pytest
from diagonals import diagonal
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as vector_wrappers
from numpy.typing import NDArray

from pursuit import (
    GameView,
    ReacherVectorEnv,
    SingleAgentEnv,
    SingleAgentVectorEnv,
    make_task,
)
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from scripted_agents import RandomAgent
from scripted_agents.environments import make_env, make_vector_env

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
NORTH, SOUTH, EAST, WEST, STAY = range(5)
ROLES = [f"{task}{role}" for task in ("", "Heist", "Escape") for role in ("Chaser", "Evader")]
IDS = tuple(f"pursuit/{name}-v0" for name in (*ROLES, "Maze", "Race"))
ARM = "pursuit/Reacher-v0"
SEATS = [
    (task, agent)
    for task, agents in {
        "chase": ("chaser_0", "evader_0", "chaser", "evader"),
        "maze": ("runner_0",),
        "race": ("runner_0", "runner_1"),
        "heist": ("chaser", "evader"),
    }.items()
    for agent in agents
]

pytestmark = pytest.mark.filterwarnings("error::UserWarning", "ignore:mask_bumps=True")


class Eastward:
    """A custom policy that always moves east and stores its observations."""

    def __init__(self, observation: str | None = None) -> None:
        self.observation = observation
        self.seen: list[Any] = []

    def act(self, view: GameView) -> NDArray[np.int32]:
        seen = (view.seat, view.positions.copy(), view.steps.copy())
        self.seen.append(view.observe(self.observation) if self.observation else seen)
        return np.full(view.num_games, EAST, dtype=np.int32)


@pytest.mark.parametrize(("name", "observation"), diagonal(IDS, ENCODINGS))
def test_gymnasiums_own_check(name: str, observation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # Gymnasium's check opens a window for a while: once is enough.
    env = gymnasium.make(name, observation=observation, opponent_epsilon=0.5)
    check_env(env.unwrapped, skip_render_check=name != IDS[0])


@pytest.mark.parametrize(("seat", "observation"), diagonal(SEATS, ENCODINGS))
def test_every_agent_of_every_task(seat: tuple[str, str], observation: str) -> None:
    task, agent = seat
    env = make_env(task, agent, observation=observation, opponent_epsilon=0.3, max_steps=60)
    rng = np.random.default_rng(1)
    env.reset(seed=1)
    for _ in range(5):
        observed, info = env.reset()
        for _ in range(60):
            assert env.observation_space.contains(observed)
            assert "action_mask" not in info and env.action_masks().tolist() == [True] * 4
            observed, reward, terminated, truncated, info = env.step(int(rng.integers(4)))
            assert isinstance(reward, float) and not (terminated and truncated)
            if terminated or truncated:
                break
        assert terminated or (truncated and env.simulator.steps[0] == 60)


def batch_of(name: str, num_envs: int, **settings: Any) -> Any:
    """A vector environment of small games, or of arms that reach their targets often."""
    game = {"tolerance": 0.5} if "Reacher" in name else {"maze": "3x3"}
    envs = gymnasium.make_vec(name, num_envs=num_envs, **{**game, **settings})
    envs.action_space.seed(0)
    return envs


@pytest.mark.parametrize("name", [*IDS, ARM])
def test_make_vec_gives_the_simulator_underneath(name: str) -> None:
    envs = batch_of(name, 5, max_steps=30)
    assert isinstance(envs, ReacherVectorEnv if name == ARM else SingleAgentVectorEnv)
    assert envs.num_envs == 5 and envs.simulator.num_games == 5
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.spec is not None
    assert (envs.spec.id, envs.spec.max_episode_steps) == (name, 30)
    observations, infos = envs.reset(seed=1)
    assert observations in envs.observation_space and not infos
    assert name == ARM or envs.action_masks().tolist() == [[True] * 4] * 5
    for _ in range(100):
        actions = envs.action_space.sample()
        observations, rewards, terminations, truncations, infos = envs.step(actions)
        assert observations in envs.observation_space
        assert rewards.shape == terminations.shape == truncations.shape == (5,)
        assert (rewards.dtype, terminations.dtype, truncations.dtype) == (np.float32, bool, bool)
        assert not (terminations & truncations).any()
    envs.close()


@pytest.mark.parametrize("name", [IDS[0], ARM])
def test_nothing_returned_is_overwritten_later(name: str) -> None:
    envs = batch_of(name, 3, max_steps=5)
    returned = [envs.reset(seed=0)]
    copied = deepcopy(returned)
    for _ in range(40):
        returned.append(envs.step(envs.action_space.sample()))
        copied.append(deepcopy(returned[-1]))
    np.testing.assert_equal(returned, copied)


def test_other_vector_wrappers_of_gymnasium() -> None:
    masked = {"stay_action": True, "mask_bumps": True}
    envs = gymnasium.make_vec(IDS[1], num_envs=3, maze="3x3", max_steps=7, **masked)
    listed = vector_wrappers.DictInfoToList(
        vector_wrappers.NormalizeReward(vector_wrappers.ClipReward(envs, -0.5, 0.5))
    )
    _, infos = listed.reset(seed=0)
    assert [info["action_mask"].shape for info in infos] == [(5,)] * 3
    for _ in range(8):
        _, _, terminations, truncations, infos = listed.step(np.zeros(3, dtype=int))
        for ended, info in zip(terminations | truncations, infos, strict=True):
            assert ended == ("episode_length" in info)


def test_masked_sampling() -> None:
    envs = make_vector_env("maze", "runner", num_envs=4, mask_bumps=True)
    _, infos = envs.reset(seed=0)
    actions = envs.action_space.sample(tuple(infos["action_mask"]))
    assert infos["action_mask"][np.arange(4), actions].all()


def test_the_capture_of_your_evader_ends_your_episode_only() -> None:
    task = make_task("chase", maze=CORRIDOR, num_evaders=2)
    policies = {"chaser": Eastward(), "evader_1": Eastward()}
    start = {"positions": [0, 1, 4]}
    env = SingleAgentEnv(task, "evader_0", policies, "positions")
    env.reset(seed=0, options=start)
    observed, reward, terminated, truncated, _ = env.step(WEST)
    assert (reward, terminated, truncated) == (-1.0, True, False)
    assert observed.tolist() == [0, 5, 2, 0]  # captured, and observes the others
    assert not env.simulator.ended.any()  # the game itself goes on

    envs = SingleAgentVectorEnv(
        task, "evader_0", policies, 2, "positions", autoreset_mode="SAME_STEP"
    )
    envs.reset(seed=0, options={"positions": [[0, 1, 4], [0, 3, 4]]})
    _, rewards, terminations, truncations, infos = envs.step(np.array([WEST, EAST]))
    assert rewards.tolist() == [-1.0, 1.0]
    assert terminations.tolist() == [True, False] and not truncations.any()
    assert infos["final_obs"][0].tolist() == [0, 5, 2, 0]
    assert envs.simulator.steps.tolist() == [0, 1]  # your game restarted


def test_capture_in_the_last_step_is_no_truncation() -> None:
    task = make_task("chase", maze=CORRIDOR, num_evaders=2, max_steps=1)
    policies = {"chaser": Eastward(), "evader_1": Eastward()}
    env = SingleAgentEnv(task, "evader_0", policies)
    env.reset(options={"positions": [0, 1, 4]})
    assert env.step(WEST)[2:4] == (True, False)
    env.reset(options={"positions": [0, 3, 4]})
    assert env.step(EAST)[2:4] == (False, True)
    envs = SingleAgentVectorEnv(task, "evader_0", policies, 2)
    envs.reset(options={"positions": [[0, 1, 4], [0, 3, 4]]})
    _, _, terminations, truncations, _ = envs.step(np.array([WEST, EAST]))
    assert (terminations.tolist(), truncations.tolist()) == ([True, False], [False, True])


def test_a_custom_policy_controls_another_agent() -> None:
    opponent = Eastward()
    env = gymnasium.make(IDS[0], maze=CORRIDOR, opponent=opponent, observation="positions")
    env.reset(options={"positions": [0, 1]})
    observed, *_ = env.step(EAST)
    assert observed.tolist() == [2, 3, 0]
    ((seat, positions, steps),) = opponent.seen
    assert seat == 1 and positions.tolist() == [[0, 1]] and steps.tolist() == [0]


def test_an_opponent_may_use_any_observation() -> None:
    opponent = Eastward("cells")
    envs = make_vector_env("chase", "chaser", num_envs=3, maze=CORRIDOR, opponent=opponent)
    envs.reset(seed=0)
    envs.step(np.zeros(3, dtype=int))
    assert opponent.seen[0].shape == (3, 1, 5)
    assert (opponent.seen[0] == 1).sum() == 3  # the evader sees itself, as code 1


@pytest.mark.parametrize("given", ["random", RandomAgent()])
def test_an_opponent_plays_the_other_runners_of_a_race(given: Any) -> None:
    env: Any = make_env("race", "runner_0", maze="3x3", num_goals=2, opponent=given)
    assert env.unwrapped.policies[0] is None
    assert isinstance(env.unwrapped.policies[1], RandomAgent)


def test_opponent_epsilon_reaches_the_opponent() -> None:
    env = make_env("chase", "chaser", maze="3x3", opponent_epsilon=0.25)
    assert env.policies[0] is None and env.policies[1].epsilon == 0.25  # type: ignore[union-attr]


def test_policies_by_name_take_precedence_over_roles() -> None:
    task = make_task("race", num_runners=3)
    first, others = RandomAgent(), RandomAgent()
    env = SingleAgentEnv(task, "runner_1", {"runner_0": first, "runner": others})
    assert env.policies == [first, None, others]


@pytest.mark.parametrize("kind", [SingleAgentEnv, SingleAgentVectorEnv])
@pytest.mark.parametrize(
    ("agent", "policies", "message"),
    [
        (
            "runner",
            {"chaser": RandomAgent()},
            "unknown agent 'runner'; one of chaser, evader, chaser_0",
        ),
        ("evader_1", {"chaser": RandomAgent()}, "unknown agent 'evader_1'"),
        (2, {"chaser": RandomAgent()}, "agent index 2; this task has 0 to 1"),
        ("chaser", {}, "evader_0 has no policy; add policies={'evader_0': ...}"),
        ("chaser", {"runner": RandomAgent()}, "a policy for 'runner'; give one of chaser_0"),
    ],
)
def test_invalid_agents_and_policies(kind: Any, agent: Any, policies: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(make_task("chase"), agent, policies)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observation": "pixels"}, "unknown observation 'pixels'"),
        ({"opponent_epsilon": 1.5}, "epsilon=1.5"),
    ],
)
def test_wrong_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gymnasium.make(IDS[0], **settings)
    with pytest.raises(ValueError, match=message):
        gymnasium.make_vec(IDS[0], num_envs=2, **settings)


def test_an_unknown_render_mode() -> None:
    settings: dict[str, Any] = {"render_mode": "3d"}
    with (  # Gymnasium warns, too
        pytest.warns(UserWarning, match="render_mode='3d'"),
        pytest.raises(ValueError, match="unknown render_mode '3d'"),
    ):
        gymnasium.make(IDS[0], **settings)
    with pytest.raises(ValueError, match="render_mode '3d'"):
        gymnasium.make_vec(IDS[0], num_envs=2, **settings)


@pytest.mark.parametrize("action", [4, -1, 1.5, None, "north", np.array([1]), 2**70])
def test_an_invalid_action_moves_no_agent(action: Any) -> None:
    env, untouched = (make_env("chase", "chaser", opponent_epsilon=0.5) for _ in range(2))
    for each in (env, untouched):
        each.reset(seed=0)
    with pytest.raises(ValueError, match="integers from 0 to 3"):
        env.step(action)
    for _ in range(10):
        assert (env.step(0)[0] == untouched.step(0)[0]).all()


def test_resets_without_a_seed_go_on_and_differ() -> None:
    envs = make_vector_env("maze", "runner", num_envs=8, seed=5)
    same = make_vector_env("maze", "runner", num_envs=8)
    first = envs.reset()[0]
    assert (first == same.reset(seed=5)[0]).all()
    assert (first != envs.reset()[0]).any()
    assert len(np.unique(first, axis=0)) == 8
    unseeded = [make_vector_env("maze", "runner", num_envs=8).reset()[0] for _ in range(2)]
    assert (unseeded[0] != unseeded[1]).any()


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int32, np.int64])
def test_actions_of_any_integer_type(dtype: Any) -> None:
    seen = []
    for kind in (dtype, np.int64):
        envs, env = make_vector_env("chase", "chaser", 3), make_env("chase", "chaser")
        envs.reset(seed=0)
        env.reset(seed=0)
        seen.append((envs.step(np.array([0, 1, 3], dtype=kind))[0], env.step(kind(3))[0]))
    assert (seen[0][0] == seen[1][0]).all() and (seen[0][1] == seen[1][1]).all()
