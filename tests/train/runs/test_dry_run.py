"""Whatever the end of a run needs is built once before training, so that no run fails only then."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from self_play_runs import side_by
from test_resumption import CHASER, PPO, RUNNER, SUITE, both, check_same, tiny

from pursuit.simulator.policy import GameView
from pursuit.tasks.task import Task
from scripted_agents.names import POLICIES
from train.commands.main import main
from train.evaluation.sides import ResultLimits
from train.kinds import start
from train.runs.folder import METRICS, RESULTS, RUN, SELF_PLAY, load_checkpoint, load_results
from train.runs.loop import Run


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 1)
    monkeypatch.setattr("train.runs.single.EPISODES", 10)
    for place in ("contest", "hidden_contest"):
        monkeypatch.setattr(f"train.evaluation.{place}.SEARCH_SECONDS", 0.1)
    monkeypatch.setattr(
        "train.self_play.trainee.ResultLimits", partial(ResultLimits, search_seconds=0.1)
    )


ALONE: list[dict[str, Any]] = [
    RUNNER,
    {**RUNNER, "recurrent": "gru"},
    {**RUNNER, "frame_stack": 2, "view_radius": 1},
    {**RUNNER, "algorithm": "dqn", "unknown_maze": "all"},
    {**RUNNER, "algorithm": "q_learning"},
    {key: value for key, value in SUITE.items() if key != "score_every"},
    CHASER,
    {**CHASER, "algorithm": "cross_entropy", "role": "evader", "line_of_sight": "all"},
    {**CHASER, "view_radius": 1, "recurrent": "gru"},
    {**CHASER, "num_chasers": 2, "num_evaders": 2, "view_radius": 1},
    {**CHASER, "num_chasers": 3, "opponent": "searching", "view_radius": "evader=1"},
    {**CHASER, "task": "heist", "num_chasers": 2, "algorithm": "a2c", "frame_stack": 2},
    {**CHASER, "task": "heist", "role": "evader", "view_radius": 1},
    {**CHASER, "task": "race", "num_runners": 3},
    {**CHASER, "maze": "suite:5x5-train/0-3", "observation": "planes", "view_radius": 2},
    {"task": "reacher", "joints": 2, "max_steps": 12, "hold": 2},
    {"task": "reacher", "joints": 2, "max_steps": 12, "discrete_actions": True, "algorithm": "dqn"},
]
GAMES: list[dict[str, Any]] = [
    {},
    {"view_radius": "1"},
    {"num_chasers": 2},
    {"num_chasers": 2, "view_radius": "1"},
    {"num_evaders": 2, "line_of_sight": "chaser"},
    {"num_chasers": 2, "num_evaders": 2, "unknown_maze": "all"},
    {"task": "heist", "num_chasers": 2, "view_radius": "evader=1"},
]
SIDES: list[dict[str, Any]] = [
    {},
    {"hyper": {"recurrent": "gru"}},
    {"frame_stack": 2},
    {"chaser": "dqn"},
    {"evader": "searching", "sampling": "latest"},
    {"sampling": "psro", "pool_size": 9, "members": ("astar",)},
]


def name_of(changes: dict[str, Any]) -> str:
    return " ".join(map(str, chain.from_iterable(changes.items()))) or "plain"


@pytest.mark.parametrize("flat", ALONE, ids=name_of)
def test_every_kind_of_run_ends_with_results(flat: dict[str, Any], tmp_path: Path) -> None:
    run = start(RUN, tiny(**{"algorithm": "ppo", "frames": 100, **flat}), tmp_path)
    run.train()
    run.results(episodes=4)
    assert load_results(tmp_path)["frames"] >= 100


def sides_from(changes: dict[str, Any]) -> dict[str, Any]:
    given = {**changes, "hyper": replace(PPO, **changes.get("hyper", {}))}
    if given.get("chaser") == "dqn":
        small = {"num_games": 24, "width": 8, "batch_size": 16, "learning_starts": 30}
        given["chaser"] = side_by("dqn", **small, buffer_size=400, gradient_steps=1)
    return given


PAIRS = [
    # two diagonals through all games and sides
    pytest.param(game, sides, id=f"{name_of(game)}, {name_of(sides)}")
    for shift in (0, 4)
    for row, game in enumerate(GAMES)
    for sides in [SIDES[(row + shift) % len(SIDES)]]
]


@pytest.mark.parametrize("game, sides", PAIRS)
def test_every_kind_of_self_play_ends_with_results(
    game: dict[str, Any], sides: dict[str, Any], tmp_path: Path
) -> None:
    if sides.get("chaser") == "dqn" and game.get("num_chasers", 1) > 1:
        game = {**game, "num_chasers": 1}  # teams learn by PPO and A2C
    given = {"frames": 150, "snapshots": 2, "best_response_seconds": 0.01, **sides_from(sides)}
    run = start(SELF_PLAY, both(game, **given), tmp_path)
    run.train()
    run.results(episodes=4)
    assert load_results(tmp_path)["frames"] >= 150


# -- failures --------------------------------------------------------------------------------------


def fail(*given: Any, **named: Any) -> Any:
    raise ValueError("cannot be evaluated")


@pytest.mark.parametrize(
    "broken",
    ["contest.GameContest.baselines", "contest.GameContest.reference", "contest.exact_match"],
)
def test_what_cannot_be_evaluated_is_an_error_before_training(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = start(RUN, tiny("ppo", **CHASER), tmp_path)
    monkeypatch.setattr(f"train.evaluation.{broken}", fail)
    with pytest.raises(ValueError, match="cannot be evaluated"):
        run.train()
    assert run.trainee.frames == 0 and not (tmp_path / METRICS).exists()


@pytest.mark.parametrize(
    "broken, task",
    [
        ("evaluation.maze_sides.matches", {}),
        ("evaluation.maze_sides.diversity_of", {}),
        ("self_play.mixtures.mixture_bounds", {}),
        ("evaluation.maze_sides.limited_best_responses", {"view_radius": "1"}),
        ("evaluation.maze_sides.exact_best_responses", {"num_chasers": 2}),
        ("evaluation.maze_sides.whole_game", {"num_evaders": 2}),
        ("self_play.trainee.build_run", {"num_evaders": 2}),
    ],
)
def test_what_self_play_cannot_evaluate_is_an_error_before_training(
    broken: str, task: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = both(task, sampling="uniform", best_response_seconds=0.01)
    run = start(SELF_PLAY, settings, tmp_path)
    monkeypatch.setattr(f"train.{broken}", fail)
    with pytest.raises(ValueError, match="cannot be evaluated"):
        run.train()
    assert run.trainee.frames == 0


@pytest.mark.parametrize(
    "command, broken",
    [
        ("train", "pursuit.rendering.animation.save_animation"),
        ("train", "train.runs.report.write_page"),
        ("train", "train.runs.pictures.draw_panels"),
        ("self-play", "train.self_play.report.draw_league"),
    ],
)
def test_what_cannot_be_drawn_is_an_error_before_training(
    command: str, broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(broken, fail)
    small = ["--maze", "3x3", "--num-games", "24", "--minibatch-size", "64", "--frames", "2000"]
    given = [command, *small, "--max-steps", "12", "--episodes", "4", "--out"]
    with pytest.raises(SystemExit) as ended:
        main([*given, str(tmp_path / "run")])
    assert ended.value.code == 2 and "cannot be evaluated" in capsys.readouterr().err
    assert not (tmp_path / "run" / RESULTS).exists()
    main([*given, str(tmp_path / "plain"), "--no-report"])
    names = {path.name for path in (tmp_path / "plain").iterdir()}
    assert {"results.json", "checkpoint.pt", METRICS} <= names
    assert not {name for name in names if name.endswith((".png", ".gif", ".svg", ".html"))}


# -- nothing depends on it -------------------------------------------------------------------------


class OwnStream:
    """A policy with random numbers of its own."""

    def __init__(self, task: Task, role: str) -> None:
        self.rng, self.actions = np.random.default_rng(3), task.num_actions

    def act(self, view: GameView) -> NDArray[np.int32]:
        return self.rng.integers(0, self.actions, view.num_games).astype(np.int32)


@pytest.mark.parametrize(
    "kind, changes",
    [
        (RUN, {**RUNNER, "recurrent": "gru"}),
        (RUN, {**RUNNER, "algorithm": "dqn"}),
        (RUN, {**CHASER, "opponent": "own stream"}),
        (SELF_PLAY, {"sampling": "uniform", "members": ("astar",)}),
    ],
)
def test_a_run_does_not_depend_on_its_dry_run(
    kind: str, changes: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    POLICIES.register("own stream", OwnStream)
    try:
        ends = []
        for name in ("with", "without"):
            made = both(**changes) if kind == SELF_PLAY else tiny(**{"algorithm": "ppo", **changes})
            run = start(kind, made, tmp_path / name)
            run.train()
            ends.append((load_checkpoint(tmp_path / name), run.results(episodes=4)["evaluation"]))
            monkeypatch.setattr(Run, "dry_run", lambda run: None)
        check_same(ends[0], ends[1], "run")
    finally:
        POLICIES.remove("own stream")
