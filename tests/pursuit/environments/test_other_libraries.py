"""The examples of docs/guides/other_libraries.md, and the files that it links, run where their
library is installed."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest

import pursuit
from scripted_agents import AStarChaser

PAGE = Path(__file__).parents[3] / "docs" / "guides" / "other_libraries.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS = {
    text.partition("\n")[0]: re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    for text in TEXT.split("\n## ")
}
FILES = {
    Path(file).name: [(PAGE.parent / file).read_text(encoding="utf-8")]
    for file in re.findall(r"\]\((examples/\w+\.py)\)", TEXT)
}
SECTIONS = BLOCKS | FILES

pytestmark = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested")


def run(title: str) -> dict[str, Any]:
    """What the blocks of a section, or a file, leave behind, after those of Gymnasium."""
    page = ModuleType("page")
    sys.modules[page.__name__] = page  # some libraries pickle the classes that they are given
    names = vars(page)
    for block in [*SECTIONS["Gymnasium"], *([] if title == "Gymnasium" else SECTIONS[title])]:
        for needed in re.findall(r"^# needs: (\S+)\n", block, re.MULTILINE):
            pytest.importorskip(needed, exc_type=ImportError)
        exec(compile(block, str(PAGE), "exec"), names)
    return names


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the examples write."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))


def test_every_section_with_examples_has_a_test() -> None:
    tested = re.findall(r'run\("(.+?)"\)', Path(__file__).read_text(encoding="utf-8"))
    assert {title for title, found in SECTIONS.items() if found} == {*tested}


def test_examples_are_short() -> None:
    blocks = [block for section in SECTIONS.values() for block in section]
    assert len(blocks) >= 15
    for block in blocks:
        code = [line for line in block.splitlines() if line.strip() and not line.startswith("#")]
        most = 30 if [block] in FILES.values() else 15
        assert sum(not re.match(r"(import|from) ", line) for line in code) < most, block


def test_gymnasium() -> None:
    names = run("Gymnasium")
    assert set(names["observed"]) == {"observation", "action_mask"}


def test_minari_and_d3rlpy() -> None:
    minari = pytest.importorskip("minari")
    [said] = re.findall(r"`(pursuit\.export_minari.+?)`", TEXT)
    env = gymnasium.make("pursuit/Chaser-v0", maze="3x3")
    exec(said.replace("100", "2"), {"pursuit": pursuit, "env": env, "AStarChaser": AStarChaser})
    assert minari.load_dataset("pursuit/astar-v0").total_episodes == 2
    minari.delete_dataset("pursuit/astar-v0")
    names = run("minari_d3rlpy.py")
    assert minari.load_dataset("pursuit/astar-v0").total_episodes == 100
    assert names["dataset"].size() == 100
    assert names["env"].spec.max_episode_steps == names["games"].unwrapped.task.max_steps
    assert names["offline"].grad_step == 20


def test_the_data_collector_of_minari() -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")  # in the extra `export`
    pytest.importorskip("jax")  # in the extra `create` of Minari
    env = minari.DataCollector(gymnasium.make("pursuit/Maze-v0", maze="3x3", max_steps=5))
    for seed in range(3):
        env.reset(seed=seed)
        while not any(env.step(env.action_space.sample())[2:4]):
            pass
    made = env.create_dataset("pursuit/random-v0", algorithm_name="random", eval_env="CartPole-v1")
    assert made.total_episodes == 3
    assert made.recover_environment().unwrapped.task.max_steps == 5


def test_stable_baselines() -> None:
    names = run("Stable-Baselines3")
    assert names["model"].num_timesteps == 4096
    assert names["scores"][-1].name == "learned" and names["scores"][-1].exact


def test_torchrl() -> None:
    names = run("TorchRL")
    assert names["rollout"].shape == (1024, 20)
    assert run("torchrl_collector.py")["shapes"] == [(8, 200, 1)] * 2


def test_what_torchrl_does_to_the_last_observation_of_games_in_processes() -> None:
    torchrl = pytest.importorskip("torchrl.envs", exc_type=ImportError)
    game = {"maze": "3x3", "num_goals": 1, "max_steps": 20, "categorical_action_encoding": True}
    several = torchrl.GymEnv("pursuit:pursuit/Maze-v0", num_envs=2, **game)
    last = several.rollout(50, break_when_any_done=False)["next"]
    several.close()
    over = last["done"].squeeze(-1)
    assert over.any() and not last["observation"][over].any()


@pytest.mark.parametrize("seed", range(3))
def test_the_captures_counted_in_torchrl(seed: int) -> None:
    torch = pytest.importorskip("torch")
    pytest.importorskip("torchrl")
    blocks = [block for block in SECTIONS["TorchRL"] if "captures" in block]
    names: dict[str, Any] = {}
    torch.manual_seed(seed)
    exec(blocks[0].replace("use_mask=True", f"use_mask=True, seed={seed}"), names)
    # The reward of a capture is -1, of any other step 1.
    paid = (names["played"]["next", "evader", "reward"] == -1).sum(dim=0).flatten()
    assert names["captures"].tolist() == paid.tolist() and paid.sum() > 3


def test_pettingzoo_and_supersuit() -> None:
    names = run("PettingZoo and SuperSuit")
    steady, strict = names["steady"], names["strict"]
    seen, _ = steady.reset(seed=0)
    late = 0
    for _ in range(120):
        if not steady.agents:
            break
        late += not names["game"].agents
        assert [*seen] == steady.possible_agents
        seen, *_ = steady.step(dict.fromkeys(steady.possible_agents, 0))
    assert late == 1  # a fault of SuperSuit 3.11.0, which the page names
    names["skipping"].reset(seed=0)
    names["skipping"].step(1)
    strict.reset(seed=0)
    mask = strict.last()[0]["action_mask"]
    assert not mask.all()
    strict.step(int(np.flatnonzero(mask == 0)[0]))
    assert all(strict.terminations.values())


@pytest.fixture
def local_ray() -> Iterator[None]:
    yield
    pytest.importorskip("ray").shutdown()


def test_rllib_sees_whole_episodes_of_vectorised_games() -> None:
    pytest.importorskip("tree")  # a cheap sign that RLlib is not installed
    pytest.importorskip("ray.rllib", exc_type=ImportError)
    from ray.rllib.algorithms.ppo import PPOConfig
    from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

    game = {"maze": "9x9", "num_goals": 9, "max_steps": 5, "observation": "positions"}
    config = PPOConfig().environment("pursuit:pursuit/Maze-v0", env_config=game)
    config = config.env_runners(
        num_envs_per_env_runner=3, gym_env_vectorize_mode="vector_entry_point"
    )
    episodes = SingleAgentEnvRunner(config=config).sample(num_timesteps=60, random_actions=True)
    assert len(episodes) == 12
    for episode in episodes:
        assert episode.is_done and len(episode) == 5
        first, *others = episode.get_observations().tolist()  # own cell, goals, just collected
        assert all(set(goals) <= set(first[1:]) | {0} for _, *goals, _ in others)


@pytest.mark.slow
@pytest.mark.usefixtures("local_ray")
def test_rllib() -> None:
    names, small = run("RLlib"), {"minibatch_size": 200, "num_epochs": 1}
    for config in (names["single"].env_runners(num_env_runners=1), names["config"]):
        config.training(train_batch_size_per_learner=400, **small)
    names["config"].env_runners(num_env_runners=0)
    for config in (names["single"], names["config"], *run("rllib_masks.py")["configs"]):
        learner = config.build_algo()
        sampled = learner.train()["env_runners"]
        assert sampled["num_env_steps_sampled"] >= 400
        learner.stop()


@pytest.mark.slow
def test_benchmarl(tmp_path: Path) -> None:
    names = run("benchmarl_chase.py")
    from benchmarl.algorithms import MappoConfig
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    how = ExperimentConfig.get_from_yaml()
    how.sampling_device = how.train_device = "cpu"
    how.on_policy_collected_frames_per_batch, how.on_policy_minibatch_size = 200, 100
    how.max_n_iters, how.on_policy_n_minibatch_iters, how.save_folder = 2, 1, str(tmp_path)
    how.evaluation, how.loggers, how.create_json, how.render = False, [], False, False
    experiment = Experiment(
        task=names["task"],
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=how,
    )
    experiment.run()
    assert experiment.total_frames == 400


@pytest.mark.slow
def test_tianshou() -> None:
    names = run("tianshou_dqn.py")
    from tianshou.trainer import OffPolicyTrainerParams

    how = OffPolicyTrainerParams(
        training_collector=names["collector"],
        max_epochs=1,
        epoch_num_steps=200,
        collection_step_num_env_steps=40,
        verbose=False,
        show_progress=False,
    )
    names["learner"].run_training(how)
    assert len(names["collector"].buffer) >= 200
    assert 1 <= sum(names["observed"]["mask"]) < 4
    # Masks reach the learner: of masked games it takes no forbidden action.
    envs = names["DummyVectorEnv"](
        [lambda: names["PettingZooEnv"](names["maze_v0"].env(**names["game"]))] * 2
    )
    buffer = names["VectorReplayBuffer"](400, 2)
    played = names["Collector"](names["learner"], envs, buffer)
    played.reset()
    played.collect(n_step=60)
    batch, _ = buffer.sample(0)
    assert np.asarray(batch.obs.mask)[np.arange(len(batch)), np.asarray(batch.act).ravel()].all()


@pytest.mark.slow
def test_optuna() -> None:
    names = run("optuna_gap.py")
    assert len(names["study"].trials) == 2 and names["study"].best_value >= 0


def test_jax() -> None:
    assert run("JAX")["observed"].shape == (64, 27)


@pytest.mark.slow
def test_agilerl() -> None:
    names = run("agilerl_ippo.py")
    from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
    from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv

    envs = AsyncPettingZooVecEnv([names["make"], names["make"]])
    how = {"max_steps": 128, "evo_steps": 64, "eval_steps": 20, "verbose": False}
    trained, _ = train_multi_agent_on_policy(
        envs, "chase", "IPPO", [names["learner"]], sum_scores=False, **how
    )
    assert len(trained) == 1
    envs.close()
