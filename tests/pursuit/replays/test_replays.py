"""Replays: playback reproduces recorded states, and files are small."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from diagonals import diagonal

import pursuit
from pursuit import Recorder, Replay, chase_v0, heist_v0, reacher_v0
from pursuit.replays.viewer.data import Builder
from pursuit.tasks.task import HEIST_REWARDS
from scripted_agents import AStarChaser, AStarEvader


def random_episode(env: Any, seed: int, steps: int = 1000) -> list[Any]:
    """Play a Gymnasium environment at random: the rewards."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rewards = []
    for _ in range(steps):
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        rewards.append(reward)
        if terminated or truncated:
            break
    return rewards


def same_task(one: Replay, other: Replay) -> bool:
    return bool(one.world.settings(one.task) == other.world.settings(other.task))


@pytest.mark.parametrize("num_evaders", [1, 3])
def test_playback_reproduces_every_state(num_evaders: int, tmp_path: Path) -> None:
    env = heist_v0.parallel_env(maze="5x5", num_evaders=num_evaders, num_chasers=2)
    recorder, rng = Recorder(env), np.random.default_rng(0)
    seen: list[list[Any]] = []
    for seed in range(5):
        env.reset(seed=seed)
        states, totals = [env.state()], dict.fromkeys(env.possible_agents, 0.0)
        while env.agents:
            _, rewards, _, _, _ = env.step({a: int(rng.integers(4)) for a in env.agents})
            states.append(env.state())
            for agent, reward in rewards.items():
                totals[agent] += reward
        seen.append([states, totals])
    replay = Replay.load(recorder.save(tmp_path / "games"))
    assert same_task(replay, recorder.replay) and replay.check() == [] and len(replay.episodes) == 5
    for number, (states, totals) in enumerate(seen):
        played = replay.play(number)
        assert len(played.states) == len(states)
        for again, state in zip(played.states, states, strict=True):
            agents = len(env.possible_agents)
            np.testing.assert_array_equal(again["cells"] + 1, state[:agents])
            np.testing.assert_array_equal(again["goals"] + 1, state[agents:-1])
        sums = replay.episodes[number].rewards.sum(axis=0, dtype=np.float64)
        np.testing.assert_allclose(sums, list(totals.values()), atol=1e-4)


def test_any_environment_can_be_recorded(tmp_path: Path) -> None:
    single = Recorder(gymnasium.make("pursuit/Evader-v0", maze="3x3", max_steps=30))
    totals = random_episode(single, 3)
    assert single.replay.episodes[0].rewards[:, 1].tolist() == pytest.approx(totals)
    batch = Recorder(gymnasium.make_vec("pursuit/Maze-v0", num_envs=8, maze="3x3"), games=4)
    batch.reset(seed=1)
    for step in range(250):
        batch.step(np.random.default_rng(step).integers(4, size=8))
    turns = Recorder(chase_v0.env(maze="3x3"))
    turns.reset(seed=5)
    for agent in turns.agent_iter():
        over = turns.terminations[agent] or turns.truncations[agent]
        turns.step(None if over else turns.action_space(agent).sample())
    loose = Recorder(pursuit.Simulator(pursuit.make_task("race", maze="4x4"), 3))
    for step in range(400):
        loose.step(np.random.default_rng(step).integers(4, size=(3, 2)))
    team = Recorder(reacher_v0.parallel_env(joints=2, max_steps=20, start="random"))
    team.reset(seed=0)
    while team.agents:
        team.step({agent: team.action_space(agent).sample() for agent in team.agents})
    arm = Recorder(gymnasium.make("pursuit/Reacher-v0", joints=8, max_steps=50, hold=3))
    random_episode(arm, 2)
    for number, recorder in enumerate((single, batch, turns, loose, team, arm)):
        replay = recorder.replay
        assert replay.episodes and replay.check() == []
        again = Replay.load(recorder.save(tmp_path / f"{number}.json"))
        assert again.check() == [] and same_task(again, replay)
        for before, after in zip(replay.episodes, again.episodes, strict=True):
            np.testing.assert_array_equal(before.actions, after.actions)
            np.testing.assert_array_equal(before.rewards, after.rewards)
            assert replace(before, actions=0, rewards=0) == replace(after, actions=0, rewards=0)


def test_recording_changes_nothing_and_can_be_stopped() -> None:
    task = pursuit.make_task("chase", maze="5x5")
    free, watched = pursuit.Simulator(task, 2, seed=4), pursuit.Simulator(task, 2, seed=4)
    recorder = Recorder(watched)
    for step in range(300):
        actions = np.random.default_rng(step).integers(4, size=(2, 2))
        free.step(actions)
        watched.step(actions)
        np.testing.assert_array_equal(free.positions, watched.positions)
    kept = len(recorder.stop().episodes)
    assert kept and type(watched).step is pursuit.Simulator.step and "step" not in vars(watched)
    watched.reset()
    assert len(recorder.episodes) == kept


def test_unfinished_episodes_are_kept() -> None:
    simulator = pursuit.Simulator(pursuit.make_task("chase"), 2, auto_restart=False)
    simulator.step([[0, 0], [1, 1]])
    recorder = Recorder(simulator)  # in the middle of two episodes, which are not recorded
    simulator.place([[0, 24], [0, 24]])
    simulator.step([[3, 0], [0, 0]])
    simulator.reset(games=[1])
    assert [(e.length, e.terminated, e.truncated) for e in recorder.episodes] == [(1, False, False)]
    while not simulator.ended.all():
        simulator.step(np.random.default_rng(int(simulator.steps[0])).integers(4, size=(2, 2)))
    assert len(recorder.episodes) == 3 and recorder.replay.check() == []
    starts = [episode.start["positions"] for episode in recorder.episodes]
    assert starts.count([0, 24]) == 2
    limited = Recorder(gymnasium.make("pursuit/Maze-v0", maze="9x9", max_episode_steps=10))
    for seed in range(4):
        random_episode(limited, seed)
    assert [episode.length for episode in limited.episodes] == [10, 10, 10]  # the last one runs on
    assert limited.replay.check() == []
    task = pursuit.make_task("chase", maze="4x4", num_evaders=2)
    policies = {"chaser": AStarChaser(), "evader": AStarEvader()}
    caught = Recorder(pursuit.SingleAgentEnv(task, "evader_0", policies))
    for seed in range(11):
        random_episode(caught, seed)
    assert len(caught.episodes) >= 10 and caught.replay.check() == []
    first, second = Recorder(caught.env), Recorder(caught.env)
    first.stop()
    for seed in range(3):
        random_episode(second, seed)
    assert not first.episodes and len(second.stop().episodes) >= 2


@pytest.mark.parametrize(
    ("name", "mode"), diagonal(["Chaser", "Reacher"], ["SAME_STEP", "NEXT_STEP", "DISABLED"])
)
def test_every_episode_of_a_batch_is_kept_in_all_reset_modes(name: str, mode: str) -> None:
    settings: dict[str, Any] = {"max_steps": 15}
    settings |= {"maze": "3x3"} if name == "Chaser" else {"joints": 1, "start": "random"}
    envs = gymnasium.make_vec(f"pursuit/{name}-v0", num_envs=5, autoreset_mode=mode, **settings)
    recorder = Recorder(envs)
    envs.reset(seed=2)
    envs.action_space.seed(3)
    lengths = []
    for _ in range(120):
        _, _, terminated, truncated, infos = envs.step(envs.action_space.sample())
        over = terminated | truncated
        if over.any():
            final = infos["final_info"] if mode == "SAME_STEP" else infos
            lengths += final["episode_length"][over].tolist()
            if mode == "DISABLED":
                envs.reset(options={"reset_mask": over})
    kept = [episode.length for episode in recorder.episodes]
    assert len(lengths) > 30 and kept == lengths and recorder.replay.check() == []


def test_ten_thousand_steps_are_less_than_a_megabyte(tmp_path: Path) -> None:
    # Four evaders that are unreachable: the maze has two components.
    maze = pursuit.Maze.from_text("+-+-+-+-+-+-+-+-+\n|       |       |\n+-+-+-+-+-+-+-+-+")
    task = pursuit.make_task(
        "chase", maze=maze, num_chasers=4, num_evaders=4, max_steps=10_000, rewards="distance"
    )
    simulator = pursuit.Simulator(task, auto_restart=False)
    recorder, rng = Recorder(simulator), np.random.default_rng(0)
    simulator.place([list(range(8))])
    while not simulator.ended[0]:
        simulator.step(rng.integers(4, size=(1, 8)))
    assert recorder.episodes[0].length == 10_000
    assert recorder.save(tmp_path / "maze.json").stat().st_size < 1_000_000
    arms = pursuit.ReacherSimulator(
        pursuit.ReacherTask(8, max_steps=10_000, tolerance=1e-6), auto_restart=False
    )
    arm = Recorder(arms)
    while not arms.ended[0]:
        arms.step(rng.uniform(-1, 1, size=(1, 8)))
    assert arm.episodes[0].length == 10_000
    assert arm.save(tmp_path / "arm.json").stat().st_size < 1_000_000


def test_differences_from_the_recording_are_reported(tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/Maze-v0", maze="3x3", max_steps=40)
    recorder = Recorder(env)
    random_episode(env, 0)
    path = recorder.save(tmp_path / "games.json")
    content = json.loads(path.read_text())
    episode = content["episodes"][0]

    def differences(**changes: Any) -> list[str]:
        changed = {**content, "versions": {"pursuit": "0.0.1"}}
        changed["episodes"] = [{**episode, **changes}]
        path.write_text(json.dumps(changed))
        return Replay.load(path).check()

    assert differences() == []
    found = differences(digest="0" * 64)
    assert found[0] == "episode 0: its states differ"
    assert found[1] == f"recorded with pursuit 0.0.1, played with {pursuit.__version__}"
    assert "rewards" in differences(rewards=[[each + 1 for each in episode["rewards"][0]]])[0]
    assert "terminates" in differences(terminated=not episode["terminated"])[0]
    longer = {"actions": [episode["actions"][0] + "0"], "rewards": [episode["rewards"][0] + [0.0]]}
    assert "ends after" in differences(**longer)[0] or "terminates" in differences(**longer)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(kind="other"), "kind"),
        (lambda c: c.update(form=99), "form 99.*update pursuit"),
        (lambda c: c.update(world="sea"), "unknown world 'sea'"),
        (lambda c: c["task"].update(rewards="os:system"), "a replay cannot name a function"),
        (lambda c: c["task"].update(colour="red"), "unknown settings of a task: colour"),
        (lambda c: c["task"].update(mazes=[]), "a list of mazes"),
        (lambda c: c["task"].update(maze="5x5"), "multiple values for keyword argument 'maze'"),
        (lambda c: c["task"].update(max_steps=0), "max_steps=0"),
        (lambda c: c["task"]["mazes"][0].update(text="no maze"), "maze"),
        (lambda c: c["episodes"][0].update(actions=["0123", "0"]), "rows of equal length"),
        (lambda c: c["episodes"][0].update(actions=["7"]), "action 7; actions are 0 to 3"),
        (lambda c: c["episodes"][0].update(actions="AAAA"), "actions do not fit world .maze."),
        (lambda c: c["episodes"][0].update(rewards=[[1.0]]), "rewards of shape"),
        (lambda c: c["episodes"][0].pop("digest"), "digest"),
    ],
)
def test_damaged_files_are_refused_by_name(change: Any, message: str, tmp_path: Path) -> None:
    recorder = Recorder(gymnasium.make("pursuit/Maze-v0", maze="3x3", max_steps=40))
    random_episode(recorder, 0)
    path = recorder.save(tmp_path / "games.json")
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=message) as error:
        Replay.load(path)
    assert str(path) in str(error.value)


def test_other_bad_input() -> None:
    with pytest.raises(ValueError, match="this one contains none"):
        Recorder(gymnasium.make("CartPole-v1"))
    env = gymnasium.make("pursuit/Maze-v0", maze="3x3")
    with pytest.raises(ValueError, match="games=0"):
        Recorder(env, games=0)
    with pytest.raises(ValueError, match="no episode to show"):
        Recorder(env).replay.page()
    with pytest.raises(ValueError, match="episode 0; this replay has 0"):
        Recorder(env).replay.play()


def test_all_rewards_are_restored_and_shown(tmp_path: Path) -> None:
    for rewards in ("zero_sum", "chaser.step=-0.25,evader.capture=-2", HEIST_REWARDS):
        task = pursuit.make_task("chase", maze="3x3", rewards=rewards)
        simulator = pursuit.Simulator(task, auto_restart=False)
        recorder = Recorder(simulator)
        while not simulator.ended[0]:
            simulator.step(np.random.default_rng(int(simulator.steps[0])).integers(4, size=(1, 2)))
        replay = Replay.load(recorder.save(tmp_path / "r.json"))
        assert replay.check() == [] and replay.task.role_rewards == task.role_rewards

    def custom(before: Any, actions: Any, after: Any) -> Any:
        return np.full(actions.shape, 7.0)

    task = pursuit.make_task("chase", maze="3x3", rewards=custom)
    recorder = Recorder(pursuit.Simulator(task))
    for step in range(300):
        recorder.step(np.random.default_rng(step).integers(4, size=(1, 2)))
    replay = Replay.load(recorder.save(tmp_path / "own.json"))
    assert replay.own_rewards and (replay.episodes[0].rewards == 7.0).all() and replay.check() == []
    builder = Builder()
    builder.add(replay)
    assert all(reward == 7 for item in builder.items for row in item["rewards"] for reward in row)


def test_a_file_that_is_nested_too_deeply_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    path.write_text("[" * 100_000)
    with pytest.raises(ValueError, match="not a valid replay"):
        Replay.load(path)


def test_what_is_not_a_file_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(ValueError, match=f"{path}: not a file"):
            Replay.load(path)


def test_an_episode_of_one_step_is_kept_if_the_next_start_is_equal() -> None:
    recorder = Recorder(
        pursuit.Simulator(pursuit.make_task("chase", maze="3x3"), auto_restart=False)
    )
    east = pursuit.load_maze("3x3").neighbors[0, 2]
    start = [0, int(east if east else 3)]
    for _ in range(5):
        recorder.place([start])
        recorder.step([[2 if east else 1, 3 if east else 0]])  # they swap cells: it is caught
    recorder.place([start])
    assert [(e.length, e.terminated) for e in recorder.episodes] == [(1, True)] * 5
