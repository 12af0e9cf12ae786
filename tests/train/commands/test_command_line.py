"""The command `pursuit`: runs that survive interruption, and errors of one line."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import socket
import sys
import tomllib
from pathlib import Path
from typing import Any

import gymnasium
import pytest
import torch
from command_errors import error_of, run

from pursuit import Recorder
from train.commands.main import COMMANDS, OPTIONAL, main, message_of
from train.experiments.executors import check_answers
from train.runs.folder import read_metrics
from train.runs.report import describe_loops

ROOT = Path(__file__).parents[3]

TINY = [
    *("--maze", "3x3", "--num-games", "16", "--rollout-steps", "8", "--minibatch-size", "64"),
    *("--width", "16", "--threads", "1", "--episodes", "50"),
]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "chase"
    run("train", *TINY, "--frames", "4096", "--out", folder)
    return folder


def evaluation_in(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())["evaluation"]
    return found


def test_a_run_leaves_a_complete_folder(trained: Path) -> None:
    for name in (
        *("config.json", "metrics.csv", "results.json", "checkpoint.pt"),
        *("learning_curve.png", "replay.gif", "tensorboard"),
    ):
        assert (trained / name).exists(), name
    assert not list(trained.glob(".*.part"))
    assert list((trained / "tensorboard").rglob("events.*"))
    results = json.loads((trained / "results.json").read_text())
    assert {"task", "maze", "algorithm", "frames", "seconds", "frames_per_second"} <= set(results)
    evaluation = results["evaluation"]
    assert evaluation["exact"] and evaluation["ci95"] == 0.0
    gap = evaluation["mean_steps"] / evaluation["optimal_steps"] - 1
    assert evaluation["optimality_gap"] == pytest.approx(gap) and gap >= 0
    assert {score["name"] for score in results["scores"]} >= {"random", "optimal", "learned"}
    rows = read_metrics(trained)
    assert rows[-1]["frames"] == results["frames"] == 4096


@pytest.mark.parametrize(
    ("role", "greedy", "drawn", "told"),
    [
        ("runner", 0.996, 1.0, "from 0.4 % of the starts"),
        ("runner", 1.0, 1.0, ""),
        ("runner", 0.99, 0.98, ""),
        ("runner", 0.9999, 1.0, ""),
        ("runner", 0.5, 1.0, ""),  # it has yet to learn
        ("chaser", 0.99, 1.0, ""),
    ],
)
def test_advice_for_greedy_policies_that_loop(
    role: str, greedy: float, drawn: float, told: str
) -> None:
    scores = [
        {"name": "learned", "success_rate": greedy},
        {"name": "learned, sampled", "success_rate": drawn},
    ]
    objective = {"column": "mean_steps", "unit": "steps", "less_is_better": True}
    found = describe_loops({"role": role, "scores": scores, "objective": objective})
    assert told in found and bool(found) == bool(told) == ("--frame-stack 2" in found)


@pytest.mark.slow
def test_teams_are_trained_and_compared_with_their_optimum(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for team, exact in (("--num-chasers", True), ("--num-evaders", False)):
        out = tmp_path / team
        run("train", *TINY, team, "2", "--frames", "1024", "--no-report", "--out", out)
        evaluation = evaluation_in(out / "results.json")
        assert evaluation["exact"] == exact
        assert evaluation["optimal_steps"] > 0 and evaluation["optimality_gap"] is not None
        assert -1e-9 < evaluation["objective_gap"] < evaluation["optimality_gap"]
        hint = "one of 2 chasers learns, the other one is fixed; to train all: "
        found = re.findall(f"^{hint}(.*)", capsys.readouterr().out, re.MULTILINE)
        assert found == ["--algorithm ippo"] * exact, found
    all_of_them = ("--algorithm", "ippo", "--num-chasers", "2", "--frames", "512", "--no-report")
    run("train", *TINY, *all_of_them, "--out", tmp_path / "all")
    printed = capsys.readouterr().out
    assert "to train all" not in printed and "team of 2 chasers: " in printed
    team = json.loads((tmp_path / "all" / "results.json").read_text())["team"]
    assert {*team["members"]} == {"chaser_0", "chaser_1"}


@pytest.mark.parametrize(
    ("game", "gamma"), [(["--role", "evader"], 0.9), (["--task", "maze"], 0), ([], 0)]
)
def test_results_with_discount_0_have_no_objective_gap(
    game: list[str], gamma: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ("--frames", "256", "--no-report", "--out", tmp_path / "run")
    run("train", *TINY, *game, "--gamma", gamma, *short)
    run("evaluate", tmp_path / "run", "--episodes", "50", "--out", tmp_path / "again.json")
    assert ("(discount 0" in capsys.readouterr().out) == (gamma > 0)
    for path in (tmp_path / "run" / "results.json", tmp_path / "again.json"):
        evaluation = evaluation_in(path)
        assert evaluation["optimal_steps"] > 0
        assert (evaluation["objective_gap"] is None) == (gamma == 0)


def test_outputs_of_evaluate_render_and_baseline(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("evaluate", trained, "--episodes", "200", "--out", tmp_path / "again.json")
    again, first = map(evaluation_in, (tmp_path / "again.json", trained / "results.json"))
    assert again["mean_steps"] == first["mean_steps"]  # both exact
    run("render", trained, "--out", tmp_path / "a.gif", "--episodes", "1")
    run("render", "--task", "maze", "--optimal", "--out", tmp_path / "b.gif", "--episodes", "1")
    assert (tmp_path / "a.gif").stat().st_size > 1000 < (tmp_path / "b.gif").stat().st_size
    capsys.readouterr()
    run("baseline", "--task", "maze", "--maze", "5x5", "--num-goals", "3", "--episodes", "500")
    output = capsys.readouterr().out
    assert "random" in output and "optimal" in output and "58,100" in output
    run("maze", "5x5")
    assert "loops" in capsys.readouterr().out
    run("maze", "--generate", "wilson", "--height", "4", "--seed", "3", "--out", tmp_path / "m.txt")
    run("baseline", "--maze", tmp_path / "m.txt", "--episodes", "50")
    assert "optimal" in capsys.readouterr().out


def test_view_names_the_file_and_the_episode_of_a_bad_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorder = Recorder(gymnasium.make("pursuit/Maze-v0", maze="3x3", max_steps=2))
    recorder.reset(seed=0)
    for _ in range(2):
        recorder.step(0)
    good = recorder.save(tmp_path / "good.json")
    content = json.loads(good.read_text())
    content["episodes"][0]["start"]["positions"] = [99]
    bad = tmp_path / "bad.json"
    bad.write_text(json.dumps(content))
    out = ("--out", tmp_path / "page.html", "--no-open")
    assert f"{bad}: episode 0: positions=[99]; " in error_of(capsys, "view", good, bad, *out)


@pytest.mark.slow
def test_a_run_on_a_maze_file_does_not_need_the_file_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maze = tmp_path / "mine.txt"
    run("maze", "--generate", "prim", "--height", "3", "--out", maze)
    run(
        "train", *TINY, "--maze", maze, "--frames", "1024", "--no-report", "--out", tmp_path / "run"
    )
    maze.unlink()
    capsys.readouterr()
    run("evaluate", tmp_path / "run", "--episodes", "50", "--out", tmp_path / "again.json")
    assert f"on maze {maze} (9 cells" in capsys.readouterr().out
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["evaluation"]["exact"] and again["maze"] == str(maze)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fly"], ["fly", "train"]),
        (["train", "--maze", "5x6"], ["5x6", "5x5"]),
        (["train", "--role", "ghost"], ["ghost", "chaser"]),
        (["train", "--task", "maze", "--role", "evader"], ["evader", "runner"]),
        (["train", "--opponent-epsilon", "1.5"], ["1.5", "[0, 1]"]),
        (["train", "--num-evaders", "25"], ["25", "cells"]),
        (["train", "--task", "maze", "--num-goals", "0"], ["num_goals"]),
        (["train", "--task", "maze", "--num-goals", "25"], ["25"]),
        (["train", "--max-steps", "0"], ["max_steps"]),
        (
            ["train", "--max-steps", "100001"],
            ["max_steps=100001; give at most 100000", "no agent"],
        ),
        (["baseline", "--task", "reacher", "--max-steps", "100001"], ["at most 100000"]),
        (["train", "--seconds", "-3"], ["-3"]),
        (["train", "--frames", "0"], ["frames=0"]),
        (["train", "--frames", "10", "--seconds", "5"], ["one of the two"]),
        (["train", "--seed", "-1"], ["seed"]),
        (["train", "--learning-rate", "0"], ["learning_rate"]),
        (["train", "--gamma", "1.1"], ["gamma"]),
        (["train", "--minibatch-size", "99999999"], ["minibatch_size"]),
        (["train", "--minibatch-size", "1"], ["minibatch_size=1", "at least 2 frames"]),
        (
            ["train", "--algorithm=a2c", "--role=evader", "--num-games=1", "--rollout-steps=1"],
            ["standardize_advantages=True", "raise num_games"],
        ),
        (["train", "--width", "wide"], ["--width 'wide': give a whole number"]),
        (["train", "--seconds", "x"], ["--seconds 'x': give a number"]),
        (["train", "--frams", "3"], ["perhaps you meant --frames"]),
        (["train", "--num-games", "1000000000"], ["num_games=1000000000", "are free here"]),
        (["train", "--width", "1000000000"], ["width=1000000000", "are free here; lower it"]),
        (["self-play", "--width", "1000000000"], ["width=1000000000", "are free here"]),
        (
            ["train", "--algorithm", "dqn", "--buffer-size", "100000000000"],
            ["buffer_size=100000000000", "are free here"],
        ),
        (["train", "--task", "maze", "--opponent", "random"], ["random", "has no other role"]),
        (["train", "--device", "tpu"], ["tpu", "cuda"]),
        (["train", "--device", "cuda:x"], ["unknown device 'cuda:x'", "cuda:0"]),
        (["self-play", "--device", "cuda:-1"], ["unknown device 'cuda:-1'", "cuda:0"]),
        (["train", "--device", "cuda:300"], ["unknown device 'cuda:300'", "cuda:0"]),
        (["train", "--precision", "float8"], ["float8"]),
        (["render", "--episodes", "100000000"], ["episodes=100000000", "give 1 to 1000 episodes"]),
        (["view", "a", "b", "--episodes", "1001"], ["episodes=1001", "give 1 to 1000 episodes"]),
        (["evaluate", "a", "--replay-episodes", "0"], ["replay_episodes=0", "give 1 to 1000"]),
        (["train", "--resume", "/nowhere/at/all"], ["/nowhere/at/all"]),
        (["evaluate", "/nowhere/at/all"], ["/nowhere/at/all"]),
        (["evaluate"], ["run"]),
        (["render", "--out", "replay.avi"], ["avi"]),
        (["baseline", "--episodes", "0"], ["episodes"]),
        (["baseline", "--rewards", "gold"], ["gold"]),
        (["maze", "nowhere.txt"], ["nowhere.txt"]),
        (["maze", "--generate", "cellular"], ["cellular", "prim"]),
        (["maze", "--generate", "prim", "--loops", "2"], ["loops"]),
    ],
)
def test_wrong_arguments_are_one_line_that_names_value_and_remedy(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    if arguments[0] in ("train", "self-play") and "--resume" not in arguments:
        arguments = [*arguments, "--out", str(tmp_path / "run")]
    line = error_of(capsys, *arguments)
    for word in words:
        assert word in line
    for other in ("None}", "<class", "Errno", ".part", " | None", "Traceback"):
        assert other not in line
    assert not (tmp_path / "run" / "config.json").exists()


def test_a_folder_that_holds_a_run_or_anything_else_is_left_alone(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in trained.iterdir()}
    assert "contains a run" in error_of(capsys, "train", *TINY, "--frames", 64, "--out", trained)
    assert {path.name: path.stat().st_mtime_ns for path in trained.iterdir()} == before
    (tmp_path / "thesis.txt").write_text("dear")
    assert "not empty" in error_of(capsys, "train", *TINY, "--frames", 64, "--out", tmp_path)
    assert "a file" in error_of(
        capsys, "train", *TINY, "--frames", 64, "--out", tmp_path / "thesis.txt"
    )


@pytest.mark.filterwarnings("ignore:.*games stay on the CPU")
@pytest.mark.parametrize("command", ["train", "self-play"])
def test_a_gpu_that_is_not_here_leaves_no_folder(
    command: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = (command, "--maze", "3x3", "--frames", "64", "--out", tmp_path / "run", "--device")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert "finds no GPU; use --device cpu" in error_of(capsys, *given, "cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert "finds 2 GPUs; use --device cuda:0 to cuda:1" in error_of(capsys, *given, "cuda:2")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert "finds one GPU; use --device cuda" in error_of(capsys, *given, "cuda:1")
    assert not (tmp_path / "run").exists()


def test_an_address_without_a_cluster_is_refused_at_once() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # without a listener
        port = taken.getsockname()[1]
        for address in (f"127.0.0.1:{port}", f"ray://127.0.0.1:{port}"):
            with pytest.raises(ValueError, match="no Ray cluster answers there"):
                check_answers(address)
        taken.listen()
        check_answers(f"127.0.0.1:{port}")
    for address in ("nowhere", "host:", "host:0", ":6379", "host:99999"):
        with pytest.raises(ValueError, match="give auto, HOST:PORT"):
            check_answers(address)
    for address in (None, "auto", "local"):
        check_answers(address)


def test_system_errors_are_reported_without_their_number(tmp_path: Path) -> None:
    with pytest.raises(OSError) as caught:
        (tmp_path / "missing").read_text()
    assert message_of(caught.value) == f"{tmp_path / 'missing'}: No such file or directory"


@pytest.mark.parametrize("name", OPTIONAL)
def test_a_missing_package_is_named_with_its_extra(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError) as caught:
        importlib.import_module(name)
    extra = re.search(r"pip install 'pursuit\[(\w+)\]'", message_of(caught.value))
    assert extra is not None
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    packages = project["optional-dependencies"][extra[1]]
    assert any(package.startswith(name) for package in packages)


def test_every_command_has_a_help_that_names_its_options(
    capsys: pytest.CaptureFixture[str],
) -> None:
    main(["--help"])
    assert "evaluate" in capsys.readouterr().out
    said = {}
    for command in COMMANDS:
        with pytest.raises(SystemExit) as stopped:
            main([command, "--help-all" if command in ("train", "self-play") else "--help"])
        assert stopped.value.code == 0
        said[command] = capsys.readouterr().out
        assert "--" in said[command] and "--no-no-" not in said[command]
    assert "--anneal, --no-anneal" in said["train"] and "--role" in said["train"]
    assert not any(f"--{name} " in said["self-play"] for name in ("role", "opponent"))


@pytest.mark.parametrize(
    "command",
    [
        ("compare", "ppo"),
        ("sweep", "reacher_by_joints"),
        ("ablate", "opponent-epsilon"),
        ("reproduce", "figure-2.2"),
    ],
)
def test_the_command_printed_after_an_interruption_is_quoted(
    command: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("train.experiments.executors.run_locally", interrupted)
    again = [*command, "--out", str(tmp_path / "it's mine; or $HOME")]
    with pytest.raises(SystemExit):
        main(again)
    kept, _, said = capsys.readouterr().err.partition("Continue with: ")
    assert shlex.split(said) == ["pursuit", *again]
    assert kept == "\ninterrupted; no run has saved anything yet. "
