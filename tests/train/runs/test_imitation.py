"""Imitation: the columns, the loss and its weight, what is learned, and what is refused."""

from __future__ import annotations

import math
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

import pursuit
from pursuit.simulator.policy import GameView
from scripted_agents.games.agents import TableAgent
from train.algorithms.collector import EXPERT
from train.algorithms.registry import ALGORITHMS, entry
from train.environments.batch_env import BatchEnv, Expert
from train.experiments.identity import fingerprint, inputs_of
from train.kinds import resume, start
from train.runs.folder import RUN, SELF_PLAY
from train.runs.opponents import load_policy
from train.runs.parts import contest_of, parts_of, settings_of
from train.self_play.parts import self_play_settings_of
from train.settings.task import TaskSettings

SMALL: dict[str, Any] = {"maze": "3x3", "opponent_epsilon": 0.3, "threads": 1, "log": "none"}
ROLLOUTS = {"num_games": 32, "rollout_steps": 8, "minibatch_size": 128, "width": 16}
IMITATING = [name for name in ALGORITHMS if entry(name).imitates]
ALONE = [name for name in IMITATING if not entry(name).settings.SELF_PLAY_ONLY]


def sizes(algorithm: str) -> dict[str, Any]:
    """Those of `ROLLOUTS` that an algorithm has."""
    names = entry(algorithm).settings.__dataclass_fields__
    return {name: value for name, value in ROLLOUTS.items() if name in names}


def games_and_learner(**flat: Any) -> tuple[Any, Any]:
    """The training environment of a run, and its learner."""
    parts = parts_of(settings_of(**{**SMALL, "frames": 100_000, **flat}))
    env, _ = parts.games()
    return env, parts.algorithm.build(parts.hyper, env, parts.build)


def distance(policy: Any, expert: Any, task: Any, seats: list[int]) -> float:
    """The mean total variation between two policies of agents in random states."""
    games = pursuit.Simulator(task, 300, 5).games
    found = [
        np.abs(policy.distribution(task, games, seat) - expert.distribution(task, games, seat))
        for seat in seats
    ]
    return float(np.mean(found) * task.num_actions / 2)


@pytest.mark.parametrize("algorithm", ALONE)
@pytest.mark.parametrize("team", [1, 2])
def test_every_learner_comes_near_to_what_it_imitates(
    algorithm: str, team: int, tmp_path: Path
) -> None:
    flat = {**SMALL, **sizes(algorithm), "num_chasers": team, "algorithm": algorithm}
    flat |= {"learning_rate": 0.02, "entropy_coef": 0.0, "max_steps": 20}
    settings = settings_of(**flat, frames=60_000, imitate="astar", imitate_frames=10**9)
    run: Any = start(RUN, settings, tmp_path / "run")
    task = run.trainee.env.simulator.task
    seats = [*range(team)] if entry(algorithm).whole_role else [0]
    expert = pursuit.AStarChaser()
    before = distance(run.trainee.learner.policy(greedy=False), expert, task, seats)
    run.train()
    after = distance(run.trainee.learner.policy(greedy=False), expert, task, seats)
    assert before > 0.5 and after < 0.15, (before, after)


def test_the_column_is_the_distribution_in_the_states_of_the_learner() -> None:
    """Uniform over equally good moves, for every member of a team, also where games restart."""
    env, learner = games_and_learner(
        algorithm="ippo", num_chasers=2, num_evaders=1, max_steps=3, imitate="astar",
        imitate_frames=10_000, **ROLLOUTS,
    )  # fmt: skip
    asked, expert = list[Any](), pursuit.AStarChaser()
    ask = BatchEnv.expert_probabilities

    def recorded(self: BatchEnv) -> torch.Tensor:
        games = self.simulator.games
        own = [expert.distribution(self.simulator.task, games, seat) for seat in (0, 1)]
        asked.append(np.stack(own, axis=1).reshape(-1, 4))
        return ask(self)

    env.expert_probabilities = recorded.__get__(env)
    frames = learner.collect()
    found = frames[EXPERT].numpy()
    whole = np.stack(asked, axis=1).reshape(-1, 4)  # [rows, steps]
    np.testing.assert_allclose(found, whole, atol=1e-7)
    assert {0.5, 1.0} <= set(np.unique(found).round(6).tolist())


def test_masked_actions_are_no_targets() -> None:
    """A policy that walks into walls: what is left of it, or else all allowed actions."""

    class North:
        role = "chaser"

        def act(self, view: GameView) -> Any:
            return np.zeros(view.num_games, dtype=np.int32)

    env, _ = games_and_learner(mask_bumps=True, **ROLLOUTS)
    env.reset()
    env.expert = Expert(North(), 1)
    found, allowed = env.expert_probabilities().numpy(), env._observe()["action_mask"].numpy()
    assert allowed[:, 0].any() and not allowed[:, 0].all()
    for row, free in zip(found, allowed, strict=True):
        expected = np.eye(4)[0] if free[0] else free / free.sum()
        np.testing.assert_allclose(row, expected, atol=1e-6)


def test_the_objective_is_the_weighted_mean_of_both_losses() -> None:
    """Against the losses computed by hand; the value and entropy terms stay."""
    _, learner = games_and_learner(imitate="astar", imitate_frames=10_000, **ROLLOUTS)
    frames = learner.collect()
    coefficients = learner.coefficients(0.0)
    whole = {name: column for name, column in frames.items() if name != EXPERT}
    plain, figures = learner.loss(whole, coefficients)
    output = learner.network.policy_head(learner.network.policy_trunk(frames["prepared"]))
    target, logs = frames[EXPERT].double(), output.double().log_softmax(dim=-1)
    cross = -(target * logs).sum(dim=1).mean()
    for weight in (0.0, 0.3, 1.0):
        mixed, _ = learner.loss(frames, coefficients._replace(imitation=weight))
        expected = plain.double() + weight * (cross - figures["loss_objective"].double())
        assert mixed.item() == pytest.approx(expected.item(), abs=1e-5)


def test_the_weight_falls_linearly_to_zero_and_then_nobody_is_asked() -> None:
    env, learner = games_and_learner(imitate="astar", imitate_frames=1024, **ROLLOUTS)
    for frames, weight in ((0, 1.0), (256, 0.75), (512, 0.5), (768, 0.25)):
        assert learner.frames == frames
        assert learner.imitation() == weight
        assert EXPERT in learner.collect() and env.expert is not None
    assert learner.imitation() == 0.0 and env.expert is None
    assert EXPERT not in learner.collect()
    figures = learner.iterate(0.5)
    assert "loss_imitation" not in figures and math.isfinite(figures["loss_objective"])


def test_self_play_and_small_games_imitate(tmp_path: Path) -> None:
    """A side imitates a table, with the numbers of its actions."""
    sides = {"threads": 1, "frames": 4000, "log": "none", "num_games": 64, "minibatch_size": 128}
    settings = self_play_settings_of(
        game="rock_paper_scissors", **sides, imitate="uniform", imitate_frames=10**6
    )
    run: Any = start(SELF_PLAY, settings, tmp_path / "run")
    side = next(iter(run.trainee.sides.values()))
    env, seat = side.env, side.env.player
    biased = TableAgent(seat.task, seat.agent, np.tile([0.7, 0.2, 0.1], 10))
    env.reset()
    env.expert = Expert(biased, 10**6)
    np.testing.assert_allclose(
        env.expert_probabilities().numpy(), [[0.7, 0.2, 0.1]] * env.rows, atol=1e-6
    )
    run.train()
    policy = load_policy(tmp_path / "run" / seat.agent, greedy=False)
    np.testing.assert_allclose(
        policy.table(seat.task).reshape(-1, 3), [[0.7, 0.2, 0.1]] * 10, atol=0.06
    )


@pytest.mark.parametrize("kind", [RUN, SELF_PLAY])
def test_a_run_whose_imitation_is_over_does_not_need_the_policy(kind: str, tmp_path: Path) -> None:
    model = tmp_path / "model"
    start(SELF_PLAY, self_play_settings_of(maze="3x3", frames=300, threads=1), model).train()
    imitated = str(model if kind == SELF_PLAY else model / "chaser")
    how = {"maze": "3x3", "frames": 20_000, "threads": 1, "imitate": imitated, **ROLLOUTS}
    make: Any = settings_of if kind == RUN else self_play_settings_of
    for count in (500, 50_000):
        folder = tmp_path / f"run {count}"
        run: Any = start(kind, make(**how, imitate_frames=count), folder)
        run.train(lambda run, row: setattr(run, "stopped", run.trainee.frames > 2000))
        run.lock and run.lock.release()
    model.rename(tmp_path / "elsewhere")
    resume(tmp_path / "run 500", kind).train()
    with pytest.raises(ValueError, match=r"run 50000: imitate='[^']*': [^:]*: not a policy"):
        resume(tmp_path / "run 50000", kind)


@pytest.mark.parametrize(
    "game",
    [
        SMALL,
        {"task": "maze", "maze": "3x3", "num_goals": 2, "threads": 1, "log": "none"},
        {**SMALL, "num_chasers": 2, "algorithm": "ippo"},
        {"game": "border_control", "threads": 1, "log": "none"},
    ],
    ids=["chase", "maze", "team", "small game"],
)
def test_what_imitates_the_optimum_comes_near_to_it(game: Any, tmp_path: Path) -> None:
    """A start with the optimum to imitate ends nearer to it than without."""
    gaps = []
    for how in ({}, {"imitate": "optimal", "imitate_frames": 15_000}):
        settings = settings_of(**game, **ROLLOUTS, frames=20_000, curriculum="none", **how)
        run: Any = start(RUN, settings, tmp_path / f"run {len(gaps)}")
        run.train()
        found = run.results(episodes=200)["evaluation"]
        gaps.append(abs(found.get("optimality_gap") or found["return_regret"]))
    assert gaps[1] < 0.7 * gaps[0], gaps


def test_names_of_runs_depend_on_what_is_imitated(tmp_path: Path) -> None:
    plain = settings_of(**SMALL, frames=20_000, **ROLLOUTS)
    first = start(RUN, plain, tmp_path / "first")
    first.save()
    names = []
    for imitated in (None, "astar", "random", str(tmp_path / "first")):
        count = 0 if imitated is None else 1000
        settings = settings_of(
            **SMALL, frames=20_000, **ROLLOUTS, imitate=imitated, imitate_frames=count
        )
        names.append(fingerprint(RUN, settings, 10, inputs_of(settings)))
    assert len(set(names)) == 4
    assert names[0] == fingerprint(RUN, plain, 10, {})


# -- what is refused -------------------------------------------------------------------------------


class Wide:
    """Tells probabilities of six actions."""

    role = "chaser"

    def __init__(self, task: Any = None, role: str = "") -> None:
        pass

    def act(self, view: GameView) -> Any:
        return np.full(view.num_games, 5)


class Negative(Wide):
    """Tells no probabilities."""

    def distribution(self, task: Any, games: Any, seat: int) -> Any:
        return np.tile([1.5, -0.5, 0.0, 0.0], (len(games.steps), 1))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of other games, roles and actions."""
    folder = tmp_path_factory.mktemp("imitated")
    made = {
        "evader": {"role": "evader"},
        "maze": {"maze": "5x5"},
        "stay": {"stay_action": True},
        "turns": {"move_order": "chasers_first"},
        "runner": {"task": "maze"},
        "memory": {"recurrent": "gru"},
        "exits": {"task": "escape", "num_exits": 1},
        "crowd": {"maze": "5x5", "num_chasers": 12, "observation": "window:3"},
    }
    for name, changed in made.items():
        flat = {**SMALL, **ROLLOUTS, "frames": 20_000, **changed}
        if name == "runner":
            del flat["opponent_epsilon"]
        settings = settings_of(**flat)
        start(RUN, settings, folder / name).save()
    return folder


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"imitate_frames": 0}, "imitate='astar' and imitate_frames=0; give both"),
        ({"imitate": None}, "imitate=None and imitate_frames=5; give both"),
        ({"imitate_frames": -5}, "imitate_frames=-5; give 0 or more"),
        ({"imitate": ""}, "imitate=; give a policy, or leave it out"),
        ({"imitate": "nobody"}, "'nobody': not a policy"),
        ({"imitate": "evader"}, "is a policy for 'evader', not for 'chaser'"),
        ({"imitate": "maze"}, "was trained in maze 5x5, not in 3x3"),
        ({"imitate": "stay"}, "was trained with stay_action=True, not False"),
        ({"imitate": "turns"}, "was trained with move_order=chasers_first"),
        ({"imitate": "crowd"}, r"imitate='([^']*crowd)': \1: 13 agents and 0 goals need 13"),
        ({"imitate": "exits"}, "was trained with 1 exits, not 0; use as many: task escape, exits"),
        ({"imitate": "runner"}, "is a policy for 'runner'"),
        ({"imitate": "memory"}, "is a policy with memory"),
        ({"imitate": "sweeping"}, "is a policy with memory"),
        ({"imitate": "shown:Wide"}, "the chaser has 4 actions: north, south, east, west"),
        ({"imitate": "shown:Negative"}, r"gave no probabilities of shape \(2, 4\)"),
        ({"algorithm": "dqn"}, "algorithm='dqn', which does not learn from rollouts; use ppo, a2c"),
        ({"algorithm": "sb3_ppo"}, "algorithm='sb3_ppo', which does not learn from rollouts"),
        ({"algorithm": "cross_entropy", "num_games": 64}, "algorithm='cross_entropy', which does"),
        ({"algorithm": "ippo", "num_chasers": 2, "sharing": "joint"}, "sharing='joint', where"),
        ({"processes": 2, "num_games": 64}, "imitate='astar' with processes=2; leave it out"),
    ],
)  # fmt: skip
def test_what_cannot_be_imitated_is_refused(
    changed: dict[str, Any], message: str, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: Any = ModuleType("shown")
    shown.Wide, shown.Negative = Wide, Negative
    monkeypatch.setitem(sys.modules, "shown", shown)
    flat = {"imitate": "astar", "imitate_frames": 5, **changed}
    if (runs / (flat["imitate"] or "none")).is_dir() and flat["imitate"]:
        flat["imitate"] = str(runs / flat["imitate"])
    algorithm = flat.get("algorithm", "ppo")
    with pytest.raises(ValueError, match=message):
        settings_of(**{**SMALL, **sizes(algorithm), "frames": 20_000, **flat})


def test_an_opponent_that_does_not_fit_is_named(runs: Path) -> None:
    task = TaskSettings(maze="3x3", role="evader", opponent=str(runs / "maze"))
    with pytest.raises(ValueError, match=r"maze \(sampled\), trained in task 'chase' on 5x5"):
        contest_of(task, 10).baselines()


@pytest.mark.parametrize("make", [settings_of, self_play_settings_of])
def test_an_imitation_that_outlasts_the_run_is_warned_of(make: Any) -> None:
    flat = {"maze": "3x3", "imitate": "astar", **ROLLOUTS, "frames": 20_000}
    with pytest.warns(UserWarning, match="imitate_frames=20001 with frames=20000: the run ends"):
        make(**flat, imitate_frames=20_001)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", "imitate_frames")
        make(**flat, imitate_frames=20_000)


def test_self_play_refuses_what_it_cannot_imitate() -> None:
    with pytest.raises(ValueError, match="imitate='sweeping': is a policy with memory"):
        self_play_settings_of(maze="3x3", frames=5000, imitate="sweeping", imitate_frames=5)


def test_an_arm_and_a_whole_role_of_another_game_are_refused(tmp_path: Path) -> None:
    arm = {"task": "reacher", "joints": 1, "frames": 20_000, "threads": 1, "imitate_frames": 5}
    for name, message in (("random", "no policies by name"), ("optimal", "take another game")):
        for discrete in (False, True):
            with pytest.raises(ValueError, match=f"imitate='{name}': .*an arm has .*{message}"):
                settings_of(**arm, imitate=name, discrete_actions=discrete)
    with pytest.raises(ValueError, match="'optimal' is the best response to fixed agents"):
        start(
            SELF_PLAY,
            self_play_settings_of(maze="3x3", frames=5000, imitate="optimal", imitate_frames=5),
            tmp_path / "play",
        )
    assert not (tmp_path / "play").exists()
