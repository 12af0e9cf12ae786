"""The arm in environments of Gymnasium and PettingZoo, with the checks of both libraries."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from conformance import check_parallel_env
from diagonals import diagonal
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import ClipAction, RescaleAction
from pettingzoo import test as pettingzoo_test

from pursuit import ReacherEnv, ReacherTask, ReacherVectorEnv, reacher_v0
from pursuit.reacher.observations import ENCODINGS

ID = "pursuit/Reacher-v0"
FORMS: dict[str, dict[str, Any]] = {
    "two": {},
    "one": {"joints": 1, "observation": "positions_angles"},
    "eight": {"joints": 8, "hold": 2, "max_steps": 50},
    "discrete": {"joints": 3, "discrete_actions": True, "start": "random"},
}

pytestmark = pytest.mark.filterwarnings("error::UserWarning")


@pytest.fixture(params=FORMS)
def form(request: pytest.FixtureRequest) -> dict[str, Any]:
    return FORMS[request.param]


# -- Gymnasium -------------------------------------------------------------------------------------


def test_gymnasiums_own_check(form: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # Gymnasium's check opens a window for a while: once is enough.
    check_env(gymnasium.make(ID, **form).unwrapped, skip_render_check=bool(form))


def test_spaces(form: dict[str, Any]) -> None:
    env = gymnasium.make(ID, **form).unwrapped
    joints = form.get("joints", 2)
    angles = form.get("observation") == "positions_angles"
    assert env.observation_space.shape == (1 + 2 * (joints + 1) + angles * joints,)
    if "discrete_actions" in form:
        assert env.action_space == gymnasium.spaces.MultiDiscrete([3] * joints)
    else:
        assert env.action_space == gymnasium.spaces.Box(-1, 1, (joints,), np.float32)
    assert env.observation_space is not gymnasium.make(ID, **form).unwrapped.observation_space


def test_actions_out_of_range_are_refused_and_wrappers_clip_them() -> None:
    env = gymnasium.make(ID, start="fixed").unwrapped
    env.reset(seed=0, options={"angles": [0.0, 0.0], "target": [0.0, 1.0]})
    for wrong in ([0.0, 2.0], [np.nan, 0.0], [np.inf, 0.0]):
        with pytest.raises(ValueError, match=r"gymnasium.wrappers.ClipAction and RescaleAction"):
            env.step(np.array(wrong, dtype=np.float32))
    for wrong in ([0.0], [[0.0, 0.0]], 0.0, "forth", [True, True], None, {}):
        with pytest.raises(ValueError, match="action"):
            env.step(wrong)
    assert not env.simulator.steps.any() and not env.simulator.angles.any()
    ClipAction(env).step(np.array([3.0, -3.0], dtype=np.float32))
    np.testing.assert_array_equal(env.simulator.angles, [[0.1, -0.1]])
    low, high = np.full(2, -10, dtype=np.float32), np.full(2, 10, dtype=np.float32)
    RescaleAction(env, low, high).step(np.array([5.0, 0.0], dtype=np.float32))
    np.testing.assert_allclose(env.simulator.angles, [[0.15, -0.1]], atol=1e-7)


def test_discrete_actions_turn_back_stay_and_forward() -> None:
    env = gymnasium.make(ID, joints=3, start="fixed", discrete_actions=True).unwrapped
    env.reset(seed=0)
    env.step(np.array([0, 1, 2]))
    np.testing.assert_array_equal(env.simulator.angles, [[-0.1, 0.0, 0.1]])
    for wrong in ([0, 1, 3], [-1, 0, 0], [0.0, 1.0, 2.0], [1, 1], 13):
        with pytest.raises(ValueError, match=r"integers 0 \(back\), 1 \(stay\) and 2 \(forward"):
            env.step(wrong)
    assert env.simulator.steps.tolist() == [1]


def test_options_set_the_start() -> None:
    for make in (lambda: gymnasium.make(ID).unwrapped, lambda: reacher_v0.parallel_env()):
        env: Any = make()
        options: dict[str, Any] = {"angles": [0.5, -0.5], "target": (1.0, 1.5)}
        env.reset(options=options)
        assert env.simulator.angles.tolist() == [[0.5, -0.5]]
        assert env.simulator.targets.tolist() == [[1.0, 1.5]]
        before = env.simulator.get_state()
        for wrong in (
            {"angles": [0.5, 0.5]},
            {"target": [0.0, 0.0]},
            {"angels": [0.0, 0.0]},
            {**options, "target": [3.0, 0.0]},
            {**options, "angles": [np.nan, 0.0]},
            {**options, "angles": [0.0] * 3},
            5,
        ):
            with pytest.raises(ValueError, match=r"options=|out of reach|angles="):
                env.reset(seed=5, options=wrong)
        assert (env.simulator.streams == before.streams).all()
        assert (env.simulator.angles == before.angles).all()
        env.reset(options={})
    envs = ReacherVectorEnv(ReacherTask(), 2)
    envs.reset(options={"angles": [[0.1, 0.2], [0.3, 0.4]], "target": [1.0, 0.0]})
    assert envs.simulator.angles.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert envs.simulator.targets.tolist() == [[1.0, 0.0]] * 2


def test_seeds() -> None:
    with pytest.raises(ValueError, match="num_envs=0"):
        ReacherVectorEnv(ReacherTask(), 0)
    for seed in (-1, 2**64, 1.5, "1", True):
        for env in (ReacherEnv(ReacherTask()), ReacherVectorEnv(ReacherTask()), parallel()):
            with pytest.raises(ValueError, match="seed="):
                env.reset(seed=seed)
    given, named = ReacherVectorEnv(ReacherTask(), 3, seed=4), ReacherVectorEnv(ReacherTask(), 3)
    assert (given.reset()[0] == named.reset(seed=4)[0]).all()
    assert (given.reset()[0] == named.reset()[0]).all()
    unseeded = ReacherEnv(ReacherTask()), ReacherEnv(ReacherTask())
    assert (unseeded[0].reset()[0] != unseeded[1].reset()[0]).any()


# -- PettingZoo ------------------------------------------------------------------------------------


def parallel(**settings: Any) -> Any:
    return reacher_v0.parallel_env(**settings)


def test_conformance(form: dict[str, Any]) -> None:
    check_parallel_env(parallel(**{**form, "max_steps": 60}))


@pytest.mark.parametrize(("form", "observation"), diagonal(FORMS.values(), ENCODINGS))
def test_the_checks_of_pettingzoo(form: dict[str, Any], observation: str) -> None:
    env = reacher_v0.env(**{**form, "observation": observation, "max_steps": 30})
    pettingzoo_test.api_test(env, num_cycles=40)
    assert env.metadata["name"] == "reacher_v0"
    pettingzoo_test.seed_test(lambda: reacher_v0.env(**form), num_cycles=20)
    pettingzoo_test.state_test(reacher_v0.env(**form), parallel(**form), num_cycles=10)


@pytest.mark.parametrize("discrete", [False, True])
def test_joints_observe_the_arm_and_their_own_number(discrete: bool) -> None:
    settings: dict[str, Any] = {"joints": 3, "tolerance": 0.5, "discrete_actions": discrete}
    env, arm = parallel(**settings), gymnasium.make(ID, **settings).unwrapped
    seen, _ = env.reset(seed=3)
    observed, _ = arm.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(500):
        for joint, agent in enumerate(env.possible_agents):
            assert env.observation_space(agent).contains(seen[agent])
            assert (seen[agent][:-3] == observed).all()
            assert seen[agent][-3:].tolist() == [float(other == joint) for other in range(3)]
        assert env.state() in env.state_space
        assert env.state()[:3] == pytest.approx(arm.simulator.angles[0])
        assert env.state()[3:5] == pytest.approx(arm.simulator.targets[0])
        assert env.state()[5:].tolist() == [arm.simulator.held[0], arm.simulator.steps[0]]
        action = rng.integers(3, size=3) if discrete else rng.uniform(-1, 1, 3)
        each = action.tolist() if discrete else action[:, None]
        seen, rewards, *ends, infos = env.step(dict(zip(env.agents, each, strict=True)))
        observed, reward, *flags, _ = arm.step(action)
        assert set(rewards.values()) == {reward}
        assert [set(end.values()) for end in ends] == [{flag} for flag in flags]
        assert infos == {agent: {} for agent in env.possible_agents}
        if any(flags):
            assert env.agents == [] and env.step({}) == ({}, {}, {}, {}, {})
            (seen, _), (observed, _) = env.reset(), arm.reset()
    plain = parallel(own_number=False).reset(seed=0)[0]
    assert (plain["joint_0"] == plain["joint_1"]).all() and plain["joint_0"].shape == (7,)


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"joint_0": [0.0]}, "no action for joint_1"),
        ({"joint_0": [0.0], "joint_1": [0.0], "joint_2": [0.0]}, "'joint_2', which is not active"),
        ({"joint_0": [0.0], "joint_1": [1.5]}, r"the action of joint_1=\[1.5\]; give an array"),
        ({"joint_0": [np.nan], "joint_1": [0.0]}, "the action of joint_0="),
        ({"joint_0": 0.5, "joint_1": [0.0]}, "the action of joint_0=0.5"),
        ({"joint_0": [0.0, 0.0], "joint_1": [0.0]}, "the action of joint_0="),
        ({"joint_0": None, "joint_1": [0.0]}, "the action of joint_0=None"),
        ([0.0, 0.0], "give a dict of an action for every agent"),
    ],
)
def test_nothing_moves_when_an_action_is_refused(actions: Any, message: str) -> None:
    env = parallel()
    env.reset(seed=1)
    before = env.state()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert (env.state() == before).all()


def test_wrong_discrete_actions_of_an_agent() -> None:
    env = parallel(discrete_actions=True)
    env.reset(seed=1)
    for wrong in (3, -1, 1.0, [1], True, "1"):
        with pytest.raises(
            ValueError, match=r"the action of joint_0=.*; give 0 \(back\), 1 \(stay\)"
        ):
            env.step({"joint_0": wrong, "joint_1": 1})
    assert env.state()[-1] == 0


def test_the_turn_based_environment_clips_actions(caplog: Any) -> None:
    env = reacher_v0.env(start="fixed")
    env.reset(seed=0, options={"angles": [0.0, 0.0], "target": [0.0, 1.0]})
    env.step(np.array([4.0], dtype=np.float32))
    assert "clipping to space" in caplog.text  # PettingZoo warns of it
    env.step(np.array([0.0], dtype=np.float32))
    np.testing.assert_array_equal(env.unwrapped.simulator.angles, [[0.1, 0.0]])
    with pytest.raises(AssertionError):
        discrete = reacher_v0.env(discrete_actions=True)
        discrete.reset(seed=0)
        discrete.step(7)
