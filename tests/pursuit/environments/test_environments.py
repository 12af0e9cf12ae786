"""The PettingZoo environments: PettingZoo's own tests, the registry, rendering, errors, copies."""

import pickle
from collections.abc import Callable
from contextlib import nullcontext
from copy import deepcopy
from functools import partial
from types import SimpleNamespace
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
from diagonals import diagonal
from pettingzoo import ParallelEnv
from pettingzoo import test as pettingzoo_test
from small_games import GAMES as GAMES_OF_TABLES

from pursuit import (
    ReacherEnv,
    ReacherTask,
    ReacherVectorEnv,
    chase_v0,
    heist_v0,
    maze_v0,
    race_v0,
    reacher_v0,
)
from pursuit.environments.parallel import PursuitParallelEnv, environment_makers, scene_of
from pursuit.mazes.maze import Maze
from pursuit.observations.observations import ENCODINGS
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents.environments import make_env, make_vector_env
from scripted_agents.games import SmallGameEnv, SmallGameParallelEnv, SmallGameVectorEnv
from scripted_agents.games.agents import uniform_table

CORRIDOR = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")
ENCLOSED = Maze.from_text("+-+-+-+\n| |   |\n+-+-+-+")
NORTH, SOUTH, EAST, WEST, STAY = range(5)
MODULES = {"chase": chase_v0, "maze": maze_v0, "race": race_v0, "heist": heist_v0}
GAMES: dict[str, tuple[Any, dict[str, Any]]] = {
    "chase": (chase_v0, {}),
    "two hunt three": (chase_v0, {"num_chasers": 2, "num_evaders": 3, "maze": "4x4"}),
    "heist": (heist_v0, {"num_evaders": 2}),
    "maze": (maze_v0, {}),
    "race": (race_v0, {"stay_action": True}),
}

# PettingZoo's tests warn of what they suspect; of ours, they may suspect nothing.
pytestmark = pytest.mark.filterwarnings("error::UserWarning")


@pytest.mark.parametrize(("game", "observation"), diagonal(GAMES, ENCODINGS))
def test_turn_based_api(game: str, observation: str) -> None:
    module, settings = GAMES[game]
    env = module.env(observation=observation, max_steps=30, **settings)
    pettingzoo_test.api_test(env, num_cycles=60)
    assert env.metadata["name"] == f"{env.unwrapped.task.name}_v0"


@pytest.mark.parametrize("game", GAMES)
def test_seeds_and_state(game: str) -> None:
    module, settings = GAMES[game]
    pettingzoo_test.seed_test(lambda: module.env(**settings), num_cycles=50)
    env, parallel_env = module.env(**settings), module.parallel_env(**settings)
    pettingzoo_test.state_test(env, parallel_env, num_cycles=20)


@pytest.mark.parametrize("stay", [False, True])
def test_an_episode_is_truncated_after_max_steps(stay: bool) -> None:
    # An evader and a chaser in parts of the maze that are not joined never meet.
    def settings(max_cycles: int) -> dict[str, Any]:
        return {"maze": ENCLOSED, "max_steps": max_cycles, "stay_action": stay}

    def apart(env: PursuitParallelEnv) -> PursuitParallelEnv:
        original = env.reset
        env.reset = lambda seed=None, options=None: original(  # type: ignore[method-assign]
            seed, {"positions": [0, 1]}
        )
        return env

    module = SimpleNamespace(
        parallel_env=lambda max_cycles: apart(chase_v0.parallel_env(**settings(max_cycles))),
        env=lambda max_cycles: _with_game(chase_v0.env(**settings(max_cycles)), apart),
    )
    pettingzoo_test.max_cycles_test(module)


def _with_game(env: Any, change: Callable[[PursuitParallelEnv], object]) -> Any:
    change(env.unwrapped)
    return env


def test_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")

    def fast(**more: Any) -> Any:
        env = heist_v0.env(max_steps=10, num_evaders=2, **more)
        env.unwrapped.metadata["render_fps"] = 0
        return env

    pettingzoo_test.render_test(fast)


def test_what_render_returns() -> None:
    text = chase_v0.parallel_env(maze=CORRIDOR, render_mode="ansi")
    picture = chase_v0.parallel_env(maze=CORRIDOR, render_mode="rgb_array")
    for env in (text, picture):
        env.reset(options={"positions": [0, 3]})
        env.step({"chaser_0": EAST, "evader_0": WEST})
    assert text.render() == "+-+-+-+-+\n|  C E  |\n+-+-+-+-+\nstep 1 / 200\n"
    pixels = picture.render()
    assert isinstance(pixels, np.ndarray) and pixels.dtype == np.uint8 and pixels.shape[2] == 3
    assert (pixels == scene_of(picture.simulator).draw()).all()


def test_a_window_follows_the_game_and_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = chase_v0.parallel_env(maze=CORRIDOR, render_mode="human")
    env.metadata["render_fps"] = 0
    env.reset(options={"positions": [0, 3]})
    first = pygame.surfarray.array3d(pygame.display.get_surface())
    env.step({"chaser_0": EAST, "evader_0": WEST})
    assert (pygame.surfarray.array3d(pygame.display.get_surface()) != first).any()
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None
    env.close()
    env.reset()  # opens a new window
    assert pygame.display.get_surface() is not None
    env.close()


def test_module_functions_are_documented_by_task() -> None:
    for name, module in MODULES.items():
        assert module.__all__ == ["env", "parallel_env", "raw_env"]
        assert module.parallel_env().metadata["name"] == f"{name}_v0"
        assert module.raw_env().metadata["is_parallelizable"]


def test_the_environment_is_one_game_of_the_simulator() -> None:
    task = make_task("chase", maze="4x4", num_chasers=2, num_evaders=2, max_steps=30)
    env = PursuitParallelEnv(task, "positions")
    simulator = Simulator(task, auto_restart=False)
    rng = np.random.default_rng(0)
    for seed in range(5):
        observations, _ = env.reset(seed=seed)
        simulator.reset(seed=seed)
        while env.agents:
            actions = rng.integers(4, size=4)
            before = list(env.agents)
            named = dict(zip(env.possible_agents, actions.tolist(), strict=True))
            observations, rewards, terminations, truncations, _ = env.step(
                {agent: named[agent] for agent in before}
            )
            simulator.step(actions[None])
            for agent in before:
                seat = task.seat(agent)
                assert (observations[agent] == simulator.observe("positions", seat)[0]).all()
                assert rewards[agent] == simulator.rewards[0, seat]
                captured = not simulator.active[0, seat]
                assert terminations[agent] == simulator.terminated[0] or captured
                assert truncations[agent] == (simulator.truncated[0] and not captured)
            assert (env.state()[-1:] == simulator.steps).all()
        assert simulator.ended.any()


def test_a_captured_evader_leaves_and_the_game_goes_on() -> None:
    env = chase_v0.parallel_env(maze=CORRIDOR, num_evaders=2)
    env.reset(options={"positions": [0, 1, 3]})
    observations, rewards, terminations, truncations, _ = env.step(
        {"chaser_0": EAST, "evader_0": NORTH, "evader_1": EAST}
    )
    assert terminations == {"chaser_0": False, "evader_0": True, "evader_1": False}
    assert not any(truncations.values())
    assert (rewards["chaser_0"], rewards["evader_0"], rewards["evader_1"]) == (1.0, -1.0, 1.0)
    assert env.agents == ["chaser_0", "evader_1"] and set(observations) == set(terminations)
    before = env.state()
    with pytest.raises(ValueError, match="'ghost', which is not active"):
        env.step({"chaser_0": EAST, "ghost": NORTH, "evader_1": EAST})
    with pytest.raises(ValueError, match="the action of chaser_0 is None"):
        env.step({"evader_0": None, "chaser_0": None, "evader_1": EAST})
    assert (env.state() == before).all()
    # Many libraries give every possible agent an action, even inactive ones: these are ignored.
    *_, terminations, _, _ = env.step({"chaser_0": EAST, "evader_0": 77, "evader_1": WEST})
    assert terminations == {"chaser_0": True, "evader_1": True} and env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_capture_in_the_last_step_is_a_termination() -> None:
    env = chase_v0.parallel_env(maze=CORRIDOR, num_evaders=2, max_steps=1)
    env.reset(options={"positions": [0, 1, 3]})
    *_, terminations, truncations, _ = env.step(
        {"chaser_0": EAST, "evader_0": NORTH, "evader_1": EAST}
    )
    assert terminations == {"chaser_0": False, "evader_0": True, "evader_1": False}
    assert truncations == {"chaser_0": True, "evader_0": False, "evader_1": True}
    assert env.agents == []


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"chaser_0": 0}, "no action for evader_0"),
        ({}, "no action for chaser_0"),
        ({"chaser_0": 0, "evader_0": 4}, "evader_0 .* out of range"),
        ({"chaser_0": -1, "evader_0": 0}, "chaser_0 .* out of range"),
        ({"chaser_0": 2**40, "evader_0": 0}, "integer from 0 to 3"),
        ({"chaser_0": 0, "evader_0": 1.0}, "the action of evader_0 is 1.0; give an integer"),
        ({"chaser_0": None, "evader_0": 1}, "the action of chaser_0 is None"),
        ({"chaser_0": 0, "evader_0": 0, "ghost_0": 0}, "'ghost_0', which is not active"),
    ],
)
def test_invalid_actions_move_no_agent(actions: dict[str, Any], message: str) -> None:
    env = chase_v0.parallel_env()
    env.reset(seed=0)
    before = env.state()
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    assert (env.state() == before).all()
    assert env.agents == ["chaser_0", "evader_0"]


def test_numpy_integers_are_actions() -> None:
    env = chase_v0.parallel_env(maze=CORRIDOR)
    env.reset(options={"positions": [0, 3]})
    env.step({"chaser_0": np.int64(EAST), "evader_0": np.array(WEST)})
    assert env.state().tolist() == [2, 3, 1]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"observation": "pixels"}, "unknown observation 'pixels'; one of one_hot"),
        ({"render_mode": "3d"}, "unknown render_mode '3d'; None or one of ansi"),
    ],
)
def test_bad_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        chase_v0.parallel_env(**settings)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"positions": [0, 99]}, r"positions=\[0, 99\]; whole numbers from 0 to 24"),
        ({"positions": [0, 1], "goals": [3]}, "this task has no goals"),
        (5, "options=5; give a dict"),
        ({"positions": [3, 3]}, "start in the same cell"),
        ({"postions": [0, 1]}, "unknown option 'postions' .did you mean 'positions'"),
        ({"goals": [3]}, "give positions too"),
    ],
)
def test_bad_options_change_nothing(options: Any, message: str) -> None:
    env = chase_v0.parallel_env()
    env.reset(seed=3)
    before = env.state().tolist()
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)
    assert env.state().tolist() == before


def test_options_name_the_maze_where_there_are_several() -> None:
    env = chase_v0.parallel_env(maze=("3x3", "5x5"))
    for seed in range(4):
        env.reset(seed=seed, options={"positions": [0, 24], "maze": 1})
        assert env.state().tolist() == [1, 25, 0]
    with pytest.raises(ValueError, match="maze is missing; this task has 2"):
        env.reset(options={"positions": [0, 8]})


def test_unknown_task() -> None:
    with pytest.raises(ValueError, match="unknown task 'tag'; one of chase, maze, race, heist"):
        environment_makers("tag")[0]()


DOORS = GAMES_OF_TABLES["chance"]()
OPPONENTS = {"thief": uniform_table(DOORS, "thief")}
WORLDS: dict[str, Callable[..., Any]] = {
    "maze": partial(make_env, "chase", "chaser", max_steps=9),
    "mazes": partial(make_vector_env, "chase", "chaser", 3, max_steps=9),
    "team": partial(chase_v0.parallel_env, maze="4x4", num_evaders=2, max_steps=30),
    "arm": partial(ReacherEnv, ReacherTask(max_steps=12)),
    "arms": partial(ReacherVectorEnv, ReacherTask(max_steps=12), 3),
    "joints": partial(reacher_v0.parallel_env, max_steps=12),
    "games": partial(SmallGameVectorEnv, DOORS, "guard", OPPONENTS, 4, max_steps=5),
    "game": partial(SmallGameEnv, DOORS, "guard", OPPONENTS, encode=lambda state: [state[2]]),
    "players": partial(SmallGameParallelEnv, DOORS, max_steps=5),
}
"""Environments of every form: of one agent, of many games, of all agents."""
COPIES = {
    "deepcopy": deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: pickle.loads(cloudpickle.dumps(env)),
}


def sample(env: Any) -> Any:
    """An action of the agent, or of all agents."""
    if isinstance(env, ParallelEnv):
        return {agent: env.action_space(agent).sample() for agent in env.possible_agents}
    return env.action_space.sample()


@pytest.mark.parametrize(
    ("world", "copied"), [*diagonal(WORLDS, ["deepcopy", "pickle"]), ("team", "cloudpickle")]
)
def test_a_copy_continues_like_the_original(world: str, copied: str) -> None:
    env = WORLDS[world]()
    env.reset(seed=7)
    env.step(sample(env))
    twin = COPIES[copied](env)
    assert env.simulator is not twin.simulator
    for number in range(40):
        if env.simulator.ended.any() and not isinstance(env, gymnasium.vector.VectorEnv):
            seed = 3 if number % 2 else None
            np.testing.assert_equal(env.reset(seed=seed), twin.reset(seed=seed))
        action = sample(env)
        np.testing.assert_equal(env.step(action), twin.step(action))
        np.testing.assert_array_equal(env.simulator.streams, twin.simulator.streams)


@pytest.mark.parametrize("world", WORLDS)
def test_steps_before_a_reset_are_refused(world: str) -> None:
    env = WORLDS[world]()
    with pytest.raises(ValueError, match="step before reset; call reset"):
        env.step(sample(env))


@pytest.mark.parametrize("world", WORLDS)
def test_environments_render_in_their_modes(world: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    kinds = {"ansi": str, "rgb_array": np.ndarray, "human": type(None)}
    silent = WORLDS[world]()
    several = isinstance(silent, gymnasium.vector.VectorEnv)
    assert {*silent.metadata["render_modes"]} == {*kinds} - ({"human"} if several else {*()})
    silent.reset(seed=0)
    with nullcontext() if several else pytest.warns(UserWarning, match="without a render_mode"):
        assert silent.render() is None
    for mode in silent.metadata["render_modes"]:
        env = WORLDS[world](render_mode=mode)
        env.metadata["render_fps"] = 0
        env.reset(seed=0)
        env.step(sample(env))
        shown = env.render()
        assert not several or len(shown) == env.num_envs
        if several and mode == "ansi" and world != "games":  # few states, of which games share some
            assert len({*shown}) == env.num_envs
        assert all(isinstance(one, kinds[mode]) for one in (shown if several else [shown]))
        env.close()
        env.close()
    for wrong in ("3d", "human") if several else ("3d",):
        with pytest.raises(ValueError, match=f"render_mode '{wrong}'"):
            WORLDS[world](render_mode=wrong)


def test_a_copy_is_independent() -> None:
    env = chase_v0.parallel_env(maze=CORRIDOR)
    env.reset(options={"positions": [0, 3]})
    twin = deepcopy(env)
    env.step({"chaser_0": EAST, "evader_0": WEST})
    assert twin.state().tolist() == [1, 4, 0]
