"""Replays, pictures and pages of games with options of the rules."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pursuit import escape_v0
from pursuit.environments.parallel import scene_of
from pursuit.mazes.maze import Maze
from pursuit.rendering.marks import outcome_text
from pursuit.rendering.rendering import CAPTURED, EXIT, ROLE_COLORS, Scene
from pursuit.replays.recorder import Recorder
from pursuit.replays.replay import Replay
from pursuit.replays.viewer.data import Builder
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarEvader, RandomAgent
from train.evaluation.contest import GameContest

LINE = Maze.from_text("+-+-+-+-+\n|       |\n+-+-+-+-+")
GAMES: dict[str, dict[str, Any]] = {
    "drawn exits": {"num_exits": 2, "num_evaders": 2},
    "slips": {"slip": 0.3, "num_evaders": 2},
    "turns": {"move_order": "turns", "exits": [5], "slip": {"evader": 0.5}},
    "block": {"collisions": "block", "capture": "adjacent", "n_catch": 2},
    "surround": {"capture": "surround", "move_order": "chasers_first", "slip": 0.2},
}


def recorded(task: Task, steps: int = 60) -> tuple[Replay, Simulator]:
    simulator = Simulator(task, 4, seed=5)
    recorder, rng = Recorder(simulator), np.random.default_rng(0)
    for step in range(steps):
        if step == 20 and task.options.slips:
            simulator.configure(slip=0.7)
        simulator.step(rng.integers(task.num_actions, size=(4, task.num_agents)))
    return recorder.stop(), simulator


@pytest.mark.parametrize("name", GAMES)
def test_games_with_options_are_replayed_bit_for_bit(name: str, tmp_path: Path) -> None:
    settings = {"num_chasers": 2, "num_evaders": 1, "stay_action": True, **GAMES[name]}
    task = Task("4x4-tree", max_steps=12, **settings)
    replay, _ = recorded(task)
    assert len(replay.episodes) > 5
    loaded = Replay.load(replay.save(tmp_path / "replay"))
    assert loaded.task.options == task.options and loaded.task.slips == task.slips
    assert loaded.check() == []
    assert sum(len(loaded.play(n).states) for n in range(len(loaded.episodes))) > 50


def test_other_exits_or_slips_are_found_by_the_check(tmp_path: Path) -> None:
    replay, _ = recorded(Task("4x4-tree", 2, 1, max_steps=12, slip=0.5, num_exits=2))
    path = replay.save(tmp_path / "replay")
    for name, value in (("slip", [0.0, 0.0, 0.0]), ("exits", None)):
        content = json.loads(path.read_text())
        for episode in content["episodes"]:
            taken = {*episode["start"]["positions"], *episode["start"]["exits"]}
            free = [cell for cell in range(16) if cell not in taken]
            episode["start"][name] = value or free[:2]
        path.with_name("other.json").write_text(json.dumps(content))
        assert "its states differ" in "".join(Replay.load(path.with_name("other.json")).check())


def test_replays_without_options_name_none_of_them(tmp_path: Path) -> None:
    """Older versions read them, and files without these names are read."""
    replay, _ = recorded(make_task("chase", maze="4x4-tree", max_steps=9))
    content = json.loads(replay.save(tmp_path / "replay").read_text())
    assert not {
        "capture",
        "n_catch",
        "capture_check",
        "exits",
        "num_exits",
        "collisions",
        "slip",
    } & (content["task"].keys())
    assert content["episodes"][0]["start"].keys() == {"positions", "goals", "maze"}
    assert Replay.load(tmp_path / "replay.json").check() == []


def test_exits_are_drawn_and_escaped_evaders_on_them_in_grey() -> None:
    simulator = Simulator(Task(LINE, 1, 2, exits=[3]), auto_restart=False)
    simulator.place([0, 2, 1])
    scene = scene_of(simulator)
    assert scene.exits == (3,) and scene.text().splitlines()[1] == "|C E E X|"
    bare = Scene(scene.maze, scene.agents, scene.goals, scene.steps, scene.max_steps)
    exits = (scene.draw() != bare.draw()).any(axis=2)
    rows, columns = np.nonzero(exits)
    assert columns.min() > 0.75 * exits.shape[1] * 0.9  # in the last of four cells
    assert (scene.draw()[rows, columns] == EXIT).all()
    simulator.step([[0, 2, 0]])
    after = scene_of(simulator)
    assert [agent.escaped for agent in after.agents] == [False, True, False]
    assert after.text().splitlines()[1] == "|C E   e|"
    colors = ROLE_COLORS["evader"], CAPTURED
    blue, grey = (
        [(each.draw() == color).all(axis=2).sum() for each in (scene, after)] for color in colors
    )
    assert blue[1] < 0.6 * blue[0] and grey[1] > 0.3 * blue[0] > grey[0] == 0
    crossed = replace(after, agents=tuple(replace(agent, escaped=False) for agent in after.agents))
    assert (crossed.draw() != after.draw()).any()
    assert [agent.fate for agent in after.agents] == ["", "escaped", ""]
    simulator.step([[0, 0, 0]])  # it is still known in later steps
    assert scene_of(simulator).agents == after.agents
    simulator.place([2, 1, 0])
    simulator.step([[2, 0, 0]])
    assert scene_of(simulator).text().splitlines()[1] == "|E E   C|"
    near = Simulator(Task(LINE, 1, 1, exits=[3], capture="adjacent"), auto_restart=False)
    near.place([1, 2])
    near.step([[2, 2]])  # captured on the exit from the cell beside it
    assert scene_of(near).agents[1].fate == "captured"


def test_what_became_of_an_evader_is_known_from_the_scene_before() -> None:
    """Also of one that was captured on an exit that the chaser has left."""
    simulator = Simulator(Task(LINE, 1, 2, exits=[3]), auto_restart=False)
    simulator.place([3, 2, 0])
    scene = None
    for moves in ([2, 2, 0], [3, 0, 0]):
        simulator.step([moves])
        scene = scene_of(simulator, before=scene)
    assert scene is not None
    seen = [agent.fate for agent in scene.agents]
    assert seen[1] == "captured" and scene_of(simulator).agents[1].fate == "escaped"


def test_the_outcome_counts_evaders_and_goals() -> None:
    for fates, goals, said in (
        (("escaped",), (0, 0), "escaped"),
        (("captured", "free", "captured"), (0, 0), "2 captured, 1 free"),
        (("free",), (0, 3), "free, all goals collected"),
        ((), (1, 3), "1 goal left"),
        ((), (2, 3), "2 goals left"),
    ):
        assert outcome_text(fates, *goals) == said


def test_pages_show_exits_and_escapes() -> None:
    replay, _ = recorded(Task(LINE, 1, 1, num_exits=1, stay_action=True, max_steps=6), 40)
    builder = Builder()
    builder.add(replay)
    for item, episode in zip(builder.items, replay.episodes, strict=True):
        assert builder.worlds[item["world"]]["exits"] == episode.start["exits"]
        assert item["escaped"][0] is False
        # A capture pays -1 to the evader, an escape 1.
        assert item["escaped"][1] == (item["terminated"] and item["rewards"][1][-1] == 1)
        fates = "escaped" if item["escaped"][1] else "captured" if item["terminated"] else "free"
        assert item["outcome"] == fates
        # The trail of an evader that has escaped ends on the exit.
        assert len(item["cells"][1]) == item["length"] + 1
        assert not item["escaped"][1] or item["cells"][1][-1] in episode.start["exits"]
    assert any(item["escaped"][1] for item in builder.items)
    assert any(not item["escaped"][1] for item in builder.items)
    assert not builder.warnings and '"exits"' in replay.page()


def test_animations_end_with_the_outcome() -> None:
    task = make_task("escape", maze="3x3", max_steps=4)
    scenes = GameContest(task, "chaser", {"evader": AStarEvader(0.5)}, 8).scenes(RandomAgent(), 12)
    captions = [scene.caption for scene in scenes]
    ends = {caption.partition(": ")[2] for caption in captions}
    assert ends == {"", "captured", "escaped", "free"}
    assert captions[0] == "episode 1 of 12" and captions[-1].startswith("episode 12 of 12: ")


def test_environments_record_and_render_escapes(tmp_path: Path) -> None:
    env = escape_v0.parallel_env(maze="4x4-tree", render_mode="ansi", max_steps=30)
    recorder = Recorder(env)
    for seed in range(3):
        env.reset(seed=seed)
        assert "X" in str(env.render())
        while env.agents:
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert len(recorder.replay.episodes) == 3
    assert Replay.load(recorder.save(tmp_path / "escape")).check() == []
