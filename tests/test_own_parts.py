"""A user's own parts come in by one door: by name, in every environment and in training."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from command_errors import error_of
from conformance import check_parallel_env

import pursuit
from pursuit import Rewards, Simulator, chase_v0, make_task
from pursuit import plugins as parts
from pursuit.observations.observations import Encoder
from pursuit.plugins import Registry, sha256_of
from pursuit.tasks.rewards import REWARDS, rewards_from_text, rewards_text
from scripted_agents import AStarEvader
from scripted_agents.environments import make_env, make_vector_env
from scripted_agents.exact.references import is_table_in
from train.commands.main import main
from train.environments.simulator_env import SimulatorEnv
from train.experiments.rows import read_run
from train.kinds import resume, start
from train.networks.policy import MazeSeat, sees_cells_only
from train.runs.folder import RUN, SELF_PLAY, load_checkpoint
from train.runs.parts import contest_of, parts_of, settings_of
from train.runs.provenance import recorded_parts
from train.runs.single import SingleAgent
from train.self_play.league import enter, play_league
from train.self_play.parts import self_play_parts, self_play_settings_of
from train.self_play.pool import weights
from train.settings.self_play import SelfPlaySettings
from train.settings.task import TaskSettings

OWN = Path(__file__).with_name("own_parts")
ARRAYS = (
    "positions", "active", "events", "goals", "steps", "maze_index", "streams", "rewards",
    "returns", "terminated", "truncated", "episode_returns", "final_positions", "episode_lengths",
)  # fmt: skip


@pytest.fixture(autouse=True)
def own(monkeypatch: pytest.MonkeyPatch) -> None:
    """The user's module can be imported; nothing is allowed, or was named before."""
    monkeypatch.syspath_prepend(str(OWN))
    monkeypatch.setattr(parts, "_allowed", set())
    monkeypatch.setattr(parts, "_named", set())


# -- rewards ---------------------------------------------------------------------------------------


def as_the_rule_book(before: Any, actions: Any, after: Any) -> Any:
    return after.rewards


@pytest.mark.parametrize(
    ("name", "teams", "auto_restart"),
    [
        ("chase", {}, True),
        ("chase", {"num_evaders": 2}, True),
        ("chase", {"num_evaders": 2}, False),
        ("maze", {}, False),
    ],
)
def test_a_reward_function_changes_nothing_but_the_rewards(
    name: str, teams: dict[str, int], auto_restart: bool
) -> None:
    """Bit for bit the games of the fused kernel, where the function pays what that does."""
    settings: dict[str, Any] = {"maze": ["5x5", "3x3"], "max_steps": 12, **teams}
    fused, paid = (
        Simulator(make_task(name, **settings, **more), 32, 5, auto_restart=auto_restart)
        for more in ({}, {"rewards": as_the_rule_book})
    )
    rng = np.random.default_rng(0)
    for step in range(40):
        actions = rng.integers(4, size=(32, fused.num_agents), dtype=np.int32)
        for simulator in (fused, paid):
            simulator.step(actions)
        for array in ARRAYS:
            np.testing.assert_array_equal(getattr(fused, array), getattr(paid, array), array)
        if not auto_restart and step % 5 == 0:
            for simulator in (fused, paid):
                simulator.reset(games=simulator.ended)
    bad = np.full((32, fused.num_agents), 9)
    flags = paid.terminated.copy(), paid.truncated.copy()
    with pytest.raises(ValueError, match="out of range"):
        paid.step(bad)
    np.testing.assert_array_equal(flags, (paid.terminated, paid.truncated))


def test_starts_that_are_counted_out_are_the_same_with_a_reward_function() -> None:
    """Where drawing finds no start, one is chosen outside the kernels: on both ways of stepping."""
    tasks = [
        make_task("chase", maze="15x15", min_start_distance=28, max_steps=3, rewards=rewards)
        for rewards in ("goal", lambda before, actions, after: np.ones(actions.shape))
    ]
    paid, plain = (Simulator(task, 16, seed=1) for task in reversed(tasks))
    for _ in range(12):
        for games in (paid, plain):
            games.step(np.zeros((16, 2), dtype=np.int32))
        assert (paid.positions == plain.positions).all() and (paid.steps == plain.steps).all()
        assert (paid.returns == paid.steps[:, None]).all()


def test_the_functions_payment_reaches_every_environment() -> None:
    """-1 for whoever changes the cell, compiled by Numba: the same in all of them."""
    name = "my_parts:tired"
    parallel = chase_v0.parallel_env(maze="3x3", rewards=name)
    parallel.reset(seed=1)
    cells = parallel.simulator.positions[0].copy()
    _, rewards, *_ = parallel.step({"chaser_0": 0, "evader_0": 1})
    moved = parallel.simulator.positions[0] != cells
    assert list(rewards.values()) == (-1.0 * moved).tolist()

    single = make_env("chase", "chaser", maze="3x3", rewards=name)
    many = make_vector_env("chase", "chaser", num_envs=4, maze="3x3", rewards=name)
    for env in (single, many):
        env.reset(seed=1)
        before = env.simulator.positions[:, 0].copy()
        step: Any = env.step
        reward = step(np.ones(4, dtype=int) if env is many else 1)[1]
        assert np.all(reward == -1.0 * (env.simulator.positions[:, 0] != before))

    task = make_task("chase", maze="3x3", rewards=name)
    simulator = Simulator(task, 8, auto_restart=False)
    games = SimulatorEnv(simulator, MazeSeat(task, "chaser"), [None, *many.policies[1:]])
    before = simulator.positions[:, 0].copy()
    after, _ = games.step_and_maybe_reset(games.reset().set("action", torch.ones(8).long()))
    moved = simulator.positions[:, 0] != before
    assert (after["next", "reward"][:, 0].numpy() == -1.0 * moved).all()
    for algorithm in ("q_learning", "ppo"):
        settings = settings_of(
            algorithm=algorithm, maze="2x2", rewards=name, frames=64, num_games=64,
            **({"minibatch_size": 64} if algorithm == "ppo" else {}),
        )  # fmt: skip
        assert settings.task.rewards == name


def test_stable_baselines_sees_it_as_well() -> None:
    pytest.importorskip("stable_baselines3")
    from pursuit.environments.stable_baselines import StableBaselinesVecEnv

    inner = make_vector_env("chase", "chaser", 4, maze="3x3", rewards="my_parts:tired")
    envs = StableBaselinesVecEnv(inner)
    envs.seed(1)  # so that no episode ends in the first step
    envs.reset()
    before = inner.simulator.positions[:, 0].copy()
    _, rewards, _, _ = envs.step(np.ones(4, dtype=int))
    assert (rewards == -1.0 * (inner.simulator.positions[:, 0] != before)).all()


def test_whoever_has_left_is_paid_nothing() -> None:
    task = make_task("chase", maze="2x2", num_evaders=2, rewards=lambda b, a, c: np.ones(a.shape))
    simulator = Simulator(task, 64, auto_restart=False)
    rng = np.random.default_rng(0)
    for _ in range(30):
        there, over = simulator.active.copy(), simulator.ended
        simulator.step(rng.integers(4, size=(64, 3)))
        assert (simulator.rewards == (there & ~over[:, None])).all()
    assert (simulator.active == 0).any()


@pytest.mark.parametrize(
    ("paid", "message"),
    [
        (lambda b, a, c: np.zeros(3), r"<lambda> returned float64 of shape \(3,\); it must"),
        (lambda b, a, c: np.where(np.c_[:4] == 2, np.nan, 0.0 * a), "agent 0 of game 2"),
        (lambda b, a, c: 1e300 * np.ones(a.shape), "returned 1e.300 for agent 0 of game 0"),
        (lambda b, a, c: "much", "must return numbers"),
    ],
)
def test_payments_that_are_none_are_refused_with_name_and_game(paid: Any, message: str) -> None:
    simulator = Simulator(make_task("chase", maze="3x3", rewards=paid), 4)
    with pytest.raises(ValueError, match=message):
        simulator.step(np.zeros((4, 2), dtype=np.int32))


def test_rewards_that_are_none_are_refused_at_birth() -> None:
    for given in ({"chaser": as_the_rule_book}, 5, type, [Rewards()]):
        with pytest.raises(ValueError, match="rewards"):
            make_task("chase", rewards=given)


def test_coefficients_are_read_from_text_and_tables() -> None:
    assert rewards_from_text("chaser.step=-0.1, evader.capture=-2") == {
        "chaser": Rewards(step=-0.1),
        "evader": Rewards(capture=-2.0),
    }
    everybody = rewards_from_text("step=-1,chaser.step=-2,capture=1")
    assert everybody["chaser"] == Rewards(step=-2, capture=1)
    assert everybody["runner"] == Rewards(step=-1, capture=1)
    for text in ("step=-0.1,capture=2,distance=-0.01", "chaser.step=1,chaser.on_completion=true"):
        assert rewards_text(text) == text == rewards_text(rewards_text(text))
    assert rewards_text({"capture": 2, "step": -0.1}) == "step=-0.1,capture=2"
    assert rewards_text({"evader": {"step": 1.0}}) == "evader.step=1"
    for text, told in {
        "stepp=1": "unknown 'stepp'; give step, capture",
        "hunter.step=1": "unknown 'hunter.step'",
        "step=much": "'step=much'; give a number",
        "step=1,step=2": "'step' is given twice",
        "on_completion=1": "give true or false",
        "step=nan": "step=nan; it is finite",
        "=": "rewards='='",
    }.items():
        with pytest.raises(ValueError, match=told):
            TaskSettings(rewards=text)


def test_coefficients_reach_training() -> None:
    for given in ("chaser.step=-0.5,chaser.capture=3", {"chaser": {"step": -0.5, "capture": 3}}):
        settings = settings_of(maze="3x3", seconds=1.0, rewards=given)
        assert settings.task.rewards == "chaser.step=-0.5,chaser.capture=3"
        task = contest_of(settings.task, 2).task
        assert task.role_rewards["chaser"] == Rewards(step=-0.5, capture=3.0)
    assert make_task("chase", rewards="my_parts:THRIFTY").role_rewards["chaser"].capture == 2.0


# -- observations ----------------------------------------------------------------------------------


def test_an_observation_brings_its_space_to_every_environment() -> None:
    name = "my_parts:Compass"
    check_parallel_env(chase_v0.parallel_env(maze="3x3", observation=name, num_evaders=2))
    single = make_env("maze", "runner", observation=name, maze="3x3", num_goals=2)
    assert single.reset(seed=0)[0] in single.observation_space
    many = gymnasium.make_vec("pursuit/Chaser-v0", num_envs=3, maze="3x3", observation=name)
    seen, _ = many.reset(seed=0)
    assert seen.shape == (3, 4) and seen in many.observation_space
    own = sys.modules["my_parts"].Compass
    task = make_task("chase", maze="3x3")
    games = Simulator(task, 5)
    assert (games.observe(name) == Encoder(task, own()).encode(games.games)).all()
    out = np.zeros((5, 2, 4), dtype=np.float32)
    assert (games.observe(name, out=out) == games.observe(own)).all()


SMALL: dict[str, Any] = {
    "ppo": {"minibatch_size": 64},
    "dqn": {"learning_starts": 64, "batch_size": 64},
}


@pytest.mark.parametrize(
    ("algorithm", "observation"), [("ppo", "my_parts:Compass"), ("dqn", "my_parts:Map")]
)
def test_networks_learn_from_it(observation: str, algorithm: str) -> None:
    settings = settings_of(
        maze="3x3", observation=observation, algorithm=algorithm, seconds=1.0, num_games=32,
        **SMALL[algorithm],
    )  # fmt: skip
    trainee = SingleAgent(parts_of(settings), "greedy")
    table = trainee.policy.action_probabilities(pursuit.load_maze("3x3"))  # of all pairs of cells
    before = [weight.clone() for weight in trainee.learner.network.parameters()]
    trainee.iterate(SimpleNamespace(progress=0.0, scheduled=0.0, seconds=0.0))
    after = trainee.learner.network.parameters()
    assert not all(torch.equal(*pair) for pair in zip(before, after, strict=True))
    assert table.shape == (9, 9, 4)
    kind = "planes" if observation.endswith("Map") else "flat"
    assert trainee.parts.seat.features.kind == kind
    trainee.close()


NETWORK_RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    "ppo": ("my_parts:picture", {"observation": "planes", "minibatch_size": 64}),
    "dqn": ("my_parts:Words", {"learning_starts": 64, "batch_size": 64}),
    "a2c": ("my_parts:picture", {"observation": "window:2", "recurrent": "gru"}),
    "reinforce": ("my_parts:picture", {"observation": "my_parts:Map"}),
    "sac": ("my_parts:straight", {"task": "reacher", "learning_starts": 64, "batch_size": 64}),
}


@pytest.mark.parametrize("algorithm", NETWORK_RUNS)
def test_an_own_network_is_one_file(
    algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It learns, its checkpoint goes on and is evaluated; its file is trusted by name only."""
    network, more = NETWORK_RUNS[algorithm]
    flat = {"algorithm": algorithm, "network": network, "num_games": 32, "frames": 1500, "width": 8}
    flat |= {"max_steps": 20, **({} if "task" in more else {"maze": "3x3"}), **more}
    if algorithm in ("ppo", "a2c", "dqn", "sac"):
        flat["rollout_steps"] = 8
    run = start(RUN, settings_of(**flat), tmp_path / "run")
    run.train()
    learner = SingleAgent(parts_of(settings_of(**flat)), "greedy").learner
    before = learner.network.state_dict()
    after = load_checkpoint(tmp_path / "run")["trainee"]["learner"]["network"]
    assert before.keys() == after.keys() and any(".first.network." in name for name in after)
    main(["evaluate", str(tmp_path / "run"), "--episodes", "20"])
    assert more.get("task", "chase") in capsys.readouterr().out
    parts._named.clear()
    with pytest.raises(ValueError, match="add --allow my_parts"):
        resume(tmp_path / "run", RUN)


def test_networks_that_are_none_are_refused() -> None:
    flat: dict[str, Any] = {"maze": "3x3", "frames": 1000}
    with pytest.raises(ValueError, match=r"unknown network 'mpl'.*did you mean 'mlp'"):
        settings_of(**flat, network="mpl")
    for name, told in {
        "my_parts:shaped": "takes|missing|made",
        "my_parts:too_wide": r"returned \(2, 9\) for 2 observations; .*\(2, 8\)",
        "my_parts:no_module": "is not a torch.nn.Module",
        "my_parts:straight": r"failed for torch.int64 .*observation index.*--observation planes",
    }.items():
        with pytest.raises(ValueError, match=told):
            SingleAgent(parts_of(settings_of(**flat, network=name, width=8)), "greedy")
    with pytest.raises(ValueError, match="q_learning has a table over states instead of a network"):
        settings_of(**flat, algorithm="q_learning", network="my_parts:picture")


def test_self_play_takes_an_own_network_and_the_recurrent_one_has_a_memory() -> None:
    flat: dict[str, Any] = {"maze": "3x3", "frames": 1000}
    sides = self_play_parts(self_play_settings_of(**flat, network="my_parts:Words")).sides
    assert {sides[role].seat.features.network for role in sides} == {"my_parts:Words"}
    assert settings_of(**flat, network="recurrent") == settings_of(**flat, recurrent="gru")
    pair = self_play_settings_of(**flat, network="recurrent")
    assert pair.side("chaser").hyper.recurrent == "gru"


def test_what_sees_the_time_is_no_table() -> None:
    """Exact values are of policies that are functions of the cells."""
    task = make_task("chase", maze="3x3")
    assert sees_cells_only(task, "my_parts:Compass") and not sees_cells_only(task, "my_parts:Clock")
    network: Any = SimpleNamespace()
    for name, table in (("my_parts:Compass", True), ("my_parts:Clock", False)):
        policy = MazeSeat(task, "chaser", name).policy(network)
        assert isinstance(policy, pursuit.simulator.policy.TabularPolicy) == table
        assert isinstance(policy, pursuit.simulator.policy.DistributionPolicy) == table
    team = make_task("chase", maze="3x3", num_chasers=2)
    assert sees_cells_only(team, "my_parts:Compass") and not sees_cells_only(team, "my_parts:Clock")


class Wrong:
    """Gives what its space does not say."""

    def space(self, task: Any) -> Any:
        return gymnasium.spaces.Box(0, 1, (3,))

    def encode(self, task: Any, games: Any, seats: Any) -> Any:
        return np.zeros((len(games.steps), len(seats), 2))


class Spaceless(Wrong):
    def space(self, task: Any) -> Any:
        return gymnasium.spaces.Discrete(3)


class Writing(Wrong):
    def encode(self, task: Any, games: Any, seats: Any) -> Any:
        games.positions[:] = 0


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (Wrong, r"of shape \(1, 2, 2\); its space needs float32"),
        (Spaceless, "it must be a gymnasium.spaces.Box"),
        (Writing, "read-only"),
        (5, "observation=5; it must be an object or class with space"),
        ("onehot", "unknown observation 'onehot'.*did you mean 'one_hot'"),
    ],
)
def test_observations_that_are_none_are_refused(observation: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Simulator(make_task("chase", maze="3x3")).observe(observation)


# -- policies, curricula, algorithms ---------------------------------------------------------------


def test_an_opponent_is_named_wherever_one_plays() -> None:
    name = "my_parts:Sneaky"
    own = type(make_env("chase", "chaser", maze="3x3", opponent=name).policies[1])
    assert own.__name__ == "Sneaky"
    contest = contest_of(TaskSettings(maze="3x3", opponent=name), 10)
    assert "with Sneaky" in contest.line() and not contest.is_table_duel
    assert contest.baselines()[0].name == "random"
    flat: dict[str, Any] = {"maze": "3x3", "frames": 1000}
    made = self_play_parts(self_play_settings_of(**flat, evader=name))
    assert isinstance(made.frozen["evader"], own)
    made = self_play_parts(self_play_settings_of(**flat, members=["astar", name]))
    assert (name, "evader") in made.scripted
    assert (name, "chaser") not in made.scripted  # `roles` says that it is an evader
    task, entries = enter(["astar", name], "3x3")
    assert [(e.name, e.role) for e in entries[2:]] == [(name, "evader")]
    assert play_league(task, entries, 4, 0).payoff.shape == (1, 2)
    with pytest.raises(ValueError, match="plays evader, not 'chaser'"):
        make_env("chase", "evader", maze="3x3", opponent=name)
    with pytest.raises(ValueError, match=r"unknown policy 'sneaky'; one of astar, .*equilibrium"):
        make_env("chase", "evader", maze="3x3", opponent="sneaky")
    with pytest.raises(ValueError, match=r"policy 'os.path:join'\(task, role\) raised TypeError"):
        make_env("chase", "evader", maze="3x3", opponent="os.path:join")


OWN_RUN: dict[str, Any] = {
    "maze": "3x3",
    "rewards": "my_parts:shaped",
    "observation": "my_parts:Compass",
    "opponent": "my_parts:Sneaky",
    "curriculum": "my_parts:ALTERNATING",
    "axis": "my_parts:FAR",
    "algorithm": "my_parts:SARSA",
    "num_games": 32,
    "period": 2,
    "frames": 4 * 16 * 32,
    "max_steps": 20,
    "threads": 1,
}


def test_a_run_of_own_parts_alone_ends_where_one_that_was_resumed_does(tmp_path: Path) -> None:
    settings = settings_of(**OWN_RUN)
    assert settings.hyper.epsilon_start == 0.1 and settings.curriculum_settings.num_stages == 8
    whole = start(RUN, settings, tmp_path / "whole")
    whole.train()
    assert whole.results(10)["algorithm"] == "my_parts:SARSA"
    row = read_run(tmp_path / "whole")[0]
    assert (row["algorithm"], row["epsilon_start"]) == ("my_parts:SARSA", 0.1)
    recorded = recorded_parts(tmp_path / "whole" / "config.json")
    assert recorded["algorithm"]["sha256"] == sha256_of("my_parts")
    assert {row["reason"] for row in whole.trainee.teacher.rows} >= {"turn after 2 updates"}
    half = start(RUN, settings, tmp_path / "half")
    half.train(lambda run, row: setattr(run, "stopped", run.progress >= 0.5))
    again = resume(tmp_path / "half", RUN)
    assert again.progress == 0.5
    again.train()
    ends = [load_checkpoint(tmp_path / name)["trainee"]["learner"] for name in ("whole", "half")]
    for name, weight in ends[0]["network"].items():
        assert torch.equal(weight, ends[1]["network"][name])


def test_an_axis_of_ones_own_is_a_schedule_too() -> None:
    settings = settings_of(maze="3x3", curriculum="my_parts:FAR", schedule="cosine", frames=100)
    assert settings.curriculum_settings.schedule == "cosine"
    with pytest.raises(ValueError, match=r"unknown setting 'periode'.*did you mean 'period'"):
        settings_of(**{**OWN_RUN, "periode": 3})


PAIR: dict[str, Any] = {"maze": "2x2", "num_games": 16, "rollout_steps": 4, "width": 8}
PAIR |= {"minibatch_size": 64}


def test_opponents_are_drawn_by_a_rule_of_ones_own(tmp_path: Path) -> None:
    flat = {**PAIR, "snapshots": 3, "frames": 640}
    settings = self_play_settings_of(**flat, sampling="my_parts:the_oldest")
    run = start(SELF_PLAY, settings, tmp_path / "pair")
    run.train()
    pool = run.trainee.pools["evader"]
    found = weights(pool, "my_parts:the_oldest", payoffs=run.trainee.payoffs)
    assert len(pool.members) >= 3 and found.tolist() == [0.5, 0.5] + [0.0] * (len(found) - 2)
    run.lock.release()
    pool.members = pool.members[:1]
    wrong = [-1.0], [float("nan")], [0.0], [0.5, 0.5], None, {"latest": 1.0}, ["all"], ["1.0"]
    for value in (*wrong, "1", [1 + 0j], np.array([1 + 1j]), np.array(["1"]), np.array([b"1"])):
        sys.modules["my_parts"].RETURNED[0] = value
        told = f"sampling 'my_parts:wrong' returned {value!r} for 1 members of the pool; return one"
        with pytest.raises(ValueError, match=re.escape(told)):
            weights(pool, "my_parts:wrong")
    sys.modules["my_parts"].RETURNED.clear()
    told = r"sampling 'my_parts:wrong' raised IndexError: .* \(my_parts.py:\d+\)"
    with pytest.raises(ValueError, match=told):
        weights(pool, "my_parts:wrong")
    sys.modules["my_parts"].RETURNED.append(None)
    told = r"'my_parts:of_the_pool' .*must be a function \(pool, payoffs, progress\) -> prob"
    with pytest.raises(ValueError, match=told):
        self_play_settings_of(**flat, sampling="my_parts:of_the_pool")
    with pytest.raises(ValueError, match=r"unknown sampling 'oldest' .*one of latest, window"):
        self_play_settings_of(**flat, sampling="oldest")


def test_rules_use_payoffs_and_progress_also_after_resuming(tmp_path: Path) -> None:
    flat = {**PAIR, "snapshots": 6, "frames": 2560, "members": ["astar"]}
    settings = self_play_settings_of(**flat, sampling="my_parts:hardest")
    whole = start(SELF_PLAY, settings, tmp_path / "whole")
    whole.train()
    payoffs, side = whole.trainee.payoffs, whole.trainee.sides["chaser"]
    (policy,), (shares,) = side.opponents.policies.values(), side.opponents.shares.values()
    pool = policy.pool
    best = payoffs.names("evader")[payoffs.matrix().mean(axis=0).argmax()]
    assert shares.tolist() == [float(name == best) for name in pool.names]
    assert "latest" not in payoffs.names("chaser") and "astar" in payoffs.names("chaser")
    with pytest.raises(ValueError, match="unknown evader with payoffs 'latest'"):
        payoffs("astar", "latest")
    half = start(SELF_PLAY, settings, tmp_path / "half")
    half.train(lambda run, row: setattr(run, "stopped", run.progress >= 0.7))
    again = resume(tmp_path / "half", SELF_PLAY)
    again.train()
    assert again.trainee.payoffs.known == payoffs.known
    ends = [run.trainee.sides["chaser"].snapshot()["network"] for run in (whole, again)]
    assert all(torch.equal(weight, ends[1][name]) for name, weight in ends[0].items())


# -- a command -------------------------------------------------------------------------------------


def test_a_command_of_ones_own_is_called_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["my_parts:greet", "all", "--in", "here"])
    assert capsys.readouterr().out == "greetings to all --in here\n"
    points = {"pursuit.commands": {"greet": "my_parts:greet"}}
    monkeypatch.setattr(parts, "installed", lambda group: points.get(group, {}))
    main(["greet"])
    assert capsys.readouterr().out == "greetings to\n"
    assert "no 'greetings' (did you mean 'greet'?)" in error_of(capsys, "my_parts:greetings")


# -- the registry ----------------------------------------------------------------------------------


def test_names_that_lead_nowhere_say_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_parts.py").write_text("import nowhere_at_all\n")
    (tmp_path / "leaving_parts.py").write_text("raise SystemExit('gone')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    for name, told in {
        "gaol": r"unknown rewards 'gaol' \(did you mean 'goal'\?\); one of goal, .*; or a custom",
        "my_parts:shapes": "module my_parts has no 'shapes' .did you mean 'shaped'",
        "my_parts:Compass": "must be a function",
        "no_parts:f": "module no_parts cannot be imported .ModuleNotFoundError: No module",
        "broken_parts:f": "broken_parts cannot be imported .ModuleNotFoundError.*nowhere_at_all",
        "leaving_parts:f": "cannot be imported .SystemExit: gone",
    }.items():
        with pytest.raises(ValueError, match=told) as error:
            make_task("chase", rewards=name)
        assert "\n" not in str(error.value)


def test_installed_packages_bring_parts_by_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    points = {"pursuit.rewards": {"shaped": "my_parts:shaped"}}
    monkeypatch.setattr(parts, "installed", lambda group: points.get(group, {}))
    task = make_task("chase", maze="3x3", rewards="shaped")
    assert task.reward_function is sys.modules["my_parts"].shaped
    assert REWARDS.origin("shaped") == "my_parts" and REWARDS.origin("goal") is None


def test_parts_are_registered_under_names_of_their_own() -> None:
    registry: Registry[Any] = Registry("thing", "a function", callable, ours=("first",))
    registry.register("second", len)
    assert registry.names() == ("first", "second") and registry.get("second") is len
    assert registry.origin("second") == __name__
    for name, part, told in (
        ("second", len, "'second' is already registered"),
        ("a:b", len, "without a colon"),
        ("third", 3, "thing 'third' is 3; it must be a function"),
    ):
        with pytest.raises(ValueError, match=told):
            registry.register(name, part)


def test_settings_take_the_name_of_a_function_not_the_function() -> None:
    def hard_half(pool: Any) -> list[float]:
        return [1.0] * len(pool.members)

    with pytest.raises(ValueError, match=r"sampling=.*; give its name, 'package.module:hard_half'"):
        self_play_settings_of(maze="3x3", sampling=hard_half, frames=1)
    with pytest.raises(ValueError, match=r"sampling=hard_half; give its name, 'package.module"):
        SelfPlaySettings(sampling=hard_half, frames=1)  # type: ignore[arg-type]


def test_a_table_policy_may_keep_its_task() -> None:
    task = make_task("chase", maze="3x3")
    policy = AStarEvader(0.2)
    policy.task = task  # type: ignore[attr-defined]
    assert is_table_in(task, policy)
