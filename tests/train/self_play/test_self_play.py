"""Self-play: opponents, metrics, learning, and resumption."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from self_play_runs import QUICK, Always, go_on, make_run, make_settings, side_by, sides_of_task

from pursuit.mazes.maze import load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    OptimalChaser,
    OptimalEvader,
    RandomAgent,
    best_response,
    joint_nash_conv,
    mean_over_starts,
    solve_chase,
)
from train.algorithms.registry import Build, entry
from train.commands.main import main
from train.commands.self_play import parsed
from train.environments.simulator_env import SimulatorEnv
from train.evaluation.exploitability import duel_nash_conv, exploitability, team_exploitability
from train.evaluation.games import table_in
from train.evaluation.matchups import discounted_steps, match, play_pair
from train.evaluation.self_play_metrics import format_row
from train.evaluation.self_play_text import describe_exploitability, describe_whole_game
from train.experiments.rows import read_run
from train.kinds import open_run, start
from train.networks.policy import MazeSeat
from train.runs.folder import SELF_PLAY
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.self_play.parts import self_play_parts, self_play_settings_of
from train.self_play.pool import OpponentPool
from train.self_play.side import Opponents
from train.settings.self_play import LearningSide, SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings

# -- the games -------------------------------------------------------------------------------------


def make_env(tmp_path: Path, role: str, **settings: int) -> SimulatorEnv:
    task = make_task("chase", maze="5x5", max_steps=12, **settings)
    simulator = Simulator(task, 32, seed=1, auto_restart=False)
    other = "evader" if role == "chaser" else "chaser"
    opponents = Opponents(simulator, sides_of_task(task), role, [other], seed=0)
    pool = OpponentPool(tmp_path, RandomAgent(), 3, lambda state: Always(0))
    opponents.policies[other].pool = pool
    policies = [opponents.policies.get(seat) for seat in task.seat_roles]
    return SimulatorEnv(simulator, MazeSeat(task, role), policies, opponents, task.count(role))


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
    member = env.hook.policies["chaser"].pool.members[0]
    assert member.games == len(lengths)
    if len(lengths) <= 200:
        assert member.score == pytest.approx((1 - 0.95**lengths).mean())


# -- exploitability --------------------------------------------------------------------------------


@pytest.mark.parametrize("discount", [0.5, 0.95, 0.99])
def test_no_exploitability_is_below_zero(discount: float) -> None:
    """Between optimal agents all gains are 0 up to the errors of the solvers."""
    maze = load_maze("2x2")
    solved = solve_chase(maze, discount)
    tables = solved.chaser_policy, solved.evader_policy
    chase = make_task("chase", maze="2x2", rewards="zero_sum")
    team = replace(chase, num_chasers=2)
    pair: Any = {"chaser": OptimalChaser(discount=discount)}
    pair["evader"] = OptimalEvader(discount=discount)
    for found in (
        exploitability(maze, *tables, discount=discount),
        team_exploitability(chase, pair["chaser"], pair["evader"], discount),
        team_exploitability(team, pair["chaser"], pair["evader"], discount),
    ):
        assert found.chaser.min() >= 0.0 and found.evader.min() >= 0.0
        assert 0.0 <= found.mean_chaser < 1e-6 and 0.0 <= found.mean_evader < 1e-6
    assert duel_nash_conv(maze, *tables, discount=discount) >= 0.0
    gains = joint_nash_conv(chase, pair, None, discount).gains
    assert min(gains.values()) >= 0.0 and max(gains.values()) < 1e-6


def test_exploitability_is_zero_at_the_equilibrium_and_exact_elsewhere() -> None:
    maze = load_maze("5x5-tree")
    solved = solve_chase(maze)
    none = exploitability(maze, solved.chaser_policy, solved.evader_policy)
    assert duel_nash_conv(maze, solved.chaser_policy, solved.evader_policy) == pytest.approx(
        0, abs=1e-6
    )
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
    assert duel_nash_conv(maze, chaser, evader) == pytest.approx(found.nash_conv)
    assert found.nash_conv == pytest.approx(gains[apart].mean() + losses[apart].mean())
    assert found.mean_evader > 1
    with pytest.raises(ValueError, match="both need the stay action, or neither"):
        exploitability(maze, chaser, RandomAgent().action_probabilities(maze, True))


def test_payoffs_of_the_nash_mixture_are_those_of_the_discounted_game(tmp_path: Path) -> None:
    """Of the game that is trained in and that NashConv is of, without a cut at 200 steps."""
    run = make_run(tmp_path / "run", sampling="psro", frames=8000, members=("random",))
    run.train()
    trainee = run.trainee
    task, maze = trainee.game.task, trainee.game.task.mazes[0]
    chasers, evaders = (
        {member.name: member.policy for member in trainee.pools[role].members}
        for role in ("chaser", "evader")
    )
    assert len(trainee.payoffs.known) == len(chasers.keys() - {"latest"}) ** 2 > 4
    for (chaser, evader), payoff in trainee.payoffs.known.items():
        tables = [table_in(task, who) for who in (chasers[chaser], evaders[evader])]
        values = exploitability(maze, *tables, discount=trainee.parts.game.discount).values
        assert payoff == pytest.approx(mean_over_starts(values, maze))


def test_discounted_steps_are_exact_and_agree_with_games(monkeypatch: pytest.MonkeyPatch) -> None:
    task = make_task("chase", maze="4x4", max_steps=20)
    pair = RandomAgent(), AStarEvader(0.0)  # some 200 steps: a cut would show
    exact = discounted_steps(task, *pair, 0.99)
    assert exact > 1.2 * (1 - 0.99**20) / 0.01
    monkeypatch.setattr("train.evaluation.matchups.is_table_duel", lambda *_: False)
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
    run = make_run(tmp_path / "run", hyper=replace(self_play_ppo(), num_games=256), frames=200_000)
    run.train()
    content = run.results()
    found, before = content["evaluation"], content["at_start"]
    assert found["nash_conv"] < 0.5 * before["nash_conv"], found
    assert found["evader_vs_astar"] > 1.5 * before["evader_vs_astar"]


@pytest.mark.slow
def test_psro_starts_new_learners_and_its_nash_mixture_improves(tmp_path: Path) -> None:
    task = {"maze": "3x3-tree", "rewards": "zero_sum"}
    settings: Any = {"sampling": "psro", "snapshots": 4, "pool_size": 4, "frames": 500_000}
    hyper = replace(self_play_ppo(), num_games=64, minibatch_size=512)
    run = make_run(tmp_path, hyper=hyper, task=task, **settings)
    side = run.trainee.sides["chaser"]
    first, frames = side.snapshot()["network"], side.learner.frames
    side.restart()
    assert side.learner.frames == frames and not side.learner.optimizer.state_dict()["state"]
    again = side.snapshot()["network"]
    assert any(not torch.equal(first[name], again[name]) for name in first)
    run.train()
    content = run.results()
    assert content["mixture_nash_conv"][1] < 0.1 * content["at_start"]["nash_conv"]


@pytest.mark.slow
def test_the_default_settings_come_near_an_equilibrium(tmp_path: Path) -> None:
    # Seeds 0 to 2 end at 0.7 to 1.3 % of the start; with uniform sampling and an entropy bonus of
    # 0.02 at 5 to 7 %.
    task = TaskSettings(maze="3x3-tree", rewards="zero_sum")
    run = start(SELF_PLAY, SelfPlaySettings(task=task, frames=400_000), tmp_path / "run")
    run.train()
    first, last = run.rows[0], run.rows[-1]
    assert last["nash_conv"] < 0.03 * first["nash_conv"]


def test_a_killed_run_resumes_bit_for_bit_and_a_complete_one_is_not_resumed(
    tmp_path: Path,
) -> None:
    changes: dict[str, Any] = {"sampling": "pfsp", "members": ("astar",), "pool_size": 3}
    changes["frames"] = 24_000
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
    for one, two in zip(whole.rows, again.rows, strict=True):
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


def test_a_callback_is_called_at_snapshots_and_changes_nothing(tmp_path: Path) -> None:
    seen: list[Any] = []
    ends = []
    for name in ("with", "without"):
        run = make_run(tmp_path / name, frames=12_000)
        if name == "with":
            run.trainee.on_snapshot = lambda pair: seen.append((
                pair.taken, pair.pools["chaser"].snapshots[-1].name, pair.evaluate()["nash_conv"],
                pair.frames,
            ))  # fmt: skip
        run.train()
        ends.append(run.trainee.sides["chaser"].snapshot()["network"])
    assert [taken for taken, *_ in seen] == [1, 2, 3, 4, 5]
    assert all(name == f"{frames:09d}" for _, name, _, frames in seen)
    assert all(nash_conv > 0 for _, _, nash_conv, _ in seen)
    assert all(torch.equal(weight, ends[1][name]) for name, weight in ends[0].items())


def test_an_evaluation_does_not_change_a_run(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", frames=2000)
    before = torch.get_rng_state()
    run.trainee.evaluate()
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"chaser": side_by("dqn"), "evader": side_by("a2c", "evader"), "frames": 30_000},
        pytest.param(
            {"task": {"maze": "2x2", "num_chasers": 2, "num_evaders": 2, "max_steps": 30}},
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
    task = run.trainee.game.task
    if not task.is_duel:
        run.trainee.settings = replace(run.trainee.settings, best_response_seconds=0.2)
        # The joint game of one evader without goals is solved; elsewhere a challenger is trained.
        kind = "exact" if (task.num_evaders, task.num_goals) == (1, 0) else "approximate"
        results = run.results(20)
        found = results[f"{kind}_best_response"]
        assert set(found) == {"against_chaser", "against_evader"}
        assert sum(name.endswith("best_response") for name in results) == 1
        assert ("nash_conv" in results["evaluation"]) == (kind == "exact")
        assert ("nash_conv" in run.rows[-1]) == (kind == "exact")
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
    assert "evader_vs_astar" not in first.rows[-1]
    row = {**first.rows[-1], "chaser_exploitability": -1e-12}
    assert "(lost to a best response: chaser 0.000, evader" in " ".join(format_row(row))
    results = first.results(20)
    told = describe_exploitability(results)
    fixed = results["evaluation"]["evader_exploitability"]
    lost = f"exploitability {fixed:.3f}, lost to a best response,"
    assert told[0].endswith(f"exact; evader fixed: its {lost} cannot fall.")
    assert any(line.startswith("The evader escapes from every start") for line in told)
    frozen = str(tmp_path / "first" / "chaser")
    second = make_run(tmp_path / "second", chaser=frozen, frames=8000)
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
        ({"evader": "astar", "sampling": "uniform"}, "the fixed role is the only opponent"),
        ({"chaser": "astar", "members": ("random",)}, "leave members out, or let both roles learn"),
        ({"evader": "nosuch"}, "'nosuch': not a policy; give one of astar, .*package.module:Name"),
        ({"task": {"task": "maze"}}, "no chasers or no evaders"),
        ({"members": ("genius",)}, "unknown member 'genius'"),
        ({"members": ("astar", "astar")}, "is given twice"),
        ({"pool_size": 0}, "pool_size=0"),
        ({"sampling": "window", "window": 9, "pool_size": 8}, "window=9 is more than pool_size"),
        ({"sampling": "nash-mixture", "pool_size": 4}, "nash-mixture keeps all"),
        ({"chaser": side_by("q_learning")}, "chaser.algorithm='q_learning'"),
        ({"chaser": side_by("dqn"), "task": {"num_chasers": 2}}, "with 2 chasers"),
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


def test_the_former_name_of_a_sampling_rule_is_refused_with_the_new_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, study = tmp_path / "run", tmp_path / "study.toml"
    run = make_run(folder)
    run.lock.release()
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**config, "sampling": "double-oracle"}))
    study.write_text('kind = "self-play"\nsettings.frames = 9\ngrid.sampling = ["double-oracle"]')
    out = ["--out", str(tmp_path / "out")]
    for command in (
        ["self-play", "--maze", "2x2", "--frames", "9", "--sampling", "double-oracle", *out],
        ["self-play", "--resume", str(folder)],
        ["sweep", str(study), *out],
    ):
        with pytest.raises(SystemExit) as exit_:
            main(command)
        said = capsys.readouterr().err.strip()
        assert exit_.value.code == 2 and "\n" not in said
        assert "unknown sampling 'double-oracle'; it was renamed, give nash-mixture" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn", "mmd", "nfsp"])
def test_final_discounts_of_both_sides_are_that_of_the_exact_game(algorithm: str) -> None:
    given: dict[str, Any] = {"maze": "3x3", "frames": 1000, "chaser": {"algorithm": algorithm}}
    parts = self_play_parts(self_play_settings_of(**given, gamma=0.9, gamma_end=0.97))
    assert parts.game.discount == parts.sides["chaser"].hyper.last_gamma == 0.97
    plain = self_play_parts(self_play_settings_of(**given))
    assert plain.game.discount == plain.sides["chaser"].hyper.last_gamma == QUICK.gamma


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


def test_settings_of_each_side_can_be_set_and_are_recorded(tmp_path: Path) -> None:
    run = tmp_path / "run"
    own = ["--chaser.entropy-coef", "0.05", "--chaser.no-anneal", "--evader.algorithm", "dqn"]
    both = ["--learning-rate", "0.004", "--num-games", "16", "--minibatch-size", "64"]
    size = ["--maze", "2x2-tree", "--frames", "600", "--snapshots", "2", "--out", str(run)]
    main(["self-play", *own, *both, *size, "--evader.num-games=8", "--evader.batch-size", "48"])
    config = json.loads((run / "config.json").read_text())
    chaser, evader = (config[role]["hyper"] for role in ("chaser", "evader"))
    assert config["evader"]["algorithm"] == "dqn" and "hyper" not in config
    assert chaser["entropy_coef"] == 0.05 and not chaser["anneal"] and evader["anneal"]
    assert chaser["learning_rate"] == evader["learning_rate"] == 0.004
    assert (chaser["num_games"], evader["num_games"], evader["batch_size"]) == (16, 8, 48)
    assert json.loads((run / "evader" / "config.json").read_text())["hyper"] == evader
    row = read_run(run)[0]
    assert (row["evader.algorithm"], row["chaser.entropy_coef"]) == ("dqn", 0.05)
    assert row["learning_rate"] == 0.004  # that of both sides
    settings = open_run(run).trainee.settings
    assert settings.side("evader").hyper.batch_size == 48
    table = self_play_settings_of(
        maze="2x2-tree", frames=600, snapshots=2, learning_rate=0.004, num_games=16,
        minibatch_size=64, chaser={"entropy_coef": 0.05, "anneal": False},
        evader={"algorithm": "dqn", "num_games": 8, "batch_size": 48},
    )  # fmt: skip
    assert (table.chaser, table.evader) == (settings.chaser, settings.evader)


def test_a_fixed_side_has_no_settings_and_the_other_keeps_its_own() -> None:
    settings = self_play_settings_of(maze="3x3", frames=64, chaser="astar", evader={"clip": 0.1})
    assert settings.chaser == "astar" and settings.learning == ("evader",)
    assert settings.side("evader").hyper == replace(self_play_ppo(), clip=0.1)
    both = self_play_settings_of(maze="3x3", frames=64, algorithm="a2c", entropy_coef=0.03)
    assert {(side.algorithm, side.hyper.entropy_coef) for side in (both.chaser, both.evader)} == {
        ("a2c", 0.03)
    }


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--chaser.gamma", "0.9"], "chaser.gamma=0.9, evader.gamma=0.95; give both"),
        (["--chaser.algorithm", "dqn", "--evader", "astar", "--clip", "0.1"], "--clip"),
        (["--chaser.batch-size", "48"], "chaser: Unrecognized options: --batch-size"),
        (["--chaser.entropy-coef", "-1"], "chaser: entropy_coef=-1.0; must be finite"),
        (
            ["--chaser-batch-size", "48"],
            "give chaser.batch_size (as an option --chaser.batch-size)",
        ),
        (["--evader-algorithm", "dqn"], "give evader.algorithm (as an option --evader.algorithm)"),
    ],
)
def test_settings_of_learners_that_do_not_fit_are_one_line(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["self-play", *options])
    assert stopped.value.code == 2 and message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"chaser_hyper": {}}, "unknown setting 'chaser_hyper'; give chaser.hyper"),
        ({"chaser": {"entropy_coeff": 1}}, "chaser: unknown setting 'entropy_coeff'.*did you mean"),
        ({"chaser": {"width": "x"}}, "chaser: width='x'; give a whole number"),
        ({"chaser": 3}, "chaser=3; give a name, or a table"),
        ({"evader": "astar", "evader.clip": 0.1}, "evader.clip with evader='astar'"),
        ({"clip": 0.1, "algorithm": "dqn"}, "unknown setting 'clip' of self-play"),
        ({"chasers.clip": 0.1}, "unknown setting 'chasers.clip' of self-play"),
    ],
)
def test_names_of_settings_of_one_side_are_checked(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        self_play_settings_of(maze="3x3", frames=64, **given)
    with pytest.raises(ValueError, match="with PPOSettings; give DQNSettings"):
        LearningSide("dqn")


def test_the_help_of_self_play_shows_options_that_can_be_given(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        main(["self-play", "--evader.algorithm", "dqn", "--help-all"])
    shown = capsys.readouterr().out
    assert "--chaser.entropy-coef 0.05" in shown and "--batch-size" in shown
    with pytest.raises(SystemExit):
        main(["self-play", "--help"])
    assert "--other" not in capsys.readouterr().out


def test_settings_are_checked_together_with_those_of_one_side() -> None:
    more = ["--chaser.num-games", "1024", "--evader.num-games", "1024"]
    for sizes in (
        ["--num-games", "1024", "--chaser.minibatch-size", "16384"],
        ["--minibatch-size", "16384", *more],
    ):
        _, settings = parsed(["--maze", "3x3", *sizes])
        chaser: Any = settings.side("chaser").hyper
        assert (chaser.num_games, chaser.minibatch_size) == (1024, 16384)
