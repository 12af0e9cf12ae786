"""Self-play: who meets whom, what is measured, that it learns, and that nothing saved is lost."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from pursuit.maze import load_maze
from pursuit.policy import GameView
from pursuit.simulator import Simulator
from pursuit.task import make_task
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    OptimalEvader,
    RandomAgent,
    best_response,
    solve_chase,
)
from train.algorithms.registry import Build, entry
from train.commands.main import main
from train.environments.team_env import TeamEnv
from train.evaluation.exploitability import exploitability, nash_conv
from train.evaluation.matchups import match, play_pair
from train.experiments.kinds import open_run, resume, start
from train.networks.actor_critic import CentralActorCritic
from train.networks.layers import Hidden
from train.networks.policy import Seat
from train.runs.folder import RESULTS, SELF_PLAY, new_folder
from train.runs.loop import Run
from train.runs.opponents import load_policy, opponents_of
from train.self_play.league import LeagueTable, rate
from train.self_play.parts import self_play_parts
from train.self_play.pool import OpponentPool, PoolPolicy, nash_mixtures, weights
from train.self_play.side import Opponents
from train.settings.self_play import SelfPlaySettings, self_play_ppo
from train.settings.task import TaskSettings

QUICK = replace(self_play_ppo(), num_games=64, minibatch_size=512)


class Always:
    """Takes one action, and notes how many games it was asked for."""

    def __init__(self, action: int) -> None:
        self.action, self.asked = action, 0

    def act(self, view: GameView) -> NDArray[np.int32]:
        self.asked = view.num_games
        return np.full(view.num_games, self.action, dtype=np.int32)


def make_settings(**changes: Any) -> SelfPlaySettings:
    task = {"maze": "3x3", "rewards": "zero_sum", **changes.pop("task", {})}
    given: dict[str, Any] = {"hyper": QUICK, "frames": 40_000, "snapshots": 5, **changes}
    return SelfPlaySettings(task=TaskSettings(**task), **given)


def make_run(folder: Path, **changes: Any) -> Run:
    return start(SELF_PLAY, make_settings(**changes), new_folder(folder))


def go_on(folder: Path) -> Run:
    return resume(folder, SELF_PLAY)


def empty_pool(folder: Path, capacity: int = 3) -> OpponentPool:
    return OpponentPool(folder, Always(0), capacity, lambda state: Always(state["action"]))


# -- the pool --------------------------------------------------------------------------------------


def test_every_game_meets_its_own_opponent(tmp_path: Path) -> None:
    pool = empty_pool(tmp_path)
    for action in (1, 2, 3):
        pool.add(str(action), {"action": action}, np.random.default_rng(0))
    policy = PoolPolicy(pool, 1000)
    policy.opponents[:] = np.random.default_rng(0).integers(4, size=1000)
    simulator = Simulator(make_task("chase"), 1000)
    actions = policy.act(simulator.view("evader"))
    assert (actions == policy.opponents).all()
    counts = np.bincount(policy.opponents)
    assert [member.policy.asked for member in pool.members] == counts.tolist()  # type: ignore[attr-defined]


def test_scripted_opponents_draw_from_their_games_own_streams(tmp_path: Path) -> None:
    """A game against a scripted member goes on as if that member alone were there."""
    pool = OpponentPool(tmp_path, AStarEvader(0.5), 3, lambda state: Always(0))
    pool.add_scripted("random", RandomAgent())
    policy = PoolPolicy(pool, 64)
    policy.opponents[::2] = 1
    simulator = Simulator(make_task("chase"), 64)
    first, second = (policy.act(simulator.view("evader")) for _ in range(2))
    assert (first != second).any()  # the streams have moved on
    moves = np.take_along_axis(
        load_maze("5x5").neighbors[simulator.positions[:, 1]], first[:, None], axis=1
    )[:, 0]
    assert (moves != simulator.positions[:, 1])[::2].all()  # random agents always move


def test_pools_are_bounded_and_survive_damage(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path), np.random.default_rng(0)
    pool.add_scripted("astar", AStarEvader())
    dropped = [pool.add(f"{n}", {"action": n % 4}, rng) for n in range(10)]
    assert len(pool.snapshots) == 3 and pool.names[-1] == "9"
    assert sum(name is not None for name in dropped) == 7
    pool.clean()
    assert sorted(path.stem for path in tmp_path.glob("*.pt")) == sorted(
        member.name for member in pool.snapshots
    )
    pool.note(2, np.array([1.0, 0.0, 1.0]))
    assert pool.members[2].score == pytest.approx(2 / 3)
    state, hurt = pool.state_dict(), pool.snapshots[1].name
    (tmp_path / f"{hurt}.pt").write_bytes(b"not a snapshot")
    again = empty_pool(tmp_path)
    again.add_scripted("astar", AStarEvader())
    with pytest.warns(UserWarning, match=f"{hurt}.pt: damaged or missing snapshot"):
        again.load_state_dict(state)
    assert again.names == [name for name in pool.names if name != hurt]
    assert again.members[2].score == pytest.approx(2 / 3)


def test_two_equal_names_are_refused(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path), np.random.default_rng(0)
    pool.add("one", {"action": 1}, rng)
    with pytest.raises(ValueError, match="two members of a pool are called 'one'"):
        pool.add("one", {"action": 2}, rng)
    with pytest.raises(ValueError, match="called 'latest'"):
        pool.add_scripted("latest", RandomAgent())


def test_sampling_schemes_weigh_as_they_say(tmp_path: Path) -> None:
    pool, rng = empty_pool(tmp_path, 10), np.random.default_rng(0)
    for n in range(4):
        pool.add(f"{n}", {"action": n}, rng)
    assert weights(pool, "latest").tolist() == [1, 0, 0, 0, 0]
    assert weights(pool, "uniform") == pytest.approx([0.2] * 5)
    assert weights(pool, "window", window=2) == pytest.approx([1 / 3, 0, 0, 1 / 3, 1 / 3])
    for member, score in zip(pool.members, (0.5, 0.9, 0.1, 0.5, 1.0), strict=True):
        member.score = score
    shares = weights(pool, "pfsp", power=2.0)
    assert shares[:4] / shares[2] == pytest.approx(np.array([25, 1, 81, 25]) / 81, abs=2e-3)
    assert shares[4] > 0
    mixture = np.array([0, 0.25, 0, 0.75, 0])
    assert weights(pool, "psro", mixture=mixture) == pytest.approx(mixture)
    assert weights(pool, "psro")[0] == 1
    pool.members.clear()
    with pytest.raises(ValueError, match="an empty pool"):
        weights(pool, "uniform")


def test_the_mixture_of_double_oracle_is_the_equilibrium() -> None:
    chasers, evaders = nash_mixtures(np.array([[0.0, -1.0, 1.0], [1, 0, -1], [-1, 1, 0]]))
    assert chasers == pytest.approx([1 / 3] * 3) and evaders == pytest.approx([1 / 3] * 3)
    chasers, evaders = nash_mixtures(np.array([[3.0, 2.0], [5.0, 4.0]]))
    assert chasers.tolist() == [1, 0] and evaders.tolist() == [1, 0]


# -- the games -------------------------------------------------------------------------------------


def make_env(tmp_path: Path, role: str, central: bool = False, **counts: int) -> TeamEnv:
    task = make_task("chase", maze="5x5", max_steps=12, **counts)
    simulator = Simulator(task, 32, seed=1, auto_restart=False)
    opponents = Opponents(simulator, role, 0.95, seed=0)
    opponents.policy.pool = OpponentPool(tmp_path, RandomAgent(), 3, lambda state: Always(0))
    policies = [None if seat == role else opponents.policy for seat in task.seat_roles]
    return TeamEnv(simulator, Seat(task, role), policies, opponents, central=central)


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
        over = simulator.ended  # false again where games began anew
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
    hyper = replace(QUICK, num_games=64, minibatch_size=64)
    learner: Any = entry("ppo").build(hyper, env, Build())
    sizes = [len(learner.collect()) for _ in range(4)]
    assert min(sizes) < 64 * 16 and learner.frames == 4 * 64 * 16
    frames = learner.collect()
    assert (frames["prepared"][:, : env.simulator.task.max_cells].sum(dim=1) == 1).all()


def test_a_central_critic_sees_the_whole_team_and_the_policy_does_not(tmp_path: Path) -> None:
    env = make_env(tmp_path, "chaser", central=True, num_chasers=2)
    seen = env.reset()["observation"]
    assert seen.shape == (64, 3, 4)
    own = env.simulator.observe("index")[:, :2]
    assert (seen[:, 0].numpy() == own.reshape(64, -1)).all()
    for member in (0, 1):
        assert (seen[:, 1 + member].view(32, 2, -1).numpy() == own[:, None, member]).all()
    torch.manual_seed(0)
    network = CentralActorCritic(env.player.features, 4, env.player.members, Hidden(32))
    logits, value = network(seen)
    assert torch.equal(logits, network.logits(seen[:, 0]))
    assert torch.allclose(value.view(32, 2)[:, 0], value.view(32, 2)[:, 1])
    changed = seen.clone()
    changed[:, 2] = changed[:, 2].flip(0)
    after_logits, after_value = network(changed)
    assert torch.equal(logits, after_logits) and not torch.allclose(value, after_value)


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
    with pytest.raises(ValueError, match="must have the stay action, or neither"):
        exploitability(maze, chaser, RandomAgent().action_probabilities(maze, True))


def test_matchups_are_exact_and_agree_with_games() -> None:
    task = make_task("chase", maze="5x5", max_steps=30)
    exact = match(task, AStarChaser(0.2), AStarEvader(0.2))
    lengths, caught = play_pair(task, AStarChaser(0.2), AStarEvader(0.2), 20_000, seed=1)
    assert exact.games == 0 and exact.ci95 == 0
    assert lengths.mean() == pytest.approx(exact.steps, abs=4 * lengths.std() / 20_000**0.5)
    assert caught.mean() == pytest.approx(exact.caught, abs=0.01)
    team = make_task("chase", maze="5x5", num_chasers=2)
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


@pytest.mark.parametrize(
    "sampling",
    [
        "psro",
        "pfsp",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("latest", "window", "uniform")),
    ],
)
def test_a_killed_run_resumes_bit_for_bit(tmp_path: Path, sampling: str) -> None:
    changes = {"sampling": sampling, "members": ("astar",), "pool_size": 3, "frames": 24_000}
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
    with pytest.raises(ValueError, match="complete"):
        go_on(tmp_path / "part")


@pytest.mark.parametrize(
    "changes",
    [
        {"share_networks": True},
        {"chaser_algorithm": "dqn", "evader_algorithm": "a2c", "frames": 30_000},
        {"task": {"num_chasers": 2, "num_evaders": 2, "max_steps": 30}},
        {"task": {"num_chasers": 3}, "hyper": replace(QUICK, central_critic=True)},
        {"task": {"stay_action": True, "move_order": "chasers_first"}, "observation": "planes"},
        {"task": {"task": "heist"}, "sampling": "uniform"},
    ],
)
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
    if not run.trainee.task.is_duel:
        run.trainee.settings = replace(run.trainee.settings, best_response_seconds=0.2)
        found = run.results(20)["approximate_best_response"]
        assert set(found) == {"against_chaser", "against_evader"}
    if changes.get("share_networks"):
        networks = [side.learner.network for side in run.trainee.sides.values()]  # type: ignore[attr-defined]
        assert networks[0].policy_trunk is networks[1].policy_trunk
    again = open_run(tmp_path / "run").trainee
    assert all((again.sides[role].learner.frames == side.learner.frames) for role, side in
               run.trainee.sides.items())  # fmt: skip


def test_a_frozen_side_stays_as_it_is(tmp_path: Path) -> None:
    first = make_run(tmp_path / "first", evader="astar", frames=8000)
    assert list(first.trainee.sides) == ["chaser"]
    first.train()
    assert "evader_vs_astar" not in first.metrics.rows[-1]
    frozen = str(tmp_path / "first" / "chaser")
    second = make_run(tmp_path / "second", chaser=frozen, frames=8000, sampling="psro")
    policy: Any = second.trainee.policy("chaser")
    before = [p.clone() for p in policy.network.parameters()]
    second.train()
    assert all(torch.equal(a, b) for a, b in zip(before, policy.network.parameters(), strict=True))
    with pytest.raises(ValueError, match="learned to be 'chaser'; 'evader' is asked for"):
        make_run(tmp_path / "third", evader=frozen)
    with pytest.raises(ValueError, match="learned in maze 3x3"):
        make_run(tmp_path / "fourth", chaser=frozen, task={"maze": "4x4"})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sampling": "best"}, "unknown sampling 'best'"),
        ({"chaser": "astar", "evader": "random"}, "both frozen"),
        ({"task": {"task": "maze"}}, "no chasers or no evaders"),
        ({"members": ("genius",)}, "unknown member 'genius'"),
        ({"members": ("astar", "astar")}, "given twice"),
        ({"pool_size": 0}, "pool_size=0"),
        ({"chaser_algorithm": "q_learning"}, "chaser_algorithm='q_learning'"),
        ({"chaser_algorithm": "dqn", "task": {"num_chasers": 2}}, "with 2 chasers"),
        ({"share_networks": True, "evader": "astar"}, "share_networks needs"),
        ({"hyper": replace(QUICK, gamma=1.0)}, "gamma=1.0"),
        ({"frames": None}, "give one of the two"),
        ({"task": {"role": "evader"}}, "both sides learn here"),
        ({"task": {"task": "heist", "rewards": "default"}}, "with goals; leave them at zero_sum"),
        ({"task": {"num_runners": 1, "num_goals": 1}}, "has runners"),
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        self_play_parts(make_settings(**changes))


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    one = make_run(tmp_path / "one", frames=3000)
    one.train()
    two = make_run(tmp_path / "two", frames=3000, hyper=replace(QUICK, width=32))
    two.train()
    (tmp_path / "two" / "checkpoint.pt").write_bytes(
        (tmp_path / "one" / "checkpoint.pt").read_bytes()
    )
    with pytest.raises(ValueError, match="does not fit the settings"):
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


# -- the commands ----------------------------------------------------------------------------------


def test_the_commands_from_self_play_to_league(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = ["self-play", "--maze", "3x3", "--frames", "20000", "--num-games", "64"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main([*run, "--minibatch-size", "512", "--out", "a"])
        main(
            [*run, "--minibatch-size", "512", "--seed", "1", "--sampling", "uniform", "--out", "b"]
        )
    printed = capsys.readouterr().out
    assert "NashConv" in printed and "chasers down, evaders across" in printed
    results = json.loads((tmp_path / "a" / "results.json").read_text())
    assert results["evaluation"]["nash_conv"] > 0
    steps = {(row["chaser"], row["evader"]): row["steps"] for row in results["matches"]}
    assert len(steps) == 16 and steps["learned", "learned"] == results["evaluation"]["steps"]
    assert (tmp_path / "a" / "learning_curve.png").stat().st_size > 10_000
    main(["league", "a", "b", "a/chaser", "astar", "random", "--games", "50", "--out", "l"])
    printed = capsys.readouterr().out
    assert "Elo" in printed and "Nash share" in printed
    content = json.loads((tmp_path / "l" / "league.json").read_text())
    assert content["chasers"] == ["a", "b", "a/chaser", "astar", "random"]
    assert content["evaders"] == ["a", "b", "astar", "random"]
    assert content["payoff"][0] == content["payoff"][2]  # one and the same chaser
    elo = {row["name"]: row["elo"] for row in content["chaser_ratings"]}
    assert elo["astar"] > elo["random"]
    main(["evaluate", "a/evader", "--episodes", "20"])
    assert "optimal" in capsys.readouterr().out


def test_sampling_schemes_are_compared_by_a_sweep(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "schemes.toml"
    file.write_text(SCHEMES)
    command = ["sweep", str(file), "--out", str(tmp_path / "out"), "--workers", "2"]
    main(command)
    assert "4 complete" in capsys.readouterr().out
    report = (tmp_path / "out" / "report" / "report.md").read_text()
    assert "NashConv (discounted steps) [95 %]" in report and "| psro |" in report
    assert (tmp_path / "out" / "report" / "learning_curves_frames.png").stat().st_size > 10_000
    done = {path: path.stat().st_mtime_ns for path in tmp_path.glob(f"out/runs/*/{RESULTS}")}
    main(command)
    assert len(done) == 4 and all(path.stat().st_mtime_ns == then for path, then in done.items())
    some = next(iter(done)).parent
    with pytest.raises(ValueError, match="go on with it by `pursuit self-play --resume"):
        resume(some, "run")
    with pytest.raises(ValueError, match="one side of self-play"):
        go_on(some / "chaser")


SCHEMES = """
title = "Who is drawn"
kind = "self-play"
seeds = [0, 1]
settings = {maze = "3x3", frames = 6000, num_games = 64, minibatch_size = 512, snapshots = 5}
grid = {sampling = ["latest", "psro"]}
"""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["league"], "nobody to play"),
        (["league", "astar", "astar"], "two entries are called 'astar'"),
        (["league", "nowhere"], "nowhere: no folder of a run"),
        (["league", "astar", "--games", "1"], "games=1"),
        (["solve", "--maze", "5x6"], "unknown maze '5x6'"),
        (["solve", "--discount", "1.5"], "discount 1.5"),
        (["solve", "--evader-cell", "99"], "evader_cell=99"),
        (["self-play", "--resume", "nowhere"], "no such folder"),
        (["self-play", "--window", "0"], "window=0"),
    ],
)
def test_wrong_command_lines_are_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_runs_of_another_game_do_not_enter_a_league(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = {}
    for name, changes in {
        "three": {},
        "four": {"task": {"maze": "4x4"}},
        "stay": {"task": {"stay_action": True}},
    }.items():
        run = make_run(tmp_path / name, frames=2000, **changes)  # type: ignore[arg-type]
        run.train()
        folders[name] = str(tmp_path / name)
    for other, message in (("four", "learned in maze 4x4"), ("stay", "stay_action=True")):
        with pytest.raises(SystemExit):
            main(["league", folders["three"], folders[other]])
        assert message in capsys.readouterr().err


def test_results_in_a_circle_are_called_so() -> None:
    rock = np.array([[10, 5, 15], [15, 10, 5], [5, 15, 10]])
    lengths = np.repeat(rock[:, :, None], 20, axis=2)
    table = LeagueTable(["a", "b", "c"], ["x", "y", "z"], rock.astype(float), 0.0 * rock, lengths)
    content = rate(table)
    assert len(content["cycle"]) == 6
    assert content["nash"]["chaser_mixture"] == pytest.approx([1 / 3] * 3, abs=1e-3)
    settled = np.array([[10, 12], [20, 22]])
    table = LeagueTable(
        ["a", "b"], ["x", "y"], settled.astype(float), 0.0 * settled,
        np.repeat(settled[:, :, None], 20, axis=2),
    )  # fmt: skip
    assert rate(table)["cycle"] == []


def test_solve_prints_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["solve", "--maze", "5x5-tree", "--out", str(tmp_path / "s.png")])
    printed = capsys.readouterr().out
    assert "cop number (in turns)           1" in printed and "saddle point" in printed
    assert (tmp_path / "s.png").stat().st_size > 10_000


def test_opponents_by_name_in_training() -> None:
    for name in ("random", "optimal", "astar"):
        opponents = opponents_of(make_task("chase"), "chaser", name, 0.1)
        form = {"random": RandomAgent, "optimal": OptimalEvader, "astar": AStarEvader}[name]
        assert type(opponents["evader"]) is form
