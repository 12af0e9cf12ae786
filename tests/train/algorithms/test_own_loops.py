"""Learners with a loop of their own: their games, their losses and what runs make of them."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.functional import log_softmax

import train
from train.algorithms import registry
from train.algorithms.learner import Build
from train.algorithms.registry import ALGORITHMS, entry
from train.commands.main import main
from train.environments.batch_env import BatchEnv
from train.environments.vector_env import LearnerVectorEnv
from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import parts_of, settings_of
from train.self_play.parts import self_play_settings_of

pytest.importorskip("stable_baselines3")

pytestmark = pytest.mark.filterwarnings("ignore:frames=")
LOOPS = [name for name, each in ALGORITHMS.items() if each.own_loop]
SIZES = {"num_games": 8, "rollout_steps": 8, "minibatch_size": 32, "width": 16, "threads": 1}
GAMES: dict[str, dict[str, Any]] = {
    "maze": {"task": "maze", "maze": "3x3", "num_goals": 2, "max_steps": 12},
    "planes": {"task": "chase", "maze": "3x3", "observation": "planes", "max_steps": 12},
    "evader": {"task": "chase", "role": "evader", "maze": "3x3", "num_evaders": 2, "max_steps": 12},
    "small game": {"game": "rock_paper_scissors", "max_steps": 12},
    "arm": {"task": "reacher", "joints": 2, "discrete_actions": True, "max_steps": 12},
}


def parts(algorithm: str, game: str, **changed: Any) -> Any:
    flat = {"algorithm": algorithm, "frames": 600, **SIZES, **GAMES[game], **changed}
    return parts_of(settings_of(**flat))


@pytest.mark.parametrize("game", GAMES)
def test_the_games_are_those_of_our_learners(game: str) -> None:
    """The same rewards, episodes and observations for the same actions."""
    one, _ = parts("cleanrl_ppo", game).games()
    two, _ = ours(game)
    assert isinstance(one, LearnerVectorEnv) and isinstance(two, BatchEnv)
    rng = np.random.default_rng(0)
    seen, inputs = one.reset(seed=0)[0], one.interface.inputs
    other = two.reset()
    for _ in range(40):
        assert seen.dtype == np.float32 and one.observation_space.contains(seen)
        np.testing.assert_array_equal(seen, inputs(other["observation"]).numpy())
        actions = rng.integers(one.single_action_space.n, size=8)
        seen, rewards, terminated, truncated, _ = one.step(actions)
        after, other = two.step_tensors(torch.from_numpy(actions))
        for name, own in (
            ("reward", rewards),
            ("terminated", terminated),
            ("truncated", truncated),
        ):
            np.testing.assert_array_equal(after[name].squeeze(-1).numpy(), own)
    for name in ("finished_returns", "finished_lengths"):
        found = [np.concatenate(getattr(env, name)) for env in (one, two)]
        assert len(found[0]) >= 8
        np.testing.assert_array_equal(*found)


def ours(game: str) -> Any:
    sizes = {name: SIZES[name] for name in ("num_games", "rollout_steps", "width", "threads")}
    flat = {"algorithm": "a2c", "curriculum": "none", "frames": 600, **sizes, **GAMES[game]}
    return parts_of(settings_of(**flat)).games()


def test_an_update_of_cleanrl_is_adam_on_the_loss_written_out() -> None:
    """Advantages by their definition, the loss frame by frame, two epochs of one minibatch."""
    torch.manual_seed(0)
    given = parts("cleanrl_ppo", "maze", minibatch_size=64, epochs=2, learning_rate=0.01)
    env, _ = given.games()
    learner: Any = given.algorithm.build(given.hyper, env, Build(seed=1))
    model, hyper, steps = copy.deepcopy(learner.model), given.hyper, []
    step, first = env.step, learner.now.clone()

    def recorded(actions: Any) -> Any:
        found = step(actions)
        steps.append((torch.from_numpy(actions), *map(torch.as_tensor, found[:4])))
        return found

    env.step = recorded
    learner.iterate(0.25)
    seen = torch.stack([first, *(found[1] for found in steps)])
    actions, rewards = (torch.stack([found[n] for found in steps]) for n in (0, 2))
    ended = torch.stack([found[3] | found[4] for found in steps])
    frames = [(t, game) for t in range(8) for game in range(8)]
    with torch.no_grad():
        values, logs = model.value(seen), log_softmax(model.logits(seen[:-1]), -1)
    advantage = {}
    for t, game in frames:
        total, weight = 0.0, 1.0
        for k in range(t, 8):
            bootstrap = 0.0 if ended[k, game] else float(values[k + 1, game])
            total += weight * float(rewards[k, game] + hyper.gamma * bootstrap - values[k, game])
            weight *= hyper.gamma * hyper.gae_lambda
            if ended[k, game]:
                break
        advantage[t, game] = total
    every = np.array([*advantage.values()])
    optimizer = torch.optim.Adam(model.parameters(), lr=0.01 * 0.75, eps=1e-5)
    for _ in range(2):
        loss = torch.zeros(())
        for t, game in frames:
            scaled = (advantage[t, game] - every.mean()) / (every.std() + 1e-8)
            now = log_softmax(model.logits(seen[t, game]), -1)
            action = actions[t, game]
            ratio = (now[action] - logs[t, game, action]).exp()
            gain = torch.minimum(ratio * scaled, ratio.clamp(0.8, 1.2) * scaled)
            target = advantage[t, game] + values[t, game]
            value = model.value(seen[t, game])
            near = values[t, game] + (value - values[t, game]).clamp(-0.2, 0.2)
            error = torch.maximum((value - target) ** 2, (near - target) ** 2)
            entropy = -(now.exp() * now).sum()
            loss = loss + 0.5 * hyper.value_coef * error - gain - hyper.entropy_coef * entropy
        optimizer.zero_grad()
        (loss / len(frames)).backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), hyper.max_grad_norm)
        optimizer.step()
    for own, learned in zip(model.parameters(), learner.model.parameters(), strict=True):
        torch.testing.assert_close(own, learned, rtol=1e-3, atol=2e-5)


def test_stable_baselines_gets_the_settings() -> None:
    changed = {"gamma": 0.9, "gae_lambda": 0.8, "clip": 0.3, "entropy_coef": 0.02, "epochs": 3}
    given = parts("sb3_ppo", "maze", **changed, value_coef=0.7, max_grad_norm=0.4, seed=2**40 + 5)
    env, _ = given.games()
    model = given.algorithm.build(given.hyper, env, given.build).model
    assert (model.n_steps, model.batch_size, model.n_epochs, model.n_envs) == (8, 32, 3, 8)
    assert (model.gamma, model.gae_lambda, model.clip_range(1.0)) == (0.9, 0.8, 0.3)
    assert (model.ent_coef, model.vf_coef, model.max_grad_norm) == (0.02, 0.7, 0.4)
    assert (model.policy.net_arch, model.policy.activation_fn) == ([16, 16], torch.nn.Tanh)
    assert model.seed == 5


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch")
@pytest.mark.parametrize("algorithm", LOOPS)
@pytest.mark.parametrize("game", ["planes", "small game", "arm"])
def test_it_is_trained_saved_evaluated_and_reported(
    algorithm: str, game: str, tmp_path: Path
) -> None:
    settings = settings_of(algorithm=algorithm, frames=600, **SIZES, **GAMES[game])
    run = start(RUN, settings, tmp_path / "run")
    run.train()
    content = run.results(20)
    assert content["precision"] == "float32" and content["curriculum"] == "none"
    assert all(math.isfinite(row["entropy"]) for row in run.rows)
    assert sum(row["episodes"] for row in run.rows) >= 8
    run.lock.release()  # type: ignore[union-attr]
    main(["evaluate", str(run.folder), "--episodes", "20", "--out", str(tmp_path / "found.json")])
    found = json.loads((tmp_path / "found.json").read_text())["evaluation"]
    assert found["mean_steps"] == pytest.approx(content["evaluation"]["mean_steps"])
    main(["report", str(run.folder), "--out", str(tmp_path / "report")])
    assert train.load_policy(run.folder, greedy=False) is not None
    if game == "planes":
        against = {"role": "evader", "opponent": str(run.folder), "maze": "3x3"}
        rival = start(RUN, settings_of(algorithm=algorithm, frames=64, **SIZES, **against),
                      tmp_path / "rival")  # fmt: skip
        rival.train()
        main(["league", str(run.folder), "astar", "--games", "20", "--out", str(tmp_path / "l")])


@pytest.mark.parametrize("algorithm", LOOPS)
def test_what_it_does_not_support_is_refused(algorithm: str) -> None:
    for flat, message in (
        ({"curriculum": "opponent-epsilon"}, "curriculum='opponent-epsilon' is not supported by"),
        ({"network": "convolutions", "observation": "planes"}, "network='convolutions' is not"),
        ({"frame_stack": 2}, "frame_stack=2 is not supported"),
        ({"device": "cuda"}, "device='cuda' is not supported"),
        ({"precision": "bfloat16"}, "precision='bfloat16' is not supported"),
        ({"recurrent": "gru"}, f"recurrent='gru' is not supported by {algorithm}; use ppo or a2c"),
        ({"mask_bumps": True, "stay_action": True}, "does not support the action masks"),
        ({"processes": 2, "num_games": 8}, "with processes=2; use ppo"),
        ({"task": "reacher"}, "does not support continuous actions; .* or discrete_actions=True"),
        ({"minibatch_size": 999}, "minibatch_size=999 is more than a rollout"),
    ):
        game = {} if "task" in flat else {"maze": "3x3"}
        with pytest.raises(ValueError, match=message):
            settings_of(algorithm=algorithm, frames=600, **{**SIZES, **game, **flat})
    with pytest.raises(ValueError, match="does not support self-play; use ppo"):
        self_play_settings_of(algorithm=algorithm, maze="3x3", frames=600)


def test_a_missing_package_is_named_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> str:
        raise registry.PackageNotFoundError(name)

    monkeypatch.setattr(registry, "version", missing)
    with pytest.raises(ImportError, match=r"stable_baselines3 is not .* install 'pursuit\[sb3\]'"):
        settings_of(algorithm="sb3_ppo", maze="3x3", frames=600)
    assert entry("ppo").library.startswith("pursuit ")
