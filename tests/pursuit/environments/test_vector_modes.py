"""Vector environments restart games like Gymnasium's vector environments."""

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from diagonals import diagonal
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as vector_wrappers
from numpy.typing import NDArray

from pursuit import (
    GameView,
    ReacherEnv,
    ReacherTask,
    ReacherVectorEnv,
    SingleAgentEnv,
    SingleAgentVectorEnv,
)
from pursuit.mazes.maze import Maze
from scripted_agents.environments import make_env, make_vector_env

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
NORTH, EAST, STAY = 0, 2, 4
GAMES = 4
GRIDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "chase": ("chase", "chaser", {}),
    "caught in a team": (
        "chase",
        "evader_1",
        {"num_chasers": 2, "num_evaders": 3, "observation": "index"},
    ),
    "heist": ("heist", "evader", {"maze": ["3x3", "4x4"], "observation": "cells"}),
    "maze": ("maze", "runner", {"stay_action": True, "observation": "planes"}),
    "race": ("race", "runner_1", {"stay_action": True}),
    "runner in a chase": ("chase", "runner", {"num_runners": 1, "num_goals": 1}),
    "masks observed": ("maze", "runner", {"mask_in_observation": True}),
    "masks of ones observed": (
        "maze",
        "runner",
        {"mask_in_observation": True, "mask_bumps": False},
    ),
}
ARMS: dict[str, dict[str, Any]] = {
    "kept": {"tolerance": 0.7},
    "random": {"tolerance": 0.7, "start": "random", "joints": 3},
    "hold": {"tolerance": 0.9, "joints": 1, "hold": 2, "observation": "positions_angles"},
    "discrete": {"tolerance": 0.7, "discrete_actions": True},
}


class Still:
    """A policy that always stays."""

    def act(self, view: GameView) -> NDArray[np.int32]:
        return np.full(view.num_games, STAY, dtype=np.int32)


pytestmark = pytest.mark.filterwarnings("error::UserWarning", "ignore:mask_bumps=True")


def pair(form: str, mode: AutoresetMode) -> tuple[Any, Any]:
    """Our vector environment, and Gymnasium's of as many single ones."""

    def sync(make: Callable[[], Any]) -> SyncVectorEnv:
        return SyncVectorEnv([make] * GAMES, autoreset_mode=mode)

    if form in ARMS:
        task = {"max_steps": 25, **ARMS[form]}
        envs = gymnasium.make_vec("pursuit/Reacher-v0", GAMES, autoreset_mode=mode, **task)
        return envs, sync(lambda: gymnasium.make("pursuit/Reacher-v0", **task))
    name, agent, settings = GRIDS[form]
    game = {"maze": "4x4", "max_steps": 25, "opponent_epsilon": 0.3, "mask_bumps": True, **settings}
    envs = make_vector_env(name, agent, GAMES, autoreset_mode=mode, **game)
    return envs, sync(lambda: make_env(name, agent, **game))


def check_equal(one: Any, other: Any) -> None:
    """Observations or infos: the same keys, dtypes, shapes and values."""
    if isinstance(other, dict):
        assert one.keys() == other.keys()
        for key in other:
            check_equal(one[key], other[key])
    elif isinstance(other, np.ndarray) and other.dtype.hasobject:
        assert one.dtype == object and len(one) == len(other)
        for mine, wanted in zip(one, other, strict=True):
            check_equal(mine, wanted)
    elif other is None:
        assert one is None
    else:
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("form", "mode"), diagonal(GRIDS, AutoresetMode) + diagonal(ARMS, AutoresetMode)
)
def test_results_equal_gymnasiums_vector_environment(form: str, mode: AutoresetMode) -> None:
    ours, theirs = pair(form, mode)
    assert ours.metadata["autoreset_mode"] is ours.autoreset_mode is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    seeds = [5, 2**63, 7, 5]
    (observed, infos), (expected, hints) = ours.reset(seed=seeds), theirs.reset(seed=seeds)
    ours.action_space.seed(1)
    ends, totals, lengths = 0, np.zeros(GAMES), np.zeros(GAMES, dtype=int)
    waiting = np.zeros(GAMES, dtype=bool)
    for _ in range(120):
        check_equal(observed, expected)
        check_equal(infos, hints)
        actions = ours.action_space.sample()
        observed, rewards, terminations, truncations, infos = ours.step(actions)
        expected, *results, hints = theirs.step(actions)
        for one, other in zip((rewards, terminations, truncations), results, strict=True):
            np.testing.assert_array_equal(one, other)
        over = terminations | truncations
        totals, lengths = totals + rewards, lengths + ~waiting
        if over.any():
            ends += over.sum()
            final = infos["final_info"] if mode is AutoresetMode.SAME_STEP else infos
            np.testing.assert_array_equal(final["_episode_return"], over)
            np.testing.assert_allclose(final["episode_return"], totals * over, atol=1e-5)
            np.testing.assert_array_equal(final["episode_length"], lengths * over)
            totals[over], lengths[over] = 0, 0
        assert ("final_obs" in infos) == (mode is AutoresetMode.SAME_STEP and over.any())
        waiting = over if mode is AutoresetMode.NEXT_STEP else np.zeros(GAMES, dtype=bool)
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(ValueError, match="reset_mask"):
                ours.step(actions)
            observed, infos = ours.reset(options={"reset_mask": over})
            expected, hints = theirs.reset(options={"reset_mask": over})
    assert ends > 10


@pytest.mark.parametrize("form", [*GRIDS, *ARMS])
def test_one_seed_of_gymnasiums_class_is_a_list_of_seeds_here(form: str) -> None:
    ours, theirs = pair(form, AutoresetMode.NEXT_STEP)
    seeds = [3 + game for game in range(GAMES)]
    for one, other in zip(ours.reset(seed=seeds), theirs.reset(seed=3), strict=True):
        check_equal(one, other)


@pytest.mark.parametrize("name", ["Maze", "Chaser", "Reacher"])
def test_more_games_than_fit_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"1000000000000 needs [0-9,]+ bytes .* take fewer games"):
        gymnasium.make_vec(f"pursuit/{name}-v0", num_envs=10**12)


@pytest.mark.parametrize("form", ["chase", "kept"])
def test_a_reset_mask_does_not_change_other_games(form: str) -> None:
    ours, theirs = pair(form, AutoresetMode.DISABLED)
    ours.action_space.seed(1)
    for envs in (ours, theirs):
        envs.reset(seed=[1, 2, 3, 4])
    mask = np.array([True, False, False, True])
    for seeds in (None, [9, 9, 9, 9], [None, 8, 8, 6]):
        actions = ours.action_space.sample()
        for envs in (ours, theirs):
            *_, terminations, truncations, _ = envs.step(actions)
        assert not (terminations | truncations).any()
        observed, infos = ours.reset(seed=seeds, options={"reset_mask": mask})
        expected, hints = theirs.reset(seed=seeds, options={"reset_mask": mask})
        check_equal(observed, expected)
        check_equal(infos, hints)
        assert (ours.simulator.steps > 0).tolist() == (~mask).tolist()
    ours.reset(seed=3, options={"reset_mask": mask})
    assert ours.simulator.last_seed is None or (ours.simulator.steps[1:3] > 0).all()


def test_a_mask_can_be_combined_with_positions() -> None:
    envs = make_vector_env("chase", "chaser", 3, maze=CORRIDOR, autoreset_mode="DISABLED")
    envs.reset(seed=0, options={"positions": [0, 4]})
    mask = np.array([False, True, False])
    envs.reset(options={"positions": [1, 3], "reset_mask": mask})
    assert envs.simulator.positions.tolist() == [[0, 4], [1, 3], [0, 4]]


@pytest.mark.parametrize("form", ["chase", "kept"])
def test_one_seed_seeds_each_game_with_its_index(form: str) -> None:
    envs, _ = pair(form, AutoresetMode.NEXT_STEP)
    envs.reset(seed=9)
    alone = type(envs.simulator)(envs.task, 1, seed=9, first_game=3)
    np.testing.assert_array_equal(envs.simulator.streams[3], alone.streams[0])


def test_one_seed_is_that_of_the_whole_batch_in_every_mode() -> None:
    first = [
        make_vector_env("maze", "runner", 8, autoreset_mode=mode).reset(seed=5)[0]
        for mode in AutoresetMode
    ]
    assert (first[0] == first[1]).all() and (first[0] == first[2]).all()
    assert len(np.unique(first[0], axis=0)) == 8


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"seed": [1]}, "1 seeds for 2 games"),
        ({"seed": [1, -1]}, "seed=-1"),
        ({"seed": [1, 1.5]}, "seed=1.5"),
        ({"seed": "ab"}, "seed='ab'"),
        ({"seed": 1.5}, "seed=1.5"),
        ({"options": {"reset_mask": [True]}}, "an array of 2 bools"),
        ({"options": {"reset_mask": np.array([1, 0])}}, "an array of 2 bools"),
        ({"seed": [1, 2], "options": {"positions": [0, 99]}}, "99"),
        ({"seed": [1, 2], "options": 5}, "options=5"),
    ],
)
def test_what_is_refused_changes_nothing(wrong: dict[str, Any], message: str) -> None:
    envs, untouched = (make_vector_env("chase", "chaser", 2, opponent_epsilon=0.5) for _ in "ab")
    for each in (envs, untouched):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        envs.reset(**wrong)
    for _ in range(10):
        np.testing.assert_array_equal(
            *(each.step(np.zeros(2, dtype=int))[0] for each in (envs, untouched))
        )
    np.testing.assert_array_equal(envs.reset()[0], untouched.reset()[0])


def test_an_invalid_action_moves_no_agent_while_games_wait() -> None:
    envs, untouched = (
        make_vector_env(
            "chase", "chaser", 2, maze=CORRIDOR, autoreset_mode="NextStep", opponent_epsilon=0.5
        )
        for _ in "ab"
    )
    for each in (envs, untouched):
        each.reset(seed=0, options={"positions": [[3, 4], [0, 4]]})
        assert each.step(np.array([EAST, NORTH]))[2].tolist() == [True, False]
    arrays = [np.array(wrong) for wrong in ([0, 9], [0, 4], [0, -1], [0.0, 1.0], [0], [[0, 0]])]
    for wrong in (*arrays, 0, ["a", "b"]):
        with pytest.raises(ValueError, match="integers"):
            envs.step(wrong)
    for _ in range(10):
        actions = np.zeros(2, dtype=int)
        np.testing.assert_equal(envs.step(actions), untouched.step(actions))


@pytest.mark.parametrize(
    ("form", "ignored"),
    [("chase", 9), ("chase", -1), ("discrete", 7), ("kept", 5.0), ("kept", np.nan)],
)
def test_a_game_that_restarts_ignores_any_action(form: str, ignored: float) -> None:
    ours, theirs = pair(form, AutoresetMode.NEXT_STEP)
    for envs in (ours, theirs):
        envs.reset(seed=[1, 2, 3, 4])
    ours.action_space.seed(0)
    restarts, waiting = 0, np.zeros(GAMES, dtype=bool)
    for _ in range(80):
        actions = ours.action_space.sample()
        actions[waiting] = ignored
        given = actions.copy()
        (observed, *results, _), (expected, *others, _) = (
            envs.step(actions) for envs in (ours, theirs)
        )
        check_equal(observed, expected)
        np.testing.assert_allclose(results, others)
        np.testing.assert_array_equal(actions, given)
        restarts += waiting.sum()
        waiting = results[1] | results[2]
    assert restarts > 5


def test_unknown_modes_and_early_masks() -> None:
    with pytest.raises(ValueError, match="autoreset_mode='never'; one of NEXT_STEP, SAME_STEP, DI"):
        gymnasium.make_vec("pursuit/Chaser-v0", 2, autoreset_mode="never")
    envs = ReacherVectorEnv(ReacherTask(), 2, autoreset_mode="DISABLED")
    with pytest.raises(ValueError, match="reset_mask before the first reset"):
        envs.reset(options={"reset_mask": np.array([True, False])})


@pytest.mark.parametrize("name", ["pursuit/Chaser-v0", "pursuit/Reacher-v0"])
def test_max_episode_steps_is_a_number_or_minus_one_or_none(name: str) -> None:
    for limit in (np.int64(3), -1, None):
        gymnasium.make_vec(name, 2, max_episode_steps=limit)
    for wrong in (0, -2, 1.5, "3", True):
        with pytest.raises(ValueError, match="max_episode_steps"):
            gymnasium.make_vec(name, 2, max_episode_steps=wrong)


@pytest.mark.parametrize("limit", [1, 2, 3, 4])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_an_end_in_the_step_of_a_limit_is_the_same_in_one_game_and_in_many(
    mode: AutoresetMode, limit: int
) -> None:
    """A capture after 2 steps: the task's own limit of 3 gives way to it, a TimeLimit does not."""
    settings: dict[str, Any] = {"maze": CORRIDOR, "max_steps": 3, "max_episode_steps": limit}
    settings |= {"opponent": Still(), "stay_action": True}
    env, start = gymnasium.make("pursuit/Chaser-v0", **settings), {"positions": [0, 2]}
    envs = gymnasium.make_vec("pursuit/Chaser-v0", 2, autoreset_mode=mode, **settings)
    assert envs.unwrapped.task == env.unwrapped.task  # type: ignore[attr-defined]
    for each in (env, envs):
        each.reset(seed=0, options=start)
    for step in range(1, 3):
        observed, reward, *ends, _ = env.step(EAST)
        seen, rewards, *flags, infos = envs.step(np.array([EAST, EAST]))
        assert [*zip(*flags, strict=True)] == [tuple(ends)] * 2
        assert ends == [step == 2, step == limit]
        assert rewards.tolist() == [np.float32(reward)] * 2
        if any(ends):
            same_step = mode is AutoresetMode.SAME_STEP
            final = infos["final_info"] if same_step else infos
            assert final["episode_length"].tolist() == [step, step]
            last = infos["final_obs"][1] if same_step else seen[1]
            np.testing.assert_array_equal(last, observed)
            return


def test_gymnasiums_class_is_a_direct_base_for_skrl() -> None:
    for kind in (SingleAgentVectorEnv, ReacherVectorEnv):
        assert gymnasium.vector.VectorEnv in kind.__bases__
    for single in (SingleAgentEnv, ReacherEnv):
        assert gymnasium.Env in single.__bases__


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        ("pursuit/Evader-v0", AutoresetMode.DISABLED),
        ("pursuit/Reacher-v0", AutoresetMode.NEXT_STEP),
    ],
)
def test_vector_wrappers_of_gymnasium_take_it(name: str, mode: AutoresetMode) -> None:
    envs = gymnasium.make_vec(name, 3, max_steps=7, autoreset_mode=mode)
    wrapped: Any = vector_wrappers.FlattenObservation(envs)
    if "Reacher" in name:
        wrapped = vector_wrappers.RescaleObservation(wrapped, np.float32(0), np.float32(1))
    else:
        wrapped = vector_wrappers.DtypeObservation(wrapped, np.int64)
    wrapped = vector_wrappers.TransformAction(wrapped, lambda actions: actions)
    if mode is AutoresetMode.NEXT_STEP:
        wrapped = vector_wrappers.NormalizeObservation(wrapped)
    wrapped = vector_wrappers.RecordEpisodeStatistics(wrapped)
    observed, _ = wrapped.reset(seed=0)
    wrapped.action_space.seed(0)
    for _ in range(30):
        assert observed.shape == wrapped.observation_space.shape
        normalised = mode is AutoresetMode.NEXT_STEP
        assert normalised or wrapped.observation_space.contains(observed)
        observed, _, terminations, truncations, infos = wrapped.step(wrapped.action_space.sample())
        over = terminations | truncations
        assert over.any() == ("episode" in infos)
        if "episode" in infos:
            np.testing.assert_allclose(infos["episode"]["r"], infos["episode_return"], atol=1e-5)
            np.testing.assert_array_equal(infos["episode"]["l"], infos["episode_length"])
        if mode is AutoresetMode.DISABLED and over.any():
            observed, _ = wrapped.reset(options={"reset_mask": over})
