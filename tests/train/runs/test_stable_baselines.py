"""Saved Stable-Baselines3 models: they are tables, opponents and members of leagues."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from pursuit import make_task, race_v0
from pursuit.environments.stable_baselines import StableBaselinesVecEnv
from pursuit.simulator.simulator import Simulator
from scripted_agents import NearestGoalRunner, RandomAgent
from scripted_agents.environments import make_vector_env
from train.commands.evaluate import evaluate
from train.commands.league import league
from train.families.maze_policies import MAZE_POLICIES
from train.families.policies import loaded_policy
from train.kinds import start
from train.networks.policy import LearnedPolicy
from train.runs.folder import RUN
from train.runs.opponents import SAVED
from train.runs.parts import contest_of, settings_of
from train.runs.stable_baselines import (
    description_of,
    load_stable_baselines,
    save_stable_baselines,
)
from train.runs.worlds import task_world_of
from train.settings.task import TaskSettings


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Models that have learned, with their descriptions."""
    from stable_baselines3 import DQN, PPO

    folder, layers = tmp_path_factory.mktemp("models"), {"net_arch": [128, 128]}
    given: dict[str, Any] = {"gamma": 0.95, "seed": 0, "policy_kwargs": layers, "device": "cpu"}
    settings: dict[Any, dict[str, Any]] = {
        PPO: {"n_steps": 32, "batch_size": 1024, "n_epochs": 4, "learning_rate": 2e-3},
        DQN: {"learning_rate": 1e-3, "buffer_size": 200_000, "learning_starts": 5_000,
              "batch_size": 512, "train_freq": 1, "target_update_interval": 2_000},
    }  # fmt: skip
    for form, own in settings.items():
        games = make_vector_env("chase", "chaser", 64 if form is PPO else 32, maze="3x3")
        model = form("MlpPolicy", StableBaselinesVecEnv(games), **given, **own)
        model.learn(30_000)
        name = form.__name__.lower()
        save_stable_baselines(model, folder / name, name, TaskSettings(maze="3x3"), "one_hot")
    return {name: folder / f"{name}.zip" for name in ("ppo", "dqn")}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "dqn"])
def test_stable_baselines_learns_and_its_model_is_a_table(
    algorithm: str, models: dict[str, Path]
) -> None:
    from stable_baselines3 import DQN, PPO

    policy = load_stable_baselines(models[algorithm])
    task = policy.task
    contest = contest_of(TaskSettings(maze="3x3"), 100)
    score = contest.score("learned", policy)
    assert score.exact
    assert score.mean_steps < 0.5 * contest.score("random", RandomAgent()).mean_steps
    # What Stable-Baselines3 itself would choose for every pair of cells.
    form: Any = {"ppo": PPO, "dqn": DQN}[algorithm]
    model = form.load(models[algorithm])
    table = policy.action_probabilities(task.mazes[0])
    simulator = Simulator(task, 1)
    for own in range(9):
        for other in range(9):
            if own != other:
                simulator.place([own, other])
                predicted, _ = model.predict(simulator.observe("one_hot", 0), deterministic=True)
                assert table[own, other].argmax() == predicted[0]


@pytest.mark.slow
def test_a_saved_model_is_an_opponent(models: dict[str, Path], tmp_path: Path) -> None:
    flat = {"role": "evader", "maze": "3x3", "frames": 3000, "num_games": 16, "minibatch_size": 64}
    chosen = settings_of(**flat, threads=1, opponent=str(models["ppo"]))
    run = start(RUN, chosen, tmp_path)
    run.train()
    assert run.trainee.optimum.exact
    learned = run.trainee.contest.opponents["chaser"]
    assert isinstance(learned, LearnedPolicy) and not learned.greedy  # as it was learned
    with pytest.raises(ValueError, match="is a policy for 'chaser'"):
        settings_of(maze="3x3", frames=1, opponent=str(models["ppo"]))


def mean_length(task: TaskSettings, policy: Any, episodes: int = 1000) -> float:
    """Mean episode length if all agents play `policy`."""
    simulator = Simulator(task.build(), episodes, 0, auto_restart=False)
    actions = np.zeros((episodes, simulator.num_agents), dtype=np.int32)
    while not simulator.ended.all():
        simulator.act([policy] * simulator.num_agents, actions)
        simulator.step(actions)
    return float(simulator.steps.mean())


@pytest.mark.slow
def test_runners_share_their_network_through_supersuit(tmp_path: Path) -> None:
    supersuit = pytest.importorskip("supersuit")
    from stable_baselines3 import PPO

    task = TaskSettings("race", maze="3x3", num_runners=2, num_goals=2)
    game = race_v0.parallel_env(maze="3x3", num_runners=2, num_goals=2, observation="one_hot")
    games = supersuit.pettingzoo_env_to_vec_env_v1(game)
    envs = supersuit.concat_vec_envs_v1(games, 16, base_class="stable_baselines3")
    given: dict[str, Any] = {"n_steps": 64, "batch_size": 512, "n_epochs": 4, "gamma": 0.95}
    model = PPO("MlpPolicy", envs, learning_rate=2e-3, ent_coef=0.01, device="cpu", **given)
    model.learn(30_000)
    save_stable_baselines(model, tmp_path / "runners.zip", "ppo", task, "one_hot")
    learned = load_stable_baselines(tmp_path / "runners.zip", greedy=False)
    assert mean_length(task, learned) < 0.6 * mean_length(task, RandomAgent())
    assert mean_length(task, NearestGoalRunner()) < mean_length(task, RandomAgent())


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Models saved by Stable-Baselines3 itself."""
    from stable_baselines3 import DQN, PPO
    from torch.nn import ReLU

    folder = tmp_path_factory.mktemp("plain")
    env = StableBaselinesVecEnv(make_vector_env("chase", "chaser", 4, maze="3x3"))
    layers = {"net_arch": {"pi": [32, 16], "vf": [8]}, "activation_fn": ReLU}
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=32, policy_kwargs=layers, seed=0)
    model.save(folder / "ppo.zip")
    DQN("MlpPolicy", env, buffer_size=10, seed=0).save(folder / "dqn.zip")
    return {name: folder / f"{name}.zip" for name in ("ppo", "dqn")}


GIVEN: dict[str, Any] = {"agent": "chaser", "observation": "one_hot"}


@pytest.mark.parametrize("algorithm", ["ppo", "dqn"])
def test_a_model_without_a_description_plays_as_it_does_in_its_library(
    algorithm: str, plain: dict[str, Path]
) -> None:
    from stable_baselines3 import DQN, PPO

    task = make_task("chase", maze="3x3")
    policy = load_stable_baselines(str(plain[algorithm]), task=task, **GIVEN)
    form: Any = {"ppo": PPO, "dqn": DQN}[algorithm]
    model, simulator = form.load(plain[algorithm]), Simulator(task, 500, seed=3)
    seen = simulator.observe("one_hot", 0)
    predicted, _ = model.predict(seen, deterministic=True)
    assert (policy.probabilities(seen).argmax(axis=-1) == predicted).all()


def test_a_model_without_a_description_is_evaluated_ranked_and_an_opponent(
    plain: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ppo, out = str(plain["ppo"]), tmp_path / "evaluation.json"
    own = ["--task", "chase", "--maze", "3x3", "--observation", "one_hot", "--episodes", "20"]
    evaluate([ppo, *own, "--out", str(out)])
    assert "learned, sampled" in capsys.readouterr().out
    assert json.loads(out.read_text())["evaluation"]["exact"]
    models = ["--model-roles", "chaser", "evader", "--model-observations", "one_hot"]
    entries = [ppo, str(plain["dqn"]), "astar"]
    league([*entries, "--maze", "3x3", "--games", "4", *models, "--out", str(tmp_path / "league")])
    assert json.loads((tmp_path / "league" / "league.json").read_text())["chasers"][0] == "ppo.zip"
    chosen = settings_of(
        role="evader", maze="3x3", frames=1, opponent=ppo, opponent_observation="one_hot"
    )
    world = task_world_of(chosen.task)
    assert isinstance(world.opponents["chaser"], LearnedPolicy)


@pytest.mark.parametrize(
    ("maze", "changed", "said"),
    [
        ("3x3", {"observation": None}, "its description file ppo.json is missing; give the task"),
        ("4x4", {}, "its weights do not match observation='one_hot' of chaser in task 'chase'"),
        ("3x3", {"observation": "cells"}, "its weights do not match observation='cells' of chaser"),
    ],
)
def test_models_of_other_games_are_refused(
    maze: str, changed: dict[str, Any], said: str, plain: dict[str, Path]
) -> None:
    with pytest.raises(ValueError) as caught:
        load_stable_baselines(
            plain["ppo"], task=make_task("chase", maze=maze), **{**GIVEN, **changed}
        )
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_models_with_their_descriptions_play_in_a_league(
    models: dict[str, Path], tmp_path: Path
) -> None:
    entries = [str(models["ppo"]), str(models["dqn"]), "astar", "--maze", "3x3", "--games", "4"]
    league([*entries, "--out", str(tmp_path / "league")])
    assert json.loads((tmp_path / "league" / "league.json").read_text())["chasers"][0] == "ppo.zip"


def test_damaged_and_foreign_models_are_refused(models: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    with pytest.raises(ValueError, match="no such file"):
        loaded_policy(MAZE_POLICIES, SAVED, path)
    path.write_bytes(models["ppo"].read_bytes())
    with pytest.raises(ValueError, match="description"):
        loaded_policy(MAZE_POLICIES, SAVED, path)
    described = json.loads(description_of(models["ppo"]).read_text())
    description_of(path).write_text(json.dumps({**described, "observation": "cells"}))
    with pytest.raises(ValueError, match="its weights do not match observation='cells'"):
        loaded_policy(MAZE_POLICIES, SAVED, path)
    description_of(path).write_text(json.dumps(described))
    path.write_bytes(models["ppo"].read_bytes()[:500])
    with pytest.raises(ValueError, match="damaged"):
        loaded_policy(MAZE_POLICIES, SAVED, path)
    with pytest.raises(ValueError, match="run folder"):
        loaded_policy(MAZE_POLICIES, SAVED, tmp_path / "model.pt")
    with pytest.raises(ValueError, match="no distribution"):
        load_stable_baselines(models["dqn"], greedy=False)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("observation", 3, "field observation: a string expected, a whole number found"),
        ("observation", "pixels", "unknown observation 'pixels'"),
        ("task", {"maze": 5}, "maze: a string expected, a whole number found"),
        ("task", "chase", "field task: a table expected, a string found"),
    ],
)
def test_a_description_of_another_form_is_one_line(
    name: str, value: Any, said: str, models: dict[str, Path], tmp_path: Path
) -> None:
    path = tmp_path / "model.zip"
    path.write_bytes(models["ppo"].read_bytes())
    described = json.loads(description_of(models["ppo"]).read_text())
    description_of(path).write_text(json.dumps({**described, name: value}))
    with pytest.raises(ValueError) as caught:
        load_stable_baselines(path)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_no_code_in_a_model_is_run(models: dict[str, Path], tmp_path: Path) -> None:
    import pickle

    class Evil:
        def __reduce__(self) -> Any:
            return (Path.touch, (tmp_path / "owned",))

    path = tmp_path / "model.zip"
    description_of(path).write_text(description_of(models["ppo"]).read_text())
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("policy.pth", pickle.dumps(Evil()))
        file.writestr("data", "{}")
    with pytest.raises(ValueError, match="damaged"):
        load_stable_baselines(path)
    assert not (tmp_path / "owned").exists()


def test_the_drawn_policy_follows_the_distribution(models: dict[str, Path]) -> None:
    policy = load_stable_baselines(models["ppo"], greedy=False)
    table = policy.action_probabilities(policy.task.mazes[0])
    np.testing.assert_allclose(table.sum(axis=-1), 1.0, atol=1e-6)
    assert ((table > 0) & (table < 1)).any()
