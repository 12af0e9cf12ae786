"""The command `pursuit`: runs that survive interruption, and errors of one line."""

from __future__ import annotations

import json
import os
import pickle
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from waiting import PATIENCE, wait_until

from pursuit.files import write_atomically
from train.commands.main import COMMANDS, main, message_of
from train.experiments.executors import check_answers
from train.runs.folder import CHECKPOINT, load_checkpoint, read_metrics
from train.runs.report import describe_loops

TINY = [
    *("--maze", "3x3", "--num-games", "16", "--rollout-steps", "8", "--minibatch-size", "64"),
    *("--width", "16", "--threads", "1", "--episodes", "50"),
]


def run(*arguments: str) -> None:
    main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "chase"
    run("train", *TINY, "--frames", "4096", "--out", folder)
    return folder


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
    "task",
    [
        pytest.param(["--task", "maze", "--num-goals", "2"], marks=pytest.mark.slow),
        ["--role", "evader"],
    ],
)
def test_runners_and_evaders_are_trained_too(task: list[str], tmp_path: Path) -> None:
    run("train", *TINY, *task, "--frames", "1024", "--out", tmp_path / "run")
    evaluation = json.loads((tmp_path / "run" / "results.json").read_text())["evaluation"]
    assert evaluation["optimal_steps"] > 0 and "objective_gap" in evaluation


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
    for number, (team, exact) in enumerate((("--num-chasers", True), ("--num-evaders", False))):
        out = tmp_path / str(number)
        run("train", *TINY, team, "2", "--frames", "1024", "--out", out)
        evaluation = json.loads((out / "results.json").read_text())["evaluation"]
        assert evaluation["exact"] == exact
        assert evaluation["optimal_steps"] > 0 and evaluation["optimality_gap"] is not None
        assert -1e-9 < evaluation["objective_gap"] < evaluation["optimality_gap"]
        hint = "one of 2 chasers learns, the other one is fixed; to train all: "
        found = re.findall(f"^{hint}(.*)", capsys.readouterr().out, re.MULTILINE)
        assert found == ["--algorithm ippo"] * (team == "--num-chasers"), found
    all_of_them = ("--algorithm", "ippo", "--num-chasers", "2", "--frames", "512")
    run("train", *TINY, *all_of_them, "--out", tmp_path / "all")
    printed = capsys.readouterr().out
    assert "to train all" not in printed and "team of 2 chasers: " in printed
    assert {*json.loads((tmp_path / "all" / "results.json").read_text())["team"]["members"]} == {
        "chaser_0",
        "chaser_1",
    }


@pytest.mark.parametrize("task", [pytest.param("maze", marks=pytest.mark.slow), "chase"])
def test_results_with_discount_0_have_no_objective_gap(
    task: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("train", *TINY, "--task", task, "--gamma", "0", "--frames", "256", "--out", tmp_path / task)
    run("evaluate", tmp_path / task, "--episodes", "50", "--out", tmp_path / "again.json")
    assert "discount 0" not in capsys.readouterr().out
    for path in (tmp_path / task / "results.json", tmp_path / "again.json"):
        evaluation = json.loads(path.read_text())["evaluation"]
        assert evaluation["optimal_steps"] > 0 and evaluation["objective_gap"] is None


@pytest.mark.slow
def test_a_killed_run_resumes_to_the_same_weights_bit_for_bit(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    run("train", *TINY, "--frames", "6144", "--out", whole)
    command = [sys.executable, "-m", "train.commands.main", "train", *TINY]
    process = subprocess.Popen(
        [*command, "--frames", "6144", "--out", str(killed)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    wait_until((killed / CHECKPOINT).exists, process)
    process.kill()
    process.communicate()
    state = load_checkpoint(killed)
    # The run is killed before its end on all usual machines.
    if state["trainee"]["learner"]["frames"] < 6144:
        assert not (killed / "results.json").exists()
        run("train", "--resume", killed, "--episodes", "50")
    first, second = load_checkpoint(whole), load_checkpoint(killed)
    assert first["trainee"]["learner"]["frames"] == second["trainee"]["learner"]["frames"] == 6144
    for name, tensor in first["trainee"]["learner"]["network"].items():
        assert torch.equal(tensor, second["trainee"]["learner"]["network"][name]), name
    for name, tensor in first["trainee"]["simulator"].items():
        assert torch.equal(
            tensor.nan_to_num(), second["trainee"]["simulator"][name].nan_to_num()
        ), name
    rows = [[row["frames"] for row in read_metrics(folder)] for folder in (whole, killed)]
    assert rows[0] == rows[1]


def test_control_c_saves_and_reports_and_the_run_resumes(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "train.commands.main", "train", *TINY),
            *("--frames", "3000000", "--out", str(folder)),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_until((folder / CHECKPOINT).exists, process)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, errors
    assert "interrupted" in errors and "Traceback" not in errors
    assert "optimal" in output
    assert json.loads((folder / "results.json").read_text())["interrupted"]
    assert load_checkpoint(folder)["trainee"]["learner"]["frames"] > 0


def test_outputs_of_evaluate_render_and_baseline(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("evaluate", trained, "--episodes", "200", "--out", tmp_path / "again.json")
    again = json.loads((tmp_path / "again.json").read_text())["evaluation"]
    first = json.loads((trained / "results.json").read_text())["evaluation"]
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


@pytest.mark.slow
def test_a_run_on_a_maze_file_does_not_need_the_file_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maze = tmp_path / "mine.txt"
    run("maze", "--generate", "prim", "--height", "3", "--out", maze)
    run("train", *TINY, "--maze", maze, "--frames", "1024", "--out", tmp_path / "run")
    maze.unlink()
    capsys.readouterr()
    run("evaluate", tmp_path / "run", "--episodes", "50", "--out", tmp_path / "again.json")
    assert f"on maze {maze} (9 cells" in capsys.readouterr().out
    again = json.loads((tmp_path / "again.json").read_text())
    assert again["evaluation"]["exact"] and again["maze"] == str(maze)


def error_of(capsys: pytest.CaptureFixture[str], *arguments: Any) -> str:
    """The one line that a command says before it exits with status 2."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        run(*arguments)
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if "compiling kernels" not in line]
    assert len(lines) == 1 and lines[0].startswith("pursuit: error:"), error
    return lines[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["fly"], ["fly", "train"]),
        (["train", "--maze", "5x6"], ["5x6", "5x5"]),
        (["train", "--task", "tag"], ["tag", "chase"]),
        (["train", "--role", "ghost"], ["ghost", "chaser"]),
        (["train", "--task", "maze", "--role", "evader"], ["evader", "runner"]),
        (["train", "--algorithm", "sarsa"], ["sarsa", "ppo"]),
        (["train", "--observation", "pixels"], ["pixels", "one_hot"]),
        (["train", "--opponent-epsilon", "1.5"], ["1.5", "[0, 1]"]),
        (["train", "--opponent-epsilon", "nan"], ["nan", "[0, 1]"]),
        (["train", "--num-evaders", "25"], ["25", "cells"]),
        (["train", "--num-chasers", "-1"], ["-1"]),
        (["train", "--task", "maze", "--num-goals", "0"], ["num_goals"]),
        (["train", "--task", "maze", "--num-goals", "25"], ["25"]),
        (["train", "--max-steps", "0"], ["max_steps"]),
        (
            ["train", "--max-steps", "100001"],
            ["max_steps=100001; give at most 100000", "no agent"],
        ),
        (["baseline", "--task", "reacher", "--max-steps", "100001"], ["at most 100000"]),
        (["train", "--seconds", "-3"], ["-3"]),
        (["train", "--seconds", "nan"], ["nan"]),
        (["train", "--frames", "0"], ["frames=0"]),
        (["train", "--frames", "10", "--seconds", "5"], ["one of the two"]),
        (["train", "--seed", "-1"], ["seed"]),
        (["train", "--learning-rate", "0"], ["learning_rate"]),
        (["train", "--gamma", "1.1"], ["gamma"]),
        (["train", "--minibatch-size", "99999999"], ["minibatch_size"]),
        (["train", "--minibatch-size", "1"], ["minibatch_size=1", "at least 2 frames"]),
        (
            [
                "train",
                "--algorithm",
                "a2c",
                "--role",
                "evader",
                "--num-games",
                "1",
                "--rollout-steps",
                "1",
            ],
            ["standardize_advantages=True", "raise num_games"],
        ),
        (["train", "--width", "wide"], ["--width 'wide': give a whole number"]),
        (["train", "--frames", "abc"], ["--frames 'abc': give a whole number"]),
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
        (["train", "--no-such-option", "3"], ["no-such-option"]),
        (["train", "--device", "tpu"], ["tpu", "cuda"]),
        (["train", "--device", "cuda:"], ["unknown device 'cuda:'", "cpu, cuda, or", "cuda:0"]),
        (["train", "--device", "cuda:x"], ["unknown device 'cuda:x'", "cuda:0"]),
        (["self-play", "--device", "cuda:-1"], ["unknown device 'cuda:-1'", "cuda:0"]),
        (["train", "--device", "cuda:300"], ["unknown device 'cuda:300'", "cuda:0"]),
        (["train", "--precision", "float8"], ["float8"]),
        (["train", "--resume", "/nowhere/at/all"], ["/nowhere/at/all"]),
        (["evaluate", "/nowhere/at/all"], ["/nowhere/at/all"]),
        (["evaluate"], ["run"]),
        (["render", "--out", "replay.avi"], ["avi"]),
        (["baseline", "--episodes", "0"], ["episodes"]),
        (["baseline", "--rewards", "gold"], ["gold"]),
        (["maze"], ["maze"]),
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
    assert "complete" in error_of(capsys, "train", "--resume", trained)


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


class Evil:
    def __reduce__(self) -> tuple[Any, ...]:
        return (os.mkdir, ("owned",))


@pytest.mark.parametrize("damage", ["truncated", "empty", "text", "code", "other", "missing"])
def test_a_damaged_or_malicious_checkpoint_is_an_error_and_runs_no_code(
    damage: str, trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(trained, folder)
    checkpoint = folder / "checkpoint.pt"
    if damage == "truncated":
        checkpoint.write_bytes(checkpoint.read_bytes()[:5000])
    elif damage == "empty":
        checkpoint.write_bytes(b"")
    elif damage == "text":
        checkpoint.write_text("weights")
    elif damage == "code":
        checkpoint.write_bytes(pickle.dumps({"format": 1, "network": Evil()}))
    elif damage == "other":
        weights = {"layer": torch.zeros(3)}
        torch.save({"format": 2, "learner": {"network": weights}}, checkpoint)
    else:
        checkpoint.unlink()
    assert str(folder) in error_of(capsys, "evaluate", folder, "--episodes", "10")
    assert not Path("owned").exists()


def test_a_damaged_config_is_an_error(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(trained, folder)
    for text in ("{", "[]", "{}", '{"task": {"maze": 7}}', '{"task": {}, "ppo": {}, "x": 1}'):
        (folder / "config.json").write_text(text)
        error_of(capsys, "evaluate", folder, "--episodes", "10")


def test_a_full_disk_loses_nothing_that_was_saved(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    path.write_text("old")

    def fail(beside: Path) -> None:
        beside.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, fail)
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


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


def test_every_command_has_a_help_that_names_its_options(
    capsys: pytest.CaptureFixture[str],
) -> None:
    main(["--help"])
    assert "evaluate" in capsys.readouterr().out
    said = {}
    for command in COMMANDS:
        with pytest.raises(SystemExit) as stopped:
            main([command, "--help"])
        assert stopped.value.code == 0
        said[command] = capsys.readouterr().out
        assert "--" in said[command] and "--no-no-" not in said[command]
    assert "--anneal, --no-anneal" in said["train"] and "--role" in said["train"]
    assert not any(f"--{name} " in said["self-play"] for name in ("role", "opponent"))


@pytest.mark.parametrize(
    ("command", "work"),
    [
        (("compare", "ppo"), "experiments.executors.run_locally"),
        (("sweep", "reacher_by_joints"), "experiments.executors.run_locally"),
        (("ablate", "opponent-epsilon"), "experiments.executors.run_locally"),
        (("reproduce", "figure-2.2"), "experiments.executors.run_locally"),
    ],
)
def test_the_command_printed_after_an_interruption_is_quoted(
    command: tuple[str, ...],
    work: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"train.{work}", interrupted)
    again = [*command, "--out", str(tmp_path / "it's mine; or $HOME")]
    with pytest.raises(SystemExit):
        main(again)
    said = capsys.readouterr().err.partition("Continue with: ")[2]
    assert shlex.split(said) == ["pursuit", *again]
