"""Exported networks and datasets give what the policies play."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import networkx as nx
import numpy as np
import pytest
import torch
from command_errors import error_of
from command_errors import run as run_command

import pursuit
import train
from pursuit.replays.adapters import MazeAdapter
from scripted_agents import AStarChaser
from train.kinds import start
from train.networks.layers import Hidden
from train.networks.policy import MazeSeat
from train.networks.q_network import QNetwork

ACTIONS = ["north", "south", "east", "west", "stay"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Short runs with several kinds of networks."""
    folder, small = tmp_path_factory.mktemp("runs"), {"num_games": 64, "minibatch_size": 256}
    changed: dict[str, Any]
    for name, changed in (
        ("index", small),
        ("planes", {"observation": "planes", **small}),
        ("dqn", {"algorithm": "dqn", "learning_starts": 256}),
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            start(
                "single", train.settings_of(maze="3x3", frames=4000, **changed), folder / name
            ).train()
    return folder


@pytest.mark.parametrize(
    ("name", "suffix"),
    [("index", ".pt2"), ("planes", ".onnx"), ("planes", ".pt2"), ("dqn", ".onnx")],
)
def test_an_exported_network_gives_the_same_probabilities(
    runs: Path, name: str, suffix: str, tmp_path: Path
) -> None:
    policy = train.load_policy(runs / name)
    path = train.export_policy(policy, tmp_path / f"policy{suffix}")
    sim = pursuit.Simulator(policy.task, num_games=7, seed=3)
    sim.reset()
    observed = sim.view(0).observe(policy.encoding)
    with torch.no_grad():
        known = torch.softmax(policy.network.logits(torch.from_numpy(observed)), -1).numpy()
    found: Any
    if suffix == ".pt2":
        found = torch.export.load(path).module()(torch.from_numpy(observed)).detach().numpy()
    else:
        runtime = pytest.importorskip("onnxruntime")
        session = runtime.InferenceSession(path)
        [found] = session.run(["probabilities"], {"observation": observed})
    np.testing.assert_allclose(found, known, atol=1e-5)
    np.testing.assert_array_equal(found.argmax(axis=1), policy.act(sim.view(0)))


@pytest.mark.parametrize(("maze", "suffix"), [("3x3", ".onnx"), ("graph", ".pt2")])
def test_an_exported_network_says_how_it_is_used(maze: str, suffix: str, tmp_path: Path) -> None:
    ring = pursuit.Maze.from_graph(nx.cycle_graph(5))
    task = pursuit.make_task(
        "chase", maze=ring if maze == "graph" else maze, stay_action=True, max_steps=50
    )
    seat = MazeSeat(task, "chaser", "index")
    network = QNetwork(seat.features, task.num_actions, Hidden(8))
    path = train.export_policy(seat.policy(network), tmp_path / f"policy{suffix}")
    if suffix == ".pt2":
        texts: dict[str, Any] = {"pursuit.json": ""}
        torch.export.load(path, extra_files=texts)
        found = json.loads(texts["pursuit.json"])
    else:
        runtime = pytest.importorskip("onnxruntime")
        given = runtime.InferenceSession(path).get_modelmeta().custom_metadata_map
        found = {name.removeprefix("pursuit."): text for name, text in given.items()}
    assert (found["agent"], found["observation"]) == ("chaser", "index")
    known = json.loads(found["task"])
    assert known == MazeAdapter().settings(MazeAdapter().task(known))
    assert known["mazes"][0]["text"] == task.mazes[0].to_text() and known["max_steps"] == 50
    moves = ACTIONS[:4] if maze != "graph" else ["neighbor 0", "neighbor 1"]
    assert json.loads(found["actions"]) == [*moves, "stay"]
    assert "network scales" in found["normalisation"] and "softmax" in found["output"]
    assert found["version"] == pursuit.__version__


@pytest.mark.slow
def test_an_export_that_cannot_be_written_is_an_error(runs: Path, tmp_path: Path) -> None:
    """In a process of its own, as torch ends the process where its own writer fails."""
    lines = f"""
import resource, signal, train
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
policy = train.load_policy({str(runs / "index")!r})
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY))
for name in ("policy.onnx", "policy.pt2"):
    try:
        train.export_policy(policy, name)
    except OSError as error:
        print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", lines],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(Path(pursuit.__file__).parents[1]),
            "PYTHONDONTWRITEBYTECODE": "1",  # Python would keep the part that can be written
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for name in ("policy.onnx", "policy.pt2"):
        assert f"{name}: cannot be written (File too large)" in done.stdout
    assert not [*tmp_path.iterdir()]


def test_what_cannot_be_exported_is_refused(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = train.load_policy(runs / "index")
    with pytest.raises(ValueError, match=r"ends in \.onnx or \.pt2"):
        train.export_policy(policy, tmp_path / "policy.h5")
    for text in (str(runs / "index"), runs / "index"):
        with pytest.raises(ValueError, match=r"policy='.*index'; give .*load_policy\('.*index'\)"):
            train.export_policy(text, tmp_path / "policy.pt2")
    with pytest.raises(ValueError, match="no network or table of a maze"):
        train.export_policy(AStarChaser(), tmp_path / "policy.pt2")
    team = {"algorithm": "ippo", "num_chasers": 2, "maze": "2x2", "frames": 640, "width": 8}
    small = {"num_games": 4, "rollout_steps": 4, "minibatch_size": 8, "max_steps": 8}
    for sharing in ("separate", "joint"):
        run = start(
            "single", train.settings_of(**team, **small, sharing=sharing), tmp_path / sharing
        )
        with pytest.raises(ValueError, match=f"sharing='{sharing}' are not exported"):
            train.export_policy(run.trainee.learner.policy(), tmp_path / "policy.pt2")
    out = tmp_path / "made.pt2"
    command = ("export", runs / "index", "--out", out)
    run_command(*command)
    assert "observation [batch, 3] (index)" in capsys.readouterr().out and out.exists()
    assert "exists" in error_of(capsys, *command)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    "changed",
    [{"frame_stack": 2, "recurrent": "gru"}, {"algorithm": "q_learning", "observation": "index"}],
)
def test_both_forms_of_a_file_are_the_same_function(
    changed: dict[str, Any], tmp_path: Path
) -> None:
    runtime = pytest.importorskip("onnxruntime")
    small = {"num_games": 8, "rollout_steps": 4, "minibatch_size": 16, "width": 8, "frames": 32}
    small = {"frames": 4000} if "algorithm" in changed else small
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = start("single", train.settings_of(maze="3x3", **small, **changed), tmp_path / "run")
        run.train()
    paths = [tmp_path / f"policy{suffix}" for suffix in (".onnx", ".pt2")]
    for path in paths:
        train.export_policy(run.trainee.policy, path)
    session = runtime.InferenceSession(paths[0])
    sim = pursuit.Simulator(run.trainee.policy.task, num_games=7, seed=3)
    sim.reset()
    feed = {"observation": sim.view(0).observe("index")}
    if "recurrent" in changed:
        feed["memory"] = np.random.default_rng(0).integers(-9, 0, (7, 8 + 3)).astype(np.float32)
    program = torch.export.load(paths[1]).module()
    others: Any = program(*map(torch.from_numpy, feed.values()))
    found = session.run(None, feed)
    for one, other in zip(found, others if len(found) > 1 else [others], strict=True):
        np.testing.assert_allclose(one, other.detach().numpy(), atol=1e-5)
    extra: dict[str, Any] = {"pursuit.json": ""}
    torch.export.load(paths[1], extra_files=extra)
    assert (json.loads(extra["pursuit.json"])["memory"] == "null") == ("algorithm" in changed)


def test_a_minari_dataset_holds_the_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", opponent_epsilon=0.2)
    pursuit.export_minari("pursuit/test-v0", env, AStarChaser(), episodes=5, seed=7)
    saved = list(minari.load_dataset("pursuit/test-v0").iterate_episodes())
    assert len(saved) == 5
    for number, episode in enumerate(saved):
        observed, _ = env.reset(seed=7 + number)
        for step, action in enumerate(episode.actions):
            np.testing.assert_array_equal(episode.observations[step], observed)
            observed, reward, terminated, truncated, _ = env.step(int(action))
            ended = episode.terminations[step], episode.truncations[step]
            assert ended == (terminated, truncated)
            assert episode.rewards[step] == pytest.approx(reward)
        assert terminated or truncated
    with pytest.raises(ValueError, match="dataset 'pursuit/test-v0' exists"):
        pursuit.export_minari("pursuit/test-v0", env, AStarChaser())
    first = pursuit.export_minari("pursuit/zero-v0", env, lambda seen: np.zeros(len(seen)), 2)
    assert all((episode.actions == 0).all() for episode in first.iterate_episodes())
    rng = np.random.default_rng(0)  # not of Minari's form, but the id is refused before
    others = ("x", "a/b-v0", "data/x-v0", "two//parts-v0", "a b-v0", "../x-v0", "", None, 5)
    for wrong in (*others, "a" * 300 + "-v0"):
        with pytest.raises(ValueError, match="give an id NAMESPACE/NAME-vNUMBER"):
            pursuit.export_minari(wrong, env, rng)  # type: ignore[arg-type]
    for policy, said in (
        (rng, "give a Policy, or a function"),
        ("runs/first", "give a Policy, or a function"),
        (lambda seen: None, "the policy returned None; return an array of one action"),
        (lambda seen: 0, "the policy returned 0; return an array of one action"),
    ):
        with pytest.raises(ValueError, match=said):
            pursuit.export_minari("pursuit/wrong-v0", env, policy)  # type: ignore[arg-type]
    numbers: Any = {"episodes": np.int64(1), "seed": np.int32(3)}
    pursuit.export_minari("pursuit/zero-v1", env, lambda seen: [0], **numbers)
    minari.delete_dataset("pursuit/zero-v1")
    assert set(minari.list_local_datasets()) == {"pursuit/test-v0", "pursuit/zero-v0"}
    with pytest.raises(ValueError, match="give a single-agent environment of Pursuit"):
        pursuit.export_minari("pursuit/arm-v0", gymnasium.make("pursuit/Reacher-v0"), AStarChaser())


@pytest.mark.parametrize("encoding", ["one_hot", "planes"])
def test_a_minari_dataset_holds_observations_with_masks(
    encoding: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    masks = {"mask_bumps": True, "mask_in_observation": True, "stay_action": True}
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", observation=encoding, **masks)

    def first_allowed(seen: Any) -> Any:
        return seen["action_mask"].argmax(axis=1)

    for name, policy in (("astar", AStarChaser()), ("own", first_allowed)):
        pursuit.export_minari(f"pursuit/{name}-v0", env, policy, episodes=2)
        for number, episode in enumerate(minari.load_dataset(f"pursuit/{name}-v0")):
            observed, _ = env.reset(seed=number)
            for step, action in enumerate([*episode.actions, None]):
                for part in ("observation", "action_mask"):
                    np.testing.assert_array_equal(episode.observations[part][step], observed[part])
                if action is not None:
                    assert observed["action_mask"][action]
                    observed, *_ = env.step(int(action))
    with pytest.raises(ValueError, match="the policy returned a tuple"):
        pursuit.export_minari("pursuit/pair-v0", env, lambda seen: (first_allowed(seen), None))
    assert set(minari.list_local_datasets()) == {"pursuit/astar-v0", "pursuit/own-v0"}


@pytest.mark.parametrize("failure", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_a_failure_leaves_no_part_of_a_minari_dataset(
    failure: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3", max_steps=5)
    pursuit.export_minari("pursuit/whole-v0", env, AStarChaser(), 1)
    for step in ("_generate_dataset_metadata", "MinariDataset"):  # the first and the last
        with monkeypatch.context() as broken, pytest.raises((KeyboardInterrupt, OSError)):

            def fail(*_: Any, **__: Any) -> None:
                raise failure

            broken.setattr(minari.utils, step, fail)
            pursuit.export_minari("other/half-v0", env, AStarChaser(), 1)
        assert [*minari.list_local_datasets()] == ["pursuit/whole-v0"]
    made = pursuit.export_minari("other/half-v0", env, AStarChaser(), 2)
    assert made.total_episodes == 2
