"""Learners with `mask_bumps=True` respect their masks; so do their loaded policies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from masked_games import count_bumps, torchrl_env
from tensordict import TensorDict
from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule
from tensordict.nn import ProbabilisticTensorDictSequential as Sequential
from torchrl.modules import MaskedCategorical
from torchrl.objectives import A2CLoss, ClipPPOLoss
from torchrl_heads import critic_of, ours

from pursuit.environments.single_agent import fill_seats
from pursuit.mazes.maze import load_maze
from pursuit.observations.masks import bump_masks
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import Task, make_task
from scripted_agents import AStarEvader
from train.algorithms.collector import NEXT_MASK
from train.algorithms.dqn import dqn_loss
from train.algorithms.ppo import ppo_loss
from train.algorithms.registry import ALGORITHMS, Build, entry
from train.commands.parse import parse
from train.commands.train import TrainCommand, _defaults
from train.evaluation.games import table_in
from train.kinds import start
from train.networks.actor_critic import ActorCritic
from train.networks.fused_actor_critic import LossCoefficients
from train.networks.layers import Hidden
from train.networks.policy import LearnedPolicy, MazeSeat
from train.networks.q_network import QNetwork
from train.runs.folder import RUN
from train.runs.opponents import load_policy, opponents_of
from train.runs.parts import contest_of, parts_of, settings_of
from train.self_play.parts import self_play_parts, self_play_settings_of
from train.self_play.pool import OpponentPool, PoolPolicy
from train.settings.task import TaskSettings

pytestmark = pytest.mark.filterwarnings("ignore:mask_bumps=True")


# -- learners --------------------------------------------------------------------------------------


def masked_minibatch(network: ActorCritic, env: Any) -> TensorDict:
    """Frames as a learner has them, with actions that are allowed."""
    start = env.reset()
    masks, prepared = start["action_mask"], network.policy_trunk.prepare(start["observation"])
    action = torch.where(masks, torch.rand(masks.shape), -1.0).argmax(-1)
    size = len(action)
    return TensorDict(
        {
            "prepared": prepared,
            "action": action,
            "action_mask": masks,
            "action_log_prob": torch.randn(size) - 1.5,
            "advantage": torch.randn(size, 1),
            "value_target": torch.randn(size, 1),
        },
        batch_size=[size],
    )


def test_the_losses_are_torchrls_with_a_masked_distribution() -> None:
    env = torchrl_env("chaser", games=256)
    torch.manual_seed(0)
    network = ActorCritic(env.player.features, 4, Hidden(16))
    with torch.no_grad():
        network.policy_head.weight.mul_(100)
    minibatch = masked_minibatch(network, env)
    minibatch["policy_hidden"], minibatch["value_hidden"] = network.hidden(minibatch["prepared"])
    actor = Sequential(
        TensorDictModule(network.policy_head, ["policy_hidden"], ["logits"]),
        ProbabilisticTensorDictModule(
            in_keys={"logits": "logits", "mask": "action_mask"},
            out_keys=["action"],
            distribution_class=MaskedCategorical,
            return_log_prob=True,
        ),
    )
    theirs = ClipPPOLoss(
        actor,
        critic_of(network),
        entropy_bonus=False,
        loss_critic_type="l2",
        normalize_advantage=True,
        critic_coeff=0.5,
    )(minibatch)
    found, parts = ppo_loss(network, ours(minibatch), LossCoefficients(0.2, 0.5, 0.0))
    torch.testing.assert_close(
        found, theirs["loss_objective"] + theirs["loss_critic"], rtol=1e-4, atol=1e-5
    )
    logits = network.policy_head(minibatch["policy_hidden"])
    entropies = [
        torch.distributions.Categorical(logits=row[mask]).entropy()
        for row, mask in zip(logits, minibatch["action_mask"], strict=True)
    ]
    torch.testing.assert_close(parts["entropy"], torch.stack(entropies).mean())
    a2c = A2CLoss(actor, critic_of(network), entropy_bonus=False, loss_critic_type="l2")(minibatch)
    raw = LossCoefficients(math.inf, None, 0.0, standardize=False)
    objective = ppo_loss(network, ours(minibatch), raw)[0]
    torch.testing.assert_close(a2c["loss_objective"], objective)


@pytest.mark.parametrize("double", [False, True])
def test_the_next_action_of_dqns_target_is_an_allowed_one(double: bool) -> None:
    env = torchrl_env("chaser", games=128)
    torch.manual_seed(0)
    network, target = (QNetwork(env.player.features, 4, Hidden(16)) for _ in range(2))
    rollout = env.rollout(2)
    batch = TensorDict(
        {
            **{name: rollout[name][:, 0] for name in ("observation", "action")},
            "reward": rollout["next", "reward"][:, 0, 0],
            "next_observation": rollout["next", "observation"][:, 0],
            "terminated": rollout["next", "terminated"][:, 0, 0],
            "steps": torch.ones(128, dtype=torch.int64),
            NEXT_MASK: rollout["next", "action_mask"][:, 0],
        },
        batch_size=[128],
    )
    with torch.no_grad():
        errors, free = [], 0
        values, after = network(batch["observation"]), target(batch["next_observation"])
        chooser = network(batch["next_observation"]) if double else after
        for i in range(128):
            allowed = batch[NEXT_MASK][i].nonzero()[:, 0].tolist()
            best = max(allowed, key=lambda action: float(chooser[i, action]))
            free += best != int(chooser[i].argmax())
            goal = batch["reward"][i] + 0.9 * after[i, best] * ~batch["terminated"][i]
            errors.append(values[i, batch["action"][i]] - goal)
        assert free > 10
        found = dqn_loss(network, target, batch, 0.9, double)[1]
    torch.testing.assert_close(found, torch.stack(errors).abs(), rtol=1e-4, atol=1e-5)


DISCRETE = [
    name
    for name, each in ALGORITHMS.items()
    if "discrete" in each.actions and not each.own_loop and name != "tracked"
]
SMALL: dict[str, dict[str, Any]] = {
    "ppo": {"num_games": 32, "minibatch_size": 128, "kl_target": 0.01},
    "a2c": {"num_games": 32},
    "reinforce": {"num_games": 16},
    "dqn": {"num_games": 32, "batch_size": 64, "learning_starts": 100},
    "q_learning": {"num_games": 32},
    "cross_entropy": {"num_games": 32, "population": 8, "elite_share": 0.25},
    "mmd": {"num_games": 32, "minibatch_size": 128},
    "rnad": {"num_games": 32, "minibatch_size": 128},
    "nfsp": {"num_games": 32, "batch_size": 64, "learning_starts": 100, "anticipatory": 0.5},
    "ippo": {"num_games": 32, "minibatch_size": 128},
    "mappo": {"num_games": 32, "minibatch_size": 128},
    "iql": {"num_games": 32, "batch_size": 64, "learning_starts": 100},
    "vdn": {"num_games": 32, "batch_size": 64, "learning_starts": 100},
    "qmix": {"num_games": 32, "batch_size": 64, "learning_starts": 100},
}


@pytest.mark.parametrize("name", DISCRETE)
def test_no_learner_ever_bumps_while_it_learns_or_plays(name: str) -> None:
    torch.manual_seed(0)
    algorithm = entry(name)
    small: Any = {"width": 16, **SMALL[name]} if name != "q_learning" else SMALL[name]
    settings: Any = algorithm.settings(**small)
    env = torchrl_env("chaser", games=settings.num_games, maze="4x4-tree", max_steps=30)
    counted = count_bumps(env.simulator, 0)
    learner = algorithm.build(settings, env, Build(seed=1))
    for progress in (0.0, 0.4, 1.0):
        figures = learner.iterate(progress)
        assert all(np.isfinite(value) for value in figures.values())
    learner.close()
    assert counted["steps"] > 300 and counted["bumps"] == 0
    task = env.simulator.task
    allowed = bump_masks(task.mazes[0], 4)
    state = learner.state_dict()
    for greedy in (True, False)[: 1 + algorithm.learns_distribution]:
        for policy in (
            learner.policy(greedy),
            algorithm.load(settings, env.player, state, greedy),
        ):
            table = table_in(task, policy)
            assert not (table * ~allowed[:, None]).any()
            np.testing.assert_allclose(table.sum(axis=2), 1.0)
            check_play(task, policy)


def check_play(task: Task, policy: Any) -> None:
    """A policy never bumps as the chaser."""
    simulator = Simulator(task, 64, auto_restart=False)
    counted = count_bumps(simulator, 0)
    _, policies = fill_seats(task, "chaser", {"evader": AStarEvader(0.2)})
    policies[0] = policy
    actions = np.zeros((64, 2), dtype=np.int32)
    for _ in range(20):
        simulator.act(policies, actions)
        simulator.step(actions)
    assert counted["steps"] > 200 and counted["bumps"] == 0


def test_masked_learning_reaches_the_masked_optimum(tmp_path: Path) -> None:
    """3x3, where masks cost 3.8 of 8.7 steps; and no masks reach the other one."""
    for mask, optimum in ((True, 8.73), (False, 4.93)):
        flat = {"algorithm": "q_learning", "maze": "3x3", "mask_bumps": mask, "threads": 1}
        run = start(RUN, settings_of(**flat, frames=300_000), tmp_path / str(mask))
        run.train()
        content = run.results(100)
        assert content["evaluation"]["mean_steps"] == pytest.approx(optimum, rel=0.01)
        scores = {score["name"]: score["mean_steps"] for score in content["scores"]}
        assert scores["optimal"] == pytest.approx(4.93, abs=0.01)
        assert ("optimal with masks" in scores) == mask
        reloaded = load_policy(tmp_path / str(mask))
        again = run.trainee.contest.score("learned", reloaded).mean_steps
        assert again == content["evaluation"]["mean_steps"]


# -- settings --------------------------------------------------------------------------------------


@pytest.fixture
def masked_run(tmp_path: Path) -> Iterator[Path]:
    """The folder of a run of PPO that has learned next to nothing."""
    flat = {"maze": "3x3", "mask_bumps": True, "num_games": 64, "minibatch_size": 256}
    run = start(RUN, settings_of(**flat, frames=1000, threads=1), tmp_path / "run")
    run.train()
    yield tmp_path / "run"


def test_loaded_policies_use_the_masks_of_their_training(masked_run: Path) -> None:
    allowed = bump_masks(load_maze("3x3"), 4)
    for greedy in (True, False):
        policy: Any = load_policy(masked_run, greedy)
        assert policy.seat.mask_bumps
        assert not (policy.action_probabilities(load_maze("3x3")) * ~allowed[:, None]).any()
    task = make_task("chase", maze="3x3")
    opponents = opponents_of(task, "evader", str(masked_run), 0.0)
    opponent: Any = opponents["chaser"]
    assert opponent.seat.mask_bumps
    # In a pool, where each game has another opponent, games keep their own masks.
    free = LearnedPolicy(opponent.network, MazeSeat(task, "chaser"), greedy=False)
    masked = LearnedPolicy(opponent.network, opponent.seat, greedy=False)
    pool = OpponentPool(masked_run, free, 2, lambda state: free)
    pool.add_scripted("masked", masked)
    mixed = PoolPolicy(pool, 64)
    mixed.opponents[::2] = 1
    simulator = Simulator(task, 64, auto_restart=False)
    actions = np.zeros((64, 2), dtype=np.int32)
    bumps = np.zeros(64, dtype=int)
    for _ in range(30):
        simulator.act([mixed, AStarEvader(0.2)], actions)
        fits = allowed[simulator.positions[:, 0], actions[:, 0]]
        bumps += ~fits & ~simulator.ended
        simulator.step(actions)
    assert bumps[1::2].sum() > 20 and bumps[::2].sum() == 0


def test_the_command_line_takes_the_flags_of_a_task() -> None:
    for given in (["--mask-bumps"], ["--stay-action"], ["--stay-action", "--mask-bumps"], []):
        default = _defaults(given)
        form: Any = TrainCommand[type(default.settings.hyper)]  # type: ignore[misc]
        task = parse(form, given, "train", default).settings.task
        assert task.mask_bumps == ("--mask-bumps" in given)
        assert task.stay_action == ("--stay-action" in given)


def test_every_kind_of_run_has_the_setting() -> None:
    chosen = settings_of(maze="3x3", mask_bumps=True, seconds=1)
    assert parts_of(chosen).seat.mask_bumps and parts_of(chosen).world.contest(2).mask_bumps
    assert not parts_of(settings_of(maze="3x3", seconds=1)).seat.mask_bumps
    assert contest_of(TaskSettings(mask_bumps=True), 2).mask_bumps
    taught = settings_of(task="maze", mask_bumps=True, curriculum="maze-size", seconds=1)
    assert parts_of(taught).seat.mask_bumps
    pair = self_play_parts(self_play_settings_of(maze="3x3", mask_bumps=True, seconds=1))
    assert all(side.seat.mask_bumps for side in pair.sides.values())
