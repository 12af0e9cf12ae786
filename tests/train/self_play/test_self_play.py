"""Self-play: opponents, metrics, learning, and resumption."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import QUICK, Always, go_on, make_run, make_settings

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    RandomAgent,
    best_response,
    mean_over_starts,
    solve_chase,
)
from train.algorithms.registry import Build, entry
from train.commands.main import main
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.exploitability import exploitability, nash_conv
from train.evaluation.games import table_in
from train.evaluation.matchups import discounted_steps, match, play_pair
from train.experiments.kinds import open_run, start
from train.networks.policy import Seat
from train.runs.folder import SELF_PLAY
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.self_play.parts import self_play_parts
from train.self_play.pool import OpponentPool
from train.self_play.report import describe_whole_game
from train.self_play.side import Opponents
from train.settings.self_play import SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings

# -- the games -------------------------------------------------------------------------------------


def make_env(tmp_path: Path, role: str, **settings: int) -> SimulatorEnv:
    task = make_task("chase", maze="5x5", max_steps=12, **settings)
    simulator = Simulator(task, 32, seed=1, auto_restart=False)
    opponents = Opponents(simulator, role, 0.95, seed=0)
    opponents.policy.pool = OpponentPool(tmp_path, RandomAgent(), 3, lambda state: Always(0))
    policies = [None if seat == role else opponents.policy for seat in task.seat_roles]
    return SimulatorEnv(simulator, Seat(task, role), policies, opponents, task.count(role))


@pytest.mark.parametrize("role", ["chaser", "evader"])
def test_a_team_is_one_batch_and_follows_the_rules(tmp_path: Path, role: str) -> None:
    env = make_env(tmp_path, role, num_chasers=2, num_evaders=2)
    simulator = env.simulator
    state = env.reset()
    assert state["observation"].shape == (64, 5)
    rng = np.random.default_rng(0)
    idle_seen = False
    for _ in range(60):
        everyone = simulator.observe("index")[:, env.seats].reshape(64, -1)
        assert (state["observation"].numpy() == everyone).all()
        idle = state["idle"].view(32, 2).numpy()
        assert (idle == (simulator.active[:, env.seats] == 0)).all()
        idle_seen |= bool(idle.any())
        state["action"] = torch.from_numpy(rng.integers(4, size=64))
        stepped, following = env.step_and_maybe_reset(state)
        after = stepped["next"]
        over = simulator.ended  # false again after restarts
        assert not over.any()
        done = after["done"].view(32, 2).numpy()
        caught_now = after["terminated"].view(32, 2).numpy()
        assert (after["reward"].view(32, 2).numpy()[idle] == 0).all()
        assert (done >= caught_now).all() and not (
            caught_now & after["truncated"].view(32, 2).numpy()
        ).any()
        state = following
    assert idle_seen == (role == "evader")


def test_learning_leaves_out_what_idle_agents_recorded(tmp_path: Path) -> None:
    env = make_env(tmp_path, "evader", num_chasers=2, num_evaders=2)
    # tanh: ReLUs are collected from otherwise, see test_fused_actor_critic.
    hyper = replace(QUICK, num_games=64, minibatch_size=64, activation="tanh")
    learner: Any = entry("ppo").build(hyper, env, Build())
    sizes = [len(learner.collect()["advantage"]) for _ in range(4)]
    assert min(sizes) < 64 * 16 and learner.frames == 4 * 64 * 16
    frames = learner.collect()
    assert (frames["prepared"][:, : env.simulator.task.max_cells].sum(dim=1) == 1).all()


def test_scores_are_the_share_of_the_discounted_payoff(tmp_path: Path) -> None:
    env = make_env(tmp_path, "evader")
    state = env.reset()
    for _ in range(40):
        _, state = env.step_and_maybe_reset(env.rand_action(state))
    lengths = np.concatenate(env.finished_lengths).astype(float)
    member = env.hook.pool.members[0]
    assert member.games == len(lengths)
    if len(lengths) <= 200:
        assert member.score == pytest.approx((1 - 0.95**lengths).mean())


# -- exploitability --------------------------------------------------------------------------------


def test_exploitability_is_zero_at_the_equilibrium_and_exact_elsewhere() -> None:
    maze = load_maze("5x5-tree")
    solved = solve_chase(maze)
    none = exploitability(maze, solved.chaser_policy, solved.evader_policy)
    assert nash_conv(maze, solved.chaser_policy, solved.evader_policy) == pytest.approx(0, abs=1e-6)
    assert none.nash_conv == pytest.approx(0, abs=1e-6)
    chaser = AStarChaser(0.1).action_probabilities(maze)
    evader = RandomAgent().action_probabilities(maze)
    found = exploitability(maze, chaser, evader)
    gains = best_response("evader", maze, chaser, None, 0.95).values - solved.values
    apart = ~np.eye(25, dtype=bool)
    assert found.chaser == pytest.approx(gains) and found.mean_chaser == pytest.approx(
        gains[apart].mean()
    )
    losses = solved.values - best_response("chaser", maze, evader, None, 0.95).values
    assert found.evader == pytest.approx(losses)
    assert nash_conv(maze, chaser, evader) == pytest.approx(found.nash_conv)
    assert found.nash_conv == pytest.approx(gains[apart].mean() + losses[apart].mean())
    assert found.chaser.min() > -1e-6 and found.evader.min() > -1e-6 and found.mean_evader > 1
    with pytest.raises(ValueError, match="both need the stay action, or neither"):
        exploitability(maze, chaser, RandomAgent().action_probabilities(maze, True))


def test_payoffs_of_double_oracle_are_those_of_the_discounted_game(tmp_path: Path) -> None:
    """Of the game that is trained in and that NashConv is of, without a cut at 200 steps."""
    run = make_run(tmp_path / "run", sampling="psro", frames=8000, members=("random",))
    assert run.trainee.settings.sampling == "double-oracle"  # psro is its former name
    run.train()
    trainee = run.trainee
    task, maze = trainee.task, trainee.task.mazes[0]
    chasers, evaders = (
        {member.name: member.policy for member in trainee.pools[role].members}
        for role in ("chaser", "evader")
    )
    assert len(trainee.payoffs) == len(chasers.keys() - {"latest"}) ** 2 > 4
    for (chaser, evader), payoff in trainee.payoffs.items():
        tables = [table_in(task, who) for who in (chasers[chaser], evaders[evader])]
        values = exploitability(maze, *tables, discount=trainee.parts.discount).values
        assert payoff == pytest.approx(mean_over_starts(values, maze))


def test_discounted_steps_are_exact_and_agree_with_games(monkeypatch: pytest.MonkeyPatch) -> None:
    task = make_task("chase", maze="4x4", max_steps=20)
    pair = RandomAgent(), AStarEvader(0.0)  # some 200 steps: a cut would show
    exact = discounted_steps(task, *pair, 0.99)
    assert exact > 1.2 * (1 - 0.99**20) / 0.01
    monkeypatch.setattr("train.evaluation.matchups.is_exact", lambda *_: False)
    assert discounted_steps(task, *pair, 0.99, 4000) == pytest.approx(exact, rel=0.03)


def test_matchups_are_exact_and_agree_with_games() -> None:
    task = make_task("chase", maze="5x5", max_steps=30)
    exact = match(task, AStarChaser(0.2), AStarEvader(0.2))
    lengths, caught = play_pair(task, AStarChaser(0.2), AStarEvader(0.2), 20_000, seed=1)
    assert exact.games == 0 and exact.ci95 == 0
    assert lengths.mean() == pytest.approx(exact.steps, abs=4 * lengths.std() / 20_000**0.5)
    assert caught.mean() == pytest.approx(exact.caught, abs=0.01)
    team = make_task("chase", maze="5x5", num_chasers=2, num_evaders=2)
    sampled = match(team, AStarChaser(), AStarEvader(0.2), 500)
    assert sampled.games == 500 and sampled.ci95 > 0 and sampled.steps < 30


# -- runs ------------------------------------------------------------------------------------------


def test_self_play_becomes_far_less_exploitable(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", hyper=replace(self_play_ppo(), num_games=256), frames=400_000)
    run.train()
    content = run.results()
    found, before = content["evaluation"], content["at_start"]
    assert found["nash_conv"] < 0.5 * before["nash_conv"], found
    assert found["evader_vs_astar"] > 1.5 * before["evader_vs_astar"]


@pytest.mark.slow
def test_the_default_settings_come_near_an_equilibrium(tmp_path: Path) -> None:
    # Seeds 0 to 2 end at 0.7 to 1.3 % of the start; with uniform sampling and an entropy bonus of
    # 0.02 at 5 to 7 %.
    task = TaskSettings(maze="3x3-tree", rewards="zero_sum")
    run = start(SELF_PLAY, SelfPlaySettings(task=task, frames=400_000), tmp_path / "run")
    run.train()
    first, last = run.metrics.rows[0], run.metrics.rows[-1]
    assert last["nash_conv"] < 0.03 * first["nash_conv"]


@pytest.mark.parametrize(
    "sampling",
    [
        "pfsp",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("latest", "window", "uniform")),
    ],
)
def test_a_killed_run_resumes_bit_for_bit(tmp_path: Path, sampling: str) -> None:
    changes: dict[str, Any] = {
        "sampling": sampling,
        "members": ("astar",),
        "pool_size": 3,
        "frames": 24_000,
    }
    if sampling == "window":
        changes["window"] = 3
    whole = make_run(tmp_path / "whole", **changes)
    whole.train()

    part = make_run(tmp_path / "part", **changes)

    class Killed(Exception):
        pass

    def kill(run: Run, row: dict[str, float]) -> None:
        if row and run.progress > 0.5:
            raise Killed

    with pytest.raises(Killed):
        part.train(kill)
    again = go_on(tmp_path / "part")
    assert again.progress > 0.4
    again.train()
    for role, side in whole.trainee.sides.items():
        ours, theirs = side.snapshot()["network"], again.trainee.sides[role].snapshot()["network"]
        assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert [p.state_dict() for p in whole.trainee.pools.values()] == [
        p.state_dict() for p in again.trainee.pools.values()
    ]
    timing = ("seconds", "frames_per_second")
    for one, two in zip(whole.metrics.rows, again.metrics.rows, strict=True):
        assert {k: v for k, v in one.items() if k not in timing} == {
            k: v for k, v in two.items() if k not in timing
        }
    # Killed between its last checkpoint and its results it has only those to write.
    last = go_on(tmp_path / "part")
    last.train()
    assert (
        last.trainee.frames == whole.trainee.frames
        and last.results(20)["evaluation"]["nash_conv"] > 0
    )
    assert go_on(tmp_path / "part").progress == 1.0  # its figure is missing
    for name in ("learning_curve.png", "report.html"):
        (tmp_path / "part" / name).touch()
    with pytest.raises(ValueError, match="complete"):
        go_on(tmp_path / "part")


@pytest.mark.parametrize(
    "changes",
    [
        {"chaser_algorithm": "dqn", "evader_algorithm": "a2c", "frames": 30_000,
         "hyper": self_play_ppo()},
        pytest.param(
            {"task": {"num_chasers": 2, "num_evaders": 2, "max_steps": 30}},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            {"task": {"stay_action": True, "move_order": "chasers_first"}, "observation": "planes"},
            marks=pytest.mark.slow,
        ),
        {"task": {"task": "heist"}, "sampling": "uniform"},
    ],
)  # fmt: skip
def test_teams_networks_and_algorithms_of_every_kind(tmp_path: Path, changes: Any) -> None:
    run = make_run(tmp_path / "run", **{"frames": 6000, **changes})
    before = {role: side.snapshot()["network"] for role, side in run.trainee.sides.items()}
    run.train()
    assert (tmp_path / "run" / "checkpoint.pt").exists()
    for role, side in run.trainee.sides.items():
        after = side.snapshot()["network"]
        assert any(not torch.equal(before[role][name], after[name]) for name in after)
        policy: Any = load_policy(
            tmp_path / "run" / role, greedy=not side.parts.algorithm.learns_distribution
        )
        state = policy.network.state_dict()
        assert all(torch.equal(state[name], after[name]) for name in after)
    task = run.trainee.task
    if not task.is_duel:
        run.trainee.settings = replace(run.trainee.settings, best_response_seconds=0.2)
        # The joint game of one evader without goals is solved; elsewhere a challenger is trained.
        kind = "exact" if (task.num_evaders, task.num_goals) == (1, 0) else "approximate"
        results = run.results(20)
        found = results[f"{kind}_best_response"]
        assert set(found) == {"against_chaser", "against_evader"}
        assert sum(name.endswith("best_response") for name in results) == 1
        assert ("nash_conv" in results["evaluation"]) == (kind == "exact")
        assert ("nash_conv" in run.metrics.rows[-1]) == (kind == "exact")
        if kind == "approximate":  # a whole game: what is paid is known exactly all the same
            whole = results["whole_game"]
            assert whole["nash_conv"] == pytest.approx(sum(whole["gains"].values()))
            assert all(gain >= -1e-9 for gain in whole["gains"].values())
            assert f"{whole['nash_conv']:.3f}" in describe_whole_game(whole)
    again = open_run(tmp_path / "run").trainee
    assert all((again.sides[role].learner.frames == side.learner.frames) for role, side in
               run.trainee.sides.items())  # fmt: skip


def test_a_frozen_side_stays_as_it_is(tmp_path: Path) -> None:
    first = make_run(tmp_path / "first", evader="astar", frames=8000)
    assert list(first.trainee.sides) == ["chaser"]
    first.train()
    assert "evader_vs_astar" not in first.metrics.rows[-1]
    frozen = str(tmp_path / "first" / "chaser")
    second = make_run(tmp_path / "second", chaser=frozen, frames=8000, sampling="double-oracle")
    policy: Any = second.trainee.policy("chaser")
    before = [p.clone() for p in policy.network.parameters()]
    second.train()
    assert all(torch.equal(a, b) for a, b in zip(before, policy.network.parameters(), strict=True))
    with pytest.raises(ValueError, match="is a policy for 'chaser', not for 'evader'"):
        make_run(tmp_path / "third", evader=frozen)
    with pytest.raises(ValueError, match="was trained in maze 3x3"):
        make_run(tmp_path / "fourth", chaser=frozen, task={"maze": "4x4"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sampling": "best"}, "unknown sampling 'best'"),
        ({"chaser": "astar", "evader": "random"}, "both fixed"),
        ({"task": {"task": "maze"}}, "no chasers or no evaders"),
        ({"members": ("genius",)}, "unknown member 'genius'"),
        ({"members": ("astar", "astar")}, "is given twice"),
        ({"pool_size": 0}, "pool_size=0"),
        ({"sampling": "window", "window": 9, "pool_size": 8}, "window=9 is more than pool_size"),
        ({"sampling": "double-oracle", "pool_size": 4}, "double-oracle keeps all"),
        ({"chaser_algorithm": "q_learning"}, "chaser_algorithm='q_learning'"),
        ({"chaser_algorithm": "dqn", "task": {"num_chasers": 2}}, "with 2 chasers"),
        ({"hyper": replace(QUICK, gamma=1.0)}, "gamma=1.0"),
        ({"hyper": replace(QUICK, gamma_end=0.0)}, "gamma_end=0.0 is outside"),
        ({"frames": None}, "give exactly one of the two"),
        ({"task": {"role": "evader"}}, "both roles learn in self-play"),
        ({"task": {"task": "heist", "rewards": "default"}}, "with goals; use zero_sum"),
        ({"task": {"num_runners": 1, "num_goals": 1}}, "has runners"),
    ],
)
def test_invalid_settings_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        self_play_parts(make_settings(**changes))


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn", "mmd", "nfsp"])
def test_final_discounts_of_both_sides_are_that_of_the_exact_game(algorithm: str) -> None:
    hyper = replace(QUICK, gamma=0.9, gamma_end=0.97)
    parts = self_play_parts(make_settings(hyper=hyper, chaser_algorithm=algorithm))
    assert parts.discount == parts.sides["chaser"].hyper.last_gamma == 0.97
    plain = self_play_parts(make_settings(chaser_algorithm=algorithm))
    assert plain.discount == plain.sides["chaser"].hyper.last_gamma == QUICK.gamma


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    one = make_run(tmp_path / "one", frames=3000)
    one.train()
    two = make_run(tmp_path / "two", frames=3000, hyper=replace(QUICK, width=32))
    two.train()
    (tmp_path / "two" / "checkpoint.pt").write_bytes(
        (tmp_path / "one" / "checkpoint.pt").read_bytes()
    )
    with pytest.raises(ValueError, match="does not match the settings"):
        go_on(tmp_path / "two")
    with pytest.raises(ValueError, match="no run here"):
        go_on(tmp_path)


def test_a_damaged_snapshot_is_left_out_and_the_rest_goes_on(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")

    def stop(run: Run, row: dict[str, float]) -> None:
        run.stopped = run.progress > 0.6

    run.train(stop)
    snapshot = next((tmp_path / "run" / "pool" / "evader").glob("*.pt"))
    snapshot.write_bytes(b"")
    with pytest.warns(UserWarning, match=snapshot.name):
        again = go_on(tmp_path / "run")
    assert snapshot.stem not in again.trainee.pools["evader"].names
    again.train()
    assert again.progress >= 1.0


def test_settings_of_another_learner_than_ppo_can_be_set_and_are_recorded(tmp_path: Path) -> None:
    run = tmp_path / "run"
    how = ["--chaser-algorithm", "dqn", "--chaser-batch-size", "48", "--evader", "astar"]
    size = ["--maze", "2x2-tree", "--frames", "600", "--snapshots", "2"]
    main(["self-play", *how, *size, "--chaser-num-games", "16", "--out", str(run)])
    config = json.loads((run / "config.json").read_text())
    assert config["hyper"] is None and config["evader_hyper"] is None  # no role learns with PPO
    assert config["chaser_hyper"]["batch_size"] == 48
    side = json.loads((run / "chaser" / "config.json").read_text())
    assert side["hyper"] == config["chaser_hyper"]
    told = (run / "methods.md").read_text()
    assert "| evader | astar |" in told and "| opponent_epsilon | 0.2 |" in told
    assert "| chaser_algorithm | dqn |" in told
    assert "| chaser_batch_size | 48 |" in told and "clip" not in told
    assert open_run(run).trainee.settings.chaser_hyper.batch_size == 48


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--chaser-algorithm", "dqn", "--chaser-gamma", "0.9"],
            "chaser_gamma=0.9, gamma=0.95;",
        ),
        (["--chaser-algorithm", "dqn", "--evader", "astar", "--clip", "0.1"], "--clip"),
        (["--chaser-batch-size", "48"], "--chaser-batch-size"),
    ],
)
def test_settings_of_learners_that_do_not_fit_are_one_line(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["self-play", *options])
    assert stopped.value.code == 2 and message in capsys.readouterr().err


def test_the_help_of_self_play_shows_options_that_can_be_given(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["self-play", "--help"])
    shown = capsys.readouterr().out
    assert "--chaser-algorithm" in shown and "--others" not in shown


def test_a_config_without_settings_of_other_learners_is_read(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", chaser_algorithm="dqn")
    path = tmp_path / "run" / "config.json"
    config = json.loads(path.read_text())
    assert config["chaser_hyper"] == asdict(run.trainee.parts.sides["chaser"].hyper)
    del config["chaser_hyper"], config["evader_hyper"]
    path.write_text(json.dumps(config))
    run.lock.release()
    again = open_run(tmp_path / "run")
    assert again.trainee.parts.sides["chaser"].hyper == run.trainee.parts.sides["chaser"].hyper
