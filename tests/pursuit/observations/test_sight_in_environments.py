"""Limited views and the encoding "window" in all environments, runs and learned policies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from conformance import check_parallel_env
from gymnasium.utils.env_checker import check_env
from pettingzoo import test as pettingzoo_test

from pursuit import chase_v0, heist_v0, make_task
from pursuit.mazes.maze import Maze
from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder, Extras
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task
from scripted_agents import AStarEvader, RandomAgent
from train.commands.parse import parse
from train.evaluation.contest import GameContest
from train.experiments.identity import fingerprint
from train.networks.actor_critic import ActorCritic
from train.networks.layers import Hidden
from train.networks.policy import LearnedPolicy, MazeSeat, sees_cells_only
from train.runs.parts import settings_of
from train.runs.saved import learning_seat
from train.settings.task import TaskSettings

HIDDEN: dict[str, Any] = {
    "view_radius": {"chaser": 2},
    "line_of_sight": "evader",
    "unknown_maze": "chaser",
}


@pytest.mark.parametrize("observation", ["index", "walls", "planes", "window", "window:1"])
def test_environments_with_limited_views_conform(observation: str) -> None:
    env = heist_v0.parallel_env(
        maze=["3x3", "4x4-open"], num_chasers=2, observation=observation, max_steps=30, **HIDDEN
    )
    check_parallel_env(env, max_steps=30)
    one = chase_v0.env(maze="3x3", observation=observation, max_steps=20, **HIDDEN)
    pettingzoo_test.api_test(one, num_cycles=40)


def test_the_state_keeps_everything() -> None:
    hidden = heist_v0.parallel_env(view_radius=0)
    known = heist_v0.parallel_env()
    for env in (hidden, known):
        env.reset(seed=3)
    assert (hidden.state() == known.state()).all() and hidden.state()[:-1].all()


def test_scripted_agents_ignore_limited_views() -> None:
    hidden, visible = (
        Simulator(make_task("chase", view_radius=radius), 50, seed=1) for radius in (0, None)
    )
    for simulator in (hidden, visible):
        actions = np.zeros((50, 2), dtype=np.int32)
        for _ in range(10):
            simulator.act([None, AStarEvader(0.2)], actions)
            simulator.step(actions)
    assert (hidden.positions == visible.positions).all()


@pytest.mark.parametrize("observation", ["positions", "window"])
def test_gymnasium_observes_what_the_simulator_shows(observation: str) -> None:
    settings = {"observation": observation, "maze": "4x4", "max_steps": 9, **HIDDEN}
    env = gymnasium.make("pursuit/Evader-v0", **settings)
    check_env(env.unwrapped, skip_render_check=True)
    observed, _ = env.reset(seed=2)
    shown = env.unwrapped.simulator.observe(observation, "evader")  # type: ignore[attr-defined]
    assert (observed == shown[0]).all()
    envs = gymnasium.make_vec("pursuit/Chaser-v0", num_envs=3, **settings)
    observed, _ = envs.reset(seed=2)
    for _ in range(20):
        simulator = envs.unwrapped.simulator  # type: ignore[attr-defined]
        assert (observed == simulator.observe(observation, "chaser")).all()
        observed, *_ = envs.step(envs.action_space.sample())


@pytest.mark.parametrize("observation", ["index", "window", "walls"])
def test_a_learned_policy_with_limited_view_is_a_table_of_pairs_of_cells(
    observation: str,
) -> None:
    task = make_task("chase", maze="3x3", max_steps=40, view_radius=1, unknown_maze=True)
    torch.manual_seed(1)
    seat = MazeSeat(task, "chaser", observation)
    network = ActorCritic(seat.features, 4, Hidden(16))
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    policy = LearnedPolicy(network, seat, greedy=False)
    table = policy.action_probabilities(task.mazes[0])
    for own in range(9):  # wherever the evader is that it does not see, it does the same
        unseen = ~task.sees("chaser")[own]
        assert (table[own, unseen] == table[own, unseen][:1]).all()
    games = 400 if observation == "window" else 20_000  # convolutions take their time
    contest = GameContest(task, "chaser", {"evader": RandomAgent()}, games)
    exact = contest.score("learned", policy)
    lengths, _ = contest.play(policy)
    assert exact.exact
    assert abs(lengths.mean() - exact.mean_steps) < 4 * lengths.std() / len(lengths) ** 0.5


def test_windows_are_planes_for_networks_and_fit_mazes_of_any_size() -> None:
    small, large = (make_task("chase", maze=maze, view_radius=2) for maze in ("3x3", "9x9"))
    for observation in ("window", "window:4"):
        features = MazeSeat(small, "chaser", observation).features
        assert features.kind == "planes" and sees_cells_only(small, observation)
        assert features.shape == MazeSeat(large, "chaser", observation).features.shape
    assert MazeSeat(small, "chaser", "window").features.shape == (11, 5, 5)
    assert MazeSeat(make_task("chase"), "chaser", "window").features.shape == (10, 9, 9)
    seat = MazeSeat(small, "chaser", "window")
    policy = LearnedPolicy(ActorCritic(seat.features, 4, Hidden(8)), seat)
    assert policy.act(Simulator(large, 5).view("chaser")).shape == (5,)


@pytest.mark.parametrize("turn", range(4))
def test_a_window_is_the_same_wherever_the_maze_lies(turn: int) -> None:
    """Two copies of a corridor with a pit beside it, one of them far inside a larger maze."""
    text = "+-+-+-+\n|     |\n+-+ +-+\n|#|G  |\n+-+-+-+"
    small = Maze.from_text(text)
    walkable = np.zeros((6, 7), dtype=bool)
    south, east = np.zeros((5, 7), dtype=bool), np.zeros((6, 6), dtype=bool)
    down, right = divmod(turn, 2)
    down, right = 2 * down + 1, 3 * right + 1
    own = small.cell_numbers >= 0
    walkable[down : down + 2, right : right + 3] = own
    east[down, right : right + 2] = east[down + 1, right + 1] = True
    south[down, right + 1] = True
    large = Maze(walkable, south, east)
    assert large.num_cells == small.num_cells == 5
    tasks = [
        Task(maze=maze, num_chasers=1, num_evaders=1, view_radius=3) for maze in (small, large)
    ]
    for cells in ([0, 4], [4, 1], [2, 3]):
        shown = []
        for task in tasks:
            simulator = Simulator(task)
            simulator.place(cells)
            shown.append(simulator.observe("window:3"))
        np.testing.assert_array_equal(*shown)


def test_a_window_too_large_is_refused() -> None:
    for observation, said in (("window:256", "at most 255"), ("window:x", "window:x")):
        with pytest.raises(ValueError, match=said):
            Simulator(make_task("chase")).observe(observation)
    with pytest.raises(ValueError, match="at most 255"):
        settings_of(observation="window:999", seconds=1)


def test_settings_of_runs_store_view_settings() -> None:
    plain = settings_of(seconds=1)
    limited = settings_of(
        seconds=1, view_radius={"evader": 3, "chaser": 2}, line_of_sight=True,
        unknown_maze=["chaser"], observation="window:4",
    )  # fmt: skip
    assert limited.task.view_radius == "chaser=2,evader=3"
    assert (limited.task.line_of_sight, limited.task.unknown_maze) == ("all", "chaser")
    task = limited.task.build()
    assert task == replace(
        plain.task.build(),
        view_radius={"chaser": 2, "evader": 3}, line_of_sight=True, unknown_maze=("chaser",),
    )  # fmt: skip
    assert learning_seat(limited).features.shape == (11, 9, 9)
    made = {fingerprint("single", each, 100, {}) for each in (plain, limited)}
    assert len(made) == 2
    assert fingerprint("single", settings_of(seconds=1, view_radius=2), 100, {}) not in made
    with pytest.raises(ValueError, match="path distance such as 2"):
        settings_of(seconds=1, view_radius="far")


def test_options_that_name_agents_mean_all_without_a_name() -> None:
    given = ["--line-of-sight", "--view-radius", "chaser=2", "--unknown-maze"]
    task = parse(TaskSettings, given, "train")
    assert (task.line_of_sight, task.view_radius, task.unknown_maze) == ("all", "chaser=2", "all")
    assert parse(TaskSettings, ["--unknown-maze", "evader"], "train").unknown_maze == "evader"


def test_a_replay_with_limited_views_shows_the_visible_cells(tmp_path: Path) -> None:
    env = Recorder(chase_v0.parallel_env(maze="3x3", max_steps=8, **HIDDEN))
    env.reset(seed=1)
    while env.agents:
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    again = Replay.load(env.save(tmp_path / "one"))
    assert again.task.sight.limits == env.task.sight.limits and not again.check()
    pages = Builder()
    pages.add(again, Extras(seat="chaser_0"))
    seen, (start, *_) = pages.items[0]["seen"], again.play().states
    assert seen["names"][-1] == "in view"
    shown = {cell for plane, cell in seen["steps"][0] if plane == seen["names"].index("in view")}
    visible = again.task.sees("chaser_0")[start["cells"][0]]
    assert shown == set(np.flatnonzero(visible)) != set(range(9))
