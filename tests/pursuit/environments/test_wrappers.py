"""Names, wrappers and masks of other libraries work with the environments."""

import copy
import pickle
from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest
from conformance import check_parallel_env
from gymnasium.utils.env_checker import check_env
from pettingzoo import test as pettingzoo_test
from pettingzoo.utils.wrappers import TerminateIllegalWrapper
from torchrl.envs import GymEnv, GymWrapper, PettingZooWrapper, check_env_specs

from pursuit import ReacherSimulator, ReacherTask, Simulator, chase_v0, make_task, reacher_v0
from pursuit.mazes.maze import Maze, load_maze
from pursuit.observations.masks import bump_masks
from scripted_agents import AStarEvader
from scripted_agents.environments import make_env
from train.environments.simulator_env import SimulatorEnv
from train.networks.arm_policy import ArmSeat
from train.networks.policy import MazeSeat

CORRIDOR = Maze.from_text("+-+-+-+-+-+\n|         |\n+-+-+-+-+-+")
NORTH, SOUTH, EAST, WEST, STAY = range(5)
TASKS = ("chase", "maze", "race", "heist", "reacher")
MASKED: dict[str, Any] = {"mask_bumps": True, "stay_action": True}

pytestmark = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(pettingzoo, "register"), reason="a PettingZoo without a registry")
@pytest.mark.parametrize("task", TASKS)
def test_the_registry_of_pettingzoo_makes_both_forms(task: str) -> None:
    by_turns = pettingzoo.make("aec", f"pursuit/{task}-v0", max_cycles=7)
    at_once = pettingzoo.make("parallel", f"pursuit/{task}-v0", max_cycles=7)
    assert isinstance(by_turns, pettingzoo.AECEnv)
    assert by_turns.possible_agents == at_once.possible_agents
    assert by_turns.unwrapped.task.max_steps == at_once.task.max_steps == 7


def test_max_cycles_is_max_steps() -> None:
    assert chase_v0.parallel_env(max_cycles=9).task.max_steps == 9
    assert gymnasium.make("pursuit/Reacher-v0", max_cycles=9).unwrapped.task.max_steps == 9
    for make in (chase_v0.parallel_env, reacher_v0.parallel_env):
        with pytest.raises(TypeError, match="max_steps and max_cycles; give only one"):
            make(max_cycles=9, max_steps=9)
        with pytest.raises(ValueError, match="max_steps=0"):
            make(max_cycles=0)


@pytest.mark.parametrize("name", ["Chaser", "Evader", "Maze", "Reacher"])
def test_unknown_settings_are_unknown_keywords(name: str) -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
            make(f"pursuit/{name}-v0", frameskip=2)
    for module in (chase_v0, reacher_v0):
        for maker in (module.parallel_env, module.env, module.raw_env):
            with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
                maker(frameskip=2)


def test_states_are_floats_for_central_critics() -> None:
    env = chase_v0.parallel_env(maze="3x3", num_evaders=2, max_steps=9)
    env.reset(seed=0)
    cells = (env.simulator.positions[0] + 1).tolist()
    assert env.state().dtype == env.state_space.dtype == np.float32
    assert env.state().tolist() == [*cells, 0] and env.state() in env.state_space


# -- wrappers --------------------------------------------------------------------------------------


def test_terminate_illegal_ends_the_game_at_a_masked_move() -> None:
    env = TerminateIllegalWrapper(chase_v0.env(maze=CORRIDOR, **MASKED), illegal_reward=-7.0)
    env.reset(seed=0, options={"positions": [0, 4]})
    env.step(EAST)
    env.step(EAST)  # the evader, into the wall
    ends = {}
    for agent in env.agent_iter(10):
        _, reward, terminated, truncated, _ = env.last()
        ends[agent] = (reward, terminated, truncated)
        env.step(None)
    assert ends == {"evader_0": (-7.0, True, True), "chaser_0": (0.0, True, True)}
    env.reset(seed=0)
    assert env.agents == ["chaser_0", "evader_0"] and not any(env.terminations.values())


def test_terminate_illegal_allows_legal_moves() -> None:
    for place in ({}, {"mask_in_observation": True}):
        env = TerminateIllegalWrapper(chase_v0.env(maze="3x3", **MASKED, **place), -7.0)
        env.reset(seed=0)
        rng = np.random.default_rng(0)
        for _ in env.agent_iter(2000):
            observed, _, terminated, truncated, info = env.last()
            mask = observed["action_mask"] if place else info["action_mask"]
            over = terminated or truncated
            env.step(None if over else int(rng.choice(np.flatnonzero(mask))))
        assert not env.agents and env.unwrapped.simulator.ended[0]


def test_the_turn_based_environment_is_copied_whole() -> None:
    env = chase_v0.env(maze=CORRIDOR)
    env.reset(seed=0, options={"positions": [0, 4]})
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        twin.step(EAST)
        twin.step(NORTH)
        assert twin.state().tolist() == [2, 5, 1] and env.state().tolist() == [1, 5, 0]
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = env.unwrapped.nothing_like_it


FAR: dict[str, dict[str, Any]] = {"Chaser": {"maze": "9x9"}, "Reacher": {"tolerance": 1e-6}}
"""Games that do not end in a few idle steps."""


@pytest.mark.parametrize("name", FAR)
def test_supersuit_skips_frames(name: str) -> None:
    supersuit = pytest.importorskip("supersuit")
    module, options = reacher_v0, None
    if name == "Chaser":
        module, options = chase_v0, {"positions": [0, 80]}
    taken = []
    for _ in range(2):
        env = supersuit.frame_skip_v0(gymnasium.make(f"pursuit/{name}-v0", **FAR[name]), (2, 5))
        env.reset(seed=3, options=options)
        for _ in range(4):
            env.step(NORTH if name == "Chaser" else np.zeros(2, dtype=np.float32))
        taken.append(int(env.unwrapped.simulator.steps[0]))
    assert taken[0] == taken[1] and 8 <= taken[0] <= 20
    parallel = module.parallel_env(**FAR[name])
    env = supersuit.frame_skip_v0(parallel, 3)
    env.reset(seed=3, options=options)
    nothing = NORTH if name == "Chaser" else np.zeros(1, dtype=np.float32)
    env.step(dict.fromkeys(env.agents, nothing))
    assert parallel.simulator.steps.tolist() == [3]


def test_np_random_follows_the_seed_and_nothing_else() -> None:
    for env in (
        chase_v0.parallel_env(),
        reacher_v0.parallel_env(),
        gymnasium.make("pursuit/Chaser-v0").unwrapped,
        gymnasium.make("pursuit/Reacher-v0").unwrapped,
        gymnasium.make_vec("pursuit/Chaser-v0", 2),
        gymnasium.make_vec("pursuit/Reacher-v0", 2),
    ):
        draws = []
        for seed in (5, 5, None, 6):
            observed = env.reset(seed=seed)[0]
            draws.append(env.np_random.integers(10**9))
            env.np_random.random(100)
            if seed is not None:  # what wrappers draw changes nothing of the game
                np.testing.assert_equal(env.reset(seed=seed)[0], observed)
                env.np_random.integers(10**9)
        assert draws[0] == draws[1] and len({*draws}) == 3


# -- TorchRL ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "mode"), [("pursuit/Chaser-v0", "DISABLED"), ("pursuit/Reacher-v0", "SAME_STEP")]
)
def test_torchrl_wraps_the_vector_environment(name: str, mode: str) -> None:
    envs = gymnasium.make_vec(name, num_envs=4, max_steps=20, autoreset_mode=mode)
    env = GymWrapper(envs, categorical_action_encoding=True)
    check_env_specs(env)
    rollout = env.rollout(60, break_when_any_done=False)
    assert rollout.shape == (4, 60)
    done = rollout["next", "done"].squeeze(-1)
    assert done.sum() >= 12
    # What follows an end is a start: nothing is carried across it.
    ends = done[:, :-1].nonzero()
    assert (rollout["next", "observation"][:, :-1] == rollout["observation"][:, 1:])[
        ~done[:, :-1]
    ].all()
    same = 0
    for game, step in ends.tolist():
        before, after = (
            rollout["next", "observation"][game, step],
            rollout["observation"][game, step + 1],
        )
        same += bool((before == after).all())
    # A start may be where the last game ended, but one in 600 is.
    assert name.endswith("Reacher-v0") or same <= 2


def test_torchrls_frame_skip_falls_back_as_it_relies_on() -> None:
    env = GymEnv("pursuit/Chaser-v0", frame_skip=2, max_steps=10)
    rollout = env.rollout(50, break_when_any_done=False)
    assert rollout["next", "truncated"].any()


def test_torchrl_continues_team_games_after_a_capture() -> None:
    parallel = chase_v0.parallel_env(maze="3x3", num_chasers=2, num_evaders=2, max_steps=30)
    env = PettingZooWrapper(parallel, done_on_any=False, use_mask=True)
    env.set_seed(0)
    rollout = env.rollout(300, break_when_any_done=False)
    done, caught = rollout["next", "done"], rollout["next", "evader", "terminated"]
    alone = caught.any(dim=1) & ~caught.all(dim=1)
    assert (alone & ~done).any()  # one is caught, and the game goes on
    assert done.sum() > 5


@pytest.mark.parametrize("world", ["grid", "arm"])
def test_the_batched_environment_refuses_auto_restart(world: str) -> None:
    task, arm = make_task("chase", maze="3x3"), ReacherTask()

    def make(restart: bool) -> Any:
        if world == "arm":
            return SimulatorEnv(ReacherSimulator(arm, 4, auto_restart=restart), ArmSeat(arm))
        simulator = Simulator(task, 4, auto_restart=restart)
        return SimulatorEnv(simulator, MazeSeat(task, "chaser"), [None, AStarEvader(0.2)])

    check_env_specs(make(False), break_when_any_done="both")
    with pytest.raises(ValueError, match=r"Simulator\(\.\.\., auto_restart=False\)"):
        make(True)


# -- masks in observations -------------------------------------------------------------------------


@pytest.mark.parametrize("bumps", [False, True])
def test_masks_in_the_observations_of_pettingzoo(bumps: bool) -> None:
    settings = {"mask_in_observation": True, "mask_bumps": bumps, "stay_action": True}
    env = chase_v0.parallel_env(maze="3x3", num_evaders=2, max_steps=20, **settings)
    check_parallel_env(env)
    pettingzoo_test.api_test(chase_v0.env(maze="3x3", max_steps=20, **settings), num_cycles=60)
    observations, infos = env.reset(seed=1)
    masks = bump_masks(load_maze("3x3"), 5)
    for seat, agent in enumerate(env.agents):
        seen = observations[agent]
        assert seen in env.observation_space(agent) and seen["action_mask"].dtype == np.int8
        wanted = masks[env.simulator.positions[0, seat]] if bumps else np.ones(5)
        assert (seen["action_mask"] == wanted).all()
        assert seen["observation"] is not None and ("action_mask" in infos[agent]) == bumps


@pytest.mark.parametrize("bumps", [False, True])
def test_masks_in_the_observations_of_gymnasium(bumps: bool) -> None:
    settings: dict[str, Any] = {"mask_bumps": bumps, "stay_action": True, "max_steps": 12}
    check_env(
        make_env("maze", "runner", mask_in_observation=True, **settings), skip_render_check=True
    )
