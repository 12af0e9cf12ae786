"""Planes and windows, in both dtypes, equal a plain construction in tasks of every kind."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from conformance import check_parallel_env
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import api_test

import pursuit
from pursuit import chase_v0
from pursuit.observations import planes
from pursuit.observations.observations import DTYPES, Encoder
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents.environments import make_env
from tests.random_mazes import connected_maze
from tests.reference_observations import Seen
from train.environments.simulator_env import SimulatorEnv
from train.networks import features, policy
from train.networks.policy import MazeSeat
from train.runs.parts import parts_of, settings_of
from train.runs.single import SingleAgent

VIEWS: list[dict[str, Any]] = [
    {},
    {"view_radius": 2},
    {"line_of_sight": True, "unknown_maze": True},
    {"view_radius": {"chaser_0": 0, "evader": 3}, "unknown_maze": ("chaser",)},
]


LIMITS = ((1, 6), (1, 7), (0, 4), (1, 3))


def random_task(seed: int) -> Task:
    """One or two mazes with holes and loops; teams of up to 12 agents, goals, exits and views."""
    rng = np.random.default_rng(seed)
    chasers, evaders, goals, exits = (rng.integers(least, most) for least, most in LIMITS)
    return Task(
        tuple(connected_maze(seed + 99 * i, *rng.integers(5, 8, 2)) for i in range(1 + seed % 2)),
        num_chasers=int(chasers),
        num_evaders=int(evaders),
        num_goals=int(goals),
        num_exits=int(exits) if seed % 3 == 0 else 0,
        max_steps=12,
        **VIEWS[seed % 4],
    )


@pytest.mark.parametrize("seed", range(8))
def test_planes_and_windows_are_those_of_the_plain_construction(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, rng = random_task(seed), np.random.default_rng(seed)
    simulator = Simulator(task, 2, seed=seed, auto_restart=False)
    names = {"planes": None, "window": None, f"window:{seed % 4}": seed % 4}
    encoders = [Encoder(task, name, dtype) for name in names for dtype in DTYPES]
    with monkeypatch.context() as patched:  # as where they do not fit in memory
        patched.setattr(planes, "MOST_KEPT", 0)
        encoders += [Encoder(task, name) for name in names]
    for _ in range(5):
        found = [encoder.encode(simulator.games) for encoder in encoders]
        for game, seat in np.ndindex(simulator.num_games, task.num_agents):
            seen = Seen(simulator, game, seat)
            plain = {name: seen.window(radius) for name, radius in names.items()}
            plain["planes"] = seen.planes()
            for encoder, observed in zip(encoders, found, strict=True):
                assert observed.dtype == encoder.dtype == encoder.space.dtype
                np.testing.assert_array_equal(observed[game, seat], plain[encoder.encoding])
        for encoder, observed in zip(encoders, found, strict=True):
            some = encoder.encode(simulator.games, slice(0, None, 2))
            np.testing.assert_array_equal(some, observed[:, ::2])
        simulator.reset(games=simulator.ended)
        simulator.step(rng.integers(task.num_actions, size=(2, task.num_agents)))


def test_the_tasks_are_of_every_kind() -> None:
    tasks = [random_task(seed) for seed in range(8)]
    assert {len(task.mazes) for task in tasks} == {1, 2}
    for count in ("num_goals", "most_exits"):
        assert {bool(getattr(task, count)) for task in tasks} == {False, True}
    assert {task.num_agents > planes.FEW for task in tasks} == {False, True}


@pytest.mark.parametrize("encoding", ["planes", "window:2", "one_hot", "planes+id", "window+id"])
def test_both_dtypes_hold_the_same_numbers(encoding: str) -> None:
    task = make_task("heist", maze="5x5", num_evaders=2, view_radius=3)
    simulator = Simulator(task, 8)
    simulator.step(np.zeros((8, 3), dtype=np.int32))
    plain, small = (simulator.observe(encoding, dtype=dtype) for dtype in (None, "uint8"))
    assert (plain.dtype, small.dtype) == (np.float32, np.uint8) and small.max() == 1
    np.testing.assert_array_equal(plain, small)
    final = simulator.observe_final(encoding, "evader_1", [2, 5], "uint8")
    np.testing.assert_array_equal(final, simulator.observe_final(encoding)[[2, 5], 2])


# -- environments ----------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error::UserWarning")
@pytest.mark.parametrize("observation", ["planes", "window:2", "one_hot"])
def test_environments_of_uint8_conform_and_show_the_same(observation: str) -> None:
    settings: Any = {"observation": observation, "maze": "4x4", "num_evaders": 2, "max_steps": 15}
    small = {**settings, "observation_dtype": "uint8"}
    check_parallel_env(chase_v0.parallel_env(**small), max_steps=15)
    api_test(chase_v0.env(**small), num_cycles=40)
    check_env(make_env("chase", "chaser", **small), skip_render_check=True)
    plain, env = chase_v0.parallel_env(**settings), chase_v0.parallel_env(**small)
    seen, same = plain.reset(seed=3)[0], env.reset(seed=3)[0]
    assert env.observation_space("chaser_0").dtype == same["chaser_0"].dtype == np.uint8
    while env.agents:
        for agent in env.agents:
            np.testing.assert_array_equal(seen[agent], same[agent])
        actions = dict.fromkeys(env.agents, len(env.agents) % 4)
        seen, same = plain.step(actions)[0], env.step(actions)[0]
    vectors = [
        gymnasium.make_vec("pursuit/Evader-v0", num_envs=6, **given) for given in (settings, small)
    ]
    first, second = (envs.reset(seed=1)[0] for envs in vectors)
    assert second.dtype == vectors[1].observation_space.dtype == np.uint8  # type: ignore[union-attr]
    assert vectors[1].observation_space.contains(second)
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    ("observation", "dtype"),
    [("index", "uint8"), ("positions", "float32"), ("planes", "float64"), ("cells", "float32"),
     ("pursuit_v5", "uint8"), ("planes", ["uint8"]), ("index+id", "uint8")],
)  # fmt: skip
def test_a_dtype_that_the_observation_cannot_have_is_refused(observation: str, dtype: Any) -> None:
    settings: Any = {"observation": observation, "observation_dtype": dtype, "maze": "5x5"}
    said = "observation_dtype=.* only one_hot, planes, window and window:R can be float32 or uint8"
    with pytest.raises(ValueError, match=said):
        chase_v0.parallel_env(**settings)
    with pytest.raises(ValueError, match=said):
        gymnasium.make_vec("pursuit/Chaser-v0", num_envs=2, **settings)


def test_the_own_dtype_of_an_observation_may_be_named() -> None:
    for observation, dtype in (("cells", "uint8"), ("index", "int32"), ("window:1", "float32")):
        env = chase_v0.parallel_env(observation=observation, observation_dtype=dtype)
        assert env.observation_space("evader_0").dtype == dtype


# -- training --------------------------------------------------------------------------------------


def test_learners_and_policies_observe_planes_in_uint8() -> None:
    task = make_task("chase", maze="5x5")
    for encoding, dtype in (("planes", "uint8"), ("window:2", "uint8"), ("one_hot", "float32")):
        seat = MazeSeat(task, "chaser", encoding)
        simulator = Simulator(task, 4, auto_restart=False)
        env = SimulatorEnv(simulator, seat, [None, pursuit.AStarEvader()])
        assert str(env.reset()["observation"].dtype) == f"torch.{dtype}"
        assert env.observation_spec["observation"].is_in(env.reset()["observation"])
        assert features.observed(simulator.view(0), encoding).dtype == dtype


@pytest.mark.filterwarnings("ignore:frames=1024")
@pytest.mark.parametrize(
    "settings",
    [
        {"observation": "planes", "maze": "5x5"},
        {"observation": "window:1", "frame_stack": 2, "view_radius": 2, "network": "mlp"},
        {"observation": "planes", "algorithm": "dqn", "learning_starts": 256},
    ],
)
def test_training_in_uint8_is_training_in_float32_bit_for_bit(
    settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole: Any = {"maze": "3x3", "role": "chaser", "frames": 1024, "num_games": 16, "seed": 1}
    if settings.get("algorithm") != "dqn":
        whole |= {"rollout_steps": 16, "minibatch_size": 128}
    trained = []
    for dtype in ("uint8", None):
        if dtype is None:
            for module in (policy, features):
                monkeypatch.setattr(module, "dtype_of", lambda encoding: None)
        torch.manual_seed(1)
        trainee: Any = SingleAgent(parts_of(settings_of(**{**whole, **settings})), "greedy")
        for _ in range(3):
            trainee.learner.iterate(0.5)
        played = trainee.env.simulator.positions.copy()
        trained.append((trainee.learner.network.state_dict(), played))
    (first, at_first), (second, then) = trained
    np.testing.assert_array_equal(at_first, then)
    for name, weights in first.items():
        np.testing.assert_array_equal(weights.numpy(), second[name].numpy())
