"""Specs of Gymnasium and PettingZoo: made again, with other settings, from copies and JSON."""

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from diagonals import diagonal
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeAwareObservation

import pursuit  # noqa: F401

COPIES = {
    "itself": lambda spec: spec,
    "copy": copy.deepcopy,
    "pickle": lambda spec: pickle.loads(pickle.dumps(spec)),
    "json": lambda spec: EnvSpec.from_json(spec.to_json()),
}
NAMES = {
    "pursuit/Maze-v0": ({"maze": "9x9", "num_goals": 1}, {"positions": [0], "goals": [80]}),
    "pursuit/Reacher-v0": ({"tolerance": 1e-6}, None),
}
"""Ids with settings and a start from which action 0 reaches nothing."""


def last_step(env: Any, start: Any) -> tuple[int, dict[str, Any]]:
    """The length of an episode of the action 0, and the infos of its last step."""
    env.reset(seed=0, options=start)
    still = env.action_space.sample() * 0
    for step in range(1, 999):
        *_, terminated, truncated, info = env.step(still)
        assert not np.any(terminated)
        if np.all(truncated):
            return step, info
    raise AssertionError("no end")


@pytest.mark.parametrize(
    ("name", "copied", "made"), diagonal(NAMES, COPIES, [{}, {}, *[{"max_steps": 15}] * 2])
)
def test_another_limit_through_a_spec(name: str, copied: str, made: dict[str, int]) -> None:
    settings, start = NAMES[name]
    first = gymnasium.make(name, **settings, **made)
    assert first.spec is not None
    spec = COPIES[copied](first.spec)
    default = {"pursuit/Maze-v0": 200, "pursuit/Reacher-v0": 400}[name]
    for given, length in (({"max_steps": 40}, 40), ({"max_steps": 500}, 500), ({}, None)):
        length = length or made.get("max_steps", default)
        env, envs = gymnasium.make(spec, **given), gymnasium.make_vec(spec, 2, **given)
        again = gymnasium.make_vec(envs.spec, **given)
        for each in (env, envs, again):
            assert each.spec is not None and each.spec.max_episode_steps == length
            steps, info = last_step(each, start)
            assert steps == length and np.all(info["episode_length"] == length)
            assert "episode_return" in info
    # A TimeLimit that was asked for is kept.
    cut = COPIES[copied](gymnasium.make(spec, max_episode_steps=9).spec)
    assert last_step(gymnasium.make_vec(cut, 2, max_steps=7), start)[0] == 7
    assert last_step(gymnasium.make(cut, max_steps=40), start)[0] == 9
    assert last_step(gymnasium.make_vec(cut, 2, max_steps=40), start)[0] == 9
    assert cut.max_episode_steps == 9


@pytest.mark.parametrize("copied", COPIES)
def test_every_setting_can_be_changed_through_a_spec(copied: str) -> None:
    given: dict[str, Any] = {
        "maze": "4x4",
        "opponent": "random",
        "num_evaders": 2,
        "agent": "evader_1",
    }
    given |= {"observation": "cells", "mask_in_observation": True, "stay_action": True}
    given |= {"rewards": "distance", "view_radius": 2, "start": "random", "render_mode": "ansi"}
    first = gymnasium.make("pursuit/Chaser-v0", maze=["3x3", "5x5"], opponent_epsilon=0.5)
    assert first.spec is not None
    spec = COPIES[copied](first.spec)
    env: Any = gymnasium.make(spec, **given, opponent_epsilon=0.0).unwrapped
    wanted: Any = gymnasium.make("pursuit/Chaser-v0", **given).unwrapped
    for attribute in ("task", "seat", "observation", "observation_space", "action_space"):
        assert getattr(env, attribute) == getattr(wanted, attribute), attribute
    assert env.render_mode == "ansi" and repr(env.policies) == repr(wanted.policies)
    assert first.unwrapped.task.num_evaders == 1  # type: ignore[attr-defined]


def test_wrappers_read_the_limit_of_the_task() -> None:
    env = TimeAwareObservation(gymnasium.make("pursuit/Maze-v0", max_steps=17))
    assert env.max_timesteps == 17


@pytest.mark.parametrize("kind", ["parallel", "aec"])
def test_another_limit_through_a_spec_of_pettingzoo(kind: Any) -> None:
    from pettingzoo.env_registry.registration import spec

    found = copy.deepcopy(spec(kind, "pursuit/chase-v0"))
    for name in ("max_steps", "max_cycles"):
        env = pettingzoo.make(kind, found, maze="3x3", **{name: 40})
        assert env.unwrapped.task.max_steps == 40  # type: ignore[union-attr]


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize("name", ["pursuit/Chaser-v0", "pursuit/Race-v0", "pursuit/Reacher-v0"])
def test_render_modes_with_wrappers_of_gymnasium(name: str) -> None:
    for mode, kind in (("rgb_array_list", np.ndarray), ("ansi_list", str)):
        made = gymnasium.make(name, render_mode=mode, max_steps=5)
        assert made.spec is not None
        for env in (made, gymnasium.make(made.spec)):
            env.reset(seed=0)
            env.step(env.action_space.sample())
            frames: Any = env.render()
            assert [type(frame) for frame in frames] == [kind, kind]


def test_gymnasium_records_videos(tmp_path: Any) -> None:
    pytest.importorskip("moviepy")
    for mode in ("rgb_array", "rgb_array_list"):
        made = gymnasium.make("pursuit/Maze-v0", render_mode=mode, max_steps=3)
        env = gymnasium.wrappers.RecordVideo(made, str(tmp_path / mode))
        env.reset(seed=0)
        for _ in range(3):
            env.step(env.action_space.sample())
        env.close()
        assert len([*(tmp_path / mode).iterdir()]) == 1
