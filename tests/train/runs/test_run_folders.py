"""One command resumes a run after any interruption; its folder is locked for other processes."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from command_errors import error_of, status_of
from test_resumption import check_same

from train.commands import progress
from train.experiments.identity import fingerprint
from train.files import hold
from train.kinds import open_run, read_settings, start
from train.runs.budget import Budget
from train.runs.folder import (
    RUN,
    SELF_PLAY,
    is_complete,
    load_checkpoint,
    load_results,
    read_metrics,
)
from train.runs.interruption import Stopped
from train.runs.loop import Run
from train.runs.opponents import load_policy
from train.runs.parts import settings_of
from train.runs.single import SingleAgent
from train.self_play import report as self_play_report
from train.self_play.parts import self_play_settings_of
from train.settings.common import RunSettings

SMALL = {"maze": "2x2", "num_games": 16, "rollout_steps": 8, "minibatch_size": 64, "width": 8}
FRAMES = {"frames": 1024, "threads": 1}
MAKE: dict[str, Callable[..., Any]] = {
    "train": lambda **more: settings_of(**SMALL, **FRAMES, **more),
    "self-play": lambda **more: self_play_settings_of(**SMALL, **FRAMES, snapshots=2, **more),
}
KIND = {"train": RUN, "self-play": SELF_PLAY}


def copy_of(whole: Path, path: Path) -> Path:
    return Path(shutil.copytree(whole, path))


@pytest.fixture(autouse=True)
def quick_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replaces figures by empty files; other tests check their content."""
    drawn: Any = lambda path, *rest: path.write_bytes(b"picture")  # noqa: E731
    monkeypatch.setattr("train.runs.pictures.draw_learning_curve", drawn)
    monkeypatch.setattr("pursuit.rendering.animation.save_animation", drawn)
    monkeypatch.setattr(self_play_report, "draw_self_play", drawn)


@pytest.fixture(scope="module", params=["train", "self-play"])
def finished(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """A command, and the folder of a complete run of it, without pictures."""
    folder = tmp_path_factory.mktemp("runs") / request.param
    run = start(KIND[request.param], MAKE[request.param](), folder)
    run.train()
    run.results(2)
    return request.param, folder


def dead_process() -> int:
    """The number of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


# -- interruptions ---------------------------------------------------------------------------------

STOPS: dict[str, list[str]] = {
    "before the first checkpoint": ["checkpoint.pt", "metrics.csv", "results.json", "pool"],
    "between the first evaluation and its checkpoint": ["checkpoint.pt", "results.json", "chaser"],
    "between the last checkpoint and what lies beside it": ["results.json", "chaser", "evader"],
    "before the results": ["results.json"],
    "before the pictures": [],
}


@pytest.mark.parametrize("missing", STOPS.values(), ids=STOPS)
def test_one_command_resumes_after_any_interruption(
    missing: list[str], finished: tuple[str, Path], tmp_path: Path
) -> None:
    command, whole = finished
    folder = copy_of(whole, tmp_path / "run")
    for name in missing:
        shutil.rmtree(folder / name, ignore_errors=True)
        if (folder / name).is_file():
            (folder / name).unlink()
    left = folder / f".results.json.{dead_process()}.part"
    left.write_text("{")
    assert status_of(command, "--resume", folder, "--episodes", 2) == 0
    assert not left.exists() and not list(folder.rglob("*.part"))
    for name in ("results.json", "learning_curve.png", "checkpoint.pt"):
        assert (folder / name).exists(), name
    assert (folder / "replay.gif").exists() == (command == "train")
    if command == "self-play":
        assert (folder / "chaser" / "checkpoint.pt").exists()
    results = [load_results(path) for path in (whole, folder)]
    assert results[0]["frames"] == results[1]["frames"] and not results[1]["interrupted"]
    rows = [[row["frames"] for row in read_metrics(path)] for path in (whole, folder)]
    assert rows[0] == rows[1]


def test_a_complete_run_is_refused_and_a_side_points_to_the_whole(
    finished: tuple[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, whole = finished
    folder = copy_of(whole, tmp_path / "run")
    for name in ("learning_curve.png", "replay.gif", "report.html"):
        (folder / name).touch()
    assert "complete; its budget is spent" in error_of(capsys, command, "--resume", folder)
    for other in ("train", "self-play") if command == "self-play" else ():
        assert f"give {folder}" in error_of(capsys, other, "--resume", folder / "chaser")


@pytest.mark.parametrize("finished", ["self-play"], indirect=True)
def test_a_side_that_was_lost_is_written_again_by_the_command_that_the_message_names(
    finished: tuple[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(finished[1], tmp_path / "run")
    for name in ("learning_curve.png", "report.html"):
        (folder / name).touch()
    before = load_checkpoint(folder / "chaser")
    shutil.rmtree(folder / "chaser")
    said = error_of(capsys, "evaluate", folder, "--episodes", 2)
    again = f"go on with pursuit self-play --resume {folder}"
    assert f"{folder / 'chaser'}: no checkpoint yet; {again}" in said
    assert status_of("self-play", "--resume", folder, "--no-report") == 0
    check_same(load_checkpoint(folder / "chaser"), before, "chaser")
    assert status_of("evaluate", folder, "--episodes", 2) == 0


def test_a_run_that_lost_its_results_keeps_its_figures_where_they_are_written_again(
    finished: tuple[str, Path], tmp_path: Path
) -> None:
    folder = copy_of(finished[1], tmp_path / "run")
    (folder / "results.json").unlink()
    figures = [folder / "learning_curve.png", folder / "replay.gif"]
    for figure in figures:
        figure.touch()
    assert status_of("view", folder, "--no-open") == 0
    assert load_results(folder) and all(figure.exists() for figure in figures)
    open_run(folder).results(4)  # the figures have the scores of the former ones
    assert not any(figure.exists() for figure in figures)


def test_a_folder_of_a_run_killed_before_its_settings_were_written_can_be_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".lock").touch()
    half = folder / f".config.json.{dead_process()}.part"
    half.write_text("{")
    assert "no run here" in error_of(capsys, "train", "--resume", folder)
    start(RUN, MAKE["train"](), folder)
    assert not half.exists() and (folder / "config.json").exists()


def begin_and_kill(command: str, folder: Path, after: float) -> None:
    """Begin a run in a process of its own, and kill it `after` seconds with its folder."""
    flat = {**SMALL, **FRAMES, **({"snapshots": 2} if command == "self-play" else {})}
    given = [f"--{name.replace('_', '-')}={value}" for name, value in flat.items()]
    process = subprocess.Popen(
        [sys.executable, "-m", "train.commands.main", command, *given, "--out", str(folder)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while not folder.exists() and process.poll() is None:
        time.sleep(0.001)
    time.sleep(after)
    process.kill()
    process.wait()


def learned_in(folder: Path) -> dict[str, list[Any]]:
    """The learner of every role, and its games."""
    trainee = load_checkpoint(folder)["trainee"]
    sides = trainee.get("sides", {"alone": trainee})
    return {role: [side["learner"], side["simulator"]] for role, side in sides.items()}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["train", "self-play"])
def test_kills_at_any_moment_lead_to_the_same_end(command: str, tmp_path: Path) -> None:
    """Seconds after the folder exists; most of them are while it is being filled."""
    whole = start(KIND[command], MAKE[command](), tmp_path / "whole")
    whole.train()
    for number, after in enumerate((0.0, 0.1, 0.4, 1.0, 2.5, 6.0)):
        folder = tmp_path / str(number)
        begin_and_kill(command, folder, after)
        if not (folder / "config.json").exists():
            start(KIND[command], MAKE[command](), folder).train()
        elif (status := status_of(command, "--resume", folder, "--episodes", 2)) == 2:
            assert (folder / "learning_curve.png").exists()  # it was complete
        else:
            assert status == 0
            load_results(folder)
        assert not list(folder.rglob("*.part"))
        check_same(learned_in(whole.folder), learned_in(folder), f"killed after {after} s")


# -- locks -----------------------------------------------------------------------------------------

HOLD = """
import sys
from pathlib import Path
from train.files import hold
lock = hold(Path(sys.argv[1]), "run")
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_process_is_refused_with_the_reason(
    finished: tuple[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command, whole = finished
    resumed, new = copy_of(whole, tmp_path / "run"), tmp_path / "new"
    (resumed / "results.json").unlink()
    before = sorted(path.name for path in resumed.iterdir())
    for folder, options in (
        (resumed, ["--resume", resumed]),
        (new, ["--out", new, "--maze=2x2", "--frames=64"]),
    ):
        with subprocess.Popen(
            [sys.executable, "-c", HOLD, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as other:
            assert other.stdout is not None and other.stdout.readline() == b"held\n"
            said = error_of(capsys, command, *options)
            assert f"{folder}: another run uses this folder" in said
            assert other.stdin is not None
            other.stdin.close()
    assert not (new / "config.json").exists()
    assert {*before, ".lock"} == {path.name for path in resumed.iterdir()}
    open_run(resumed)  # the lock ended with the other process


def test_a_process_can_lock_a_folder_again(tmp_path: Path) -> None:
    first, second = (hold(tmp_path, "run", shared=True) for _ in range(2))
    assert first is second


# -- signals and divergence ------------------------------------------------------------------------


def signals_at_first_row(monkeypatch: pytest.MonkeyPatch, *numbers: int) -> None:
    """Send these signals at the first evaluation."""
    left = list(numbers)

    def watched(self: Any, run: Any, row: dict[str, float]) -> None:
        while row and left:
            signal.raise_signal(left.pop(0))

    monkeypatch.setattr(progress.TrainingProgress, "__call__", watched)


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_run_with_its_status_once_everything_is_saved(
    number: int,
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    start(RUN, MAKE["train"](), tmp_path / "run")
    signals_at_first_row(monkeypatch, number)
    assert status_of("train", "--resume", tmp_path / "run", "--episodes", 2) == status
    said, run = capsys.readouterr(), tmp_path / "run"
    assert re.search(r"interrupted; saved at \d+ frames, \d+ %; resume with: ", said.err)
    frames = load_checkpoint(run)["trainee"]["learner"]["frames"]
    assert 0 < frames < FRAMES["frames"]
    assert not (run / "results.json").exists() and not (run / "learning_curve.png").exists()
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before
    assert status_of("evaluate", run, "--episodes", 2) == 0  # what is missing can be made up for
    assert "optimal" in capsys.readouterr().out
    assert status_of("report", run, "--out", tmp_path / "report") == 0
    assert load_results(run)["interrupted"] and load_results(run)["frames"] == frames
    again = open_run(run)
    again.train(lambda run, row: run.__setattr__("stopped", True))
    assert load_results(run)["outdated"] and not is_complete(run)
    assert again.lock is not None
    again.lock.release()
    status_of("report", run, "--out", tmp_path / "report")
    assert load_results(run)["frames"] == again.trainee.frames
    assert status_of("train", "--resume", run) == 0
    assert is_complete(run) and "outdated" not in load_results(run)


def test_a_loop_over_runs_ends_with_the_first_one_that_is_stopped(tmp_path: Path) -> None:
    begun = []
    with pytest.raises(Stopped):
        for seed in range(3):
            run = start(RUN, replace(MAKE["train"](), seed=seed), tmp_path / str(seed))
            begun.append(seed)
            with contextlib.suppress(Exception):
                run.train(lambda run, row: signal.raise_signal(signal.SIGINT))
    assert begun == [0]


@pytest.mark.parametrize("command", ["train", "self-play"])
def test_a_run_that_was_interrupted_has_the_rows_of_one_that_was_not(
    command: str, tmp_path: Path
) -> None:
    def interrupted(run: Any, row: dict[str, float]) -> None:
        if not row and run.trainee.frames == 1024:  # evaluations are due every 512
            signal.raise_signal(signal.SIGINT)

    kind, settings = KIND[command], MAKE[command]()
    settings = replace(settings, frames=10240)
    whole = start(kind, settings, tmp_path / "whole")
    whole.train()
    run = start(kind, settings, tmp_path / "run")
    with pytest.raises(Stopped):
        run.train(interrupted)
    run.lock.release()
    run = open_run(tmp_path / "run")
    run.train()
    frames = [[row["frames"] for row in read_metrics(f)] for f in (whole.folder, run.folder)]
    assert frames[0] == frames[1] and set(np.diff(frames[0])) == {512.0}


def interrupted_at(kind: str, settings: Any, folder: Path, frames: int) -> None:
    """Start a run, and interrupt it in the evaluation after so many frames."""
    run = start(kind, settings, folder)
    evaluate = run.trainee.evaluate

    def stopped() -> dict[str, float]:
        if run.trainee.frames >= frames:
            signal.raise_signal(signal.SIGINT)
        return evaluate()

    run.trainee.evaluate = stopped
    with pytest.raises(Stopped):
        run.train()
    run.lock.release()  # type: ignore[union-attr]


@pytest.mark.parametrize("command", ["train", "self-play"])
def test_a_run_without_its_last_evaluation_is_not_complete(command: str, tmp_path: Path) -> None:
    kind, settings = KIND[command], MAKE[command]()
    interrupted_at(kind, settings, tmp_path, settings.frames)
    run = open_run(tmp_path)
    assert run.progress == 1.0 and not run.is_trained
    run.results(4)
    assert load_results(tmp_path)["interrupted"] and not is_complete(tmp_path)
    run.train()
    run.results(4)
    assert is_complete(tmp_path)
    assert read_metrics(tmp_path)[-1]["frames"] == run.trainee.frames


def test_a_row_is_not_repeated_where_the_next_process_fails_in_its_first_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = MAKE["train"]()
    interrupted_at(RUN, settings, tmp_path, settings.frames // 2)

    def full(run: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="space"):
        patch.setattr(Run, "save", full)
        failed = open_run(tmp_path)
        failed.train()
    failed.lock.release()  # type: ignore[union-attr]
    run = open_run(tmp_path)
    run.train()
    frames = [row["frames"] for row in read_metrics(tmp_path)]
    assert frames == sorted(set(frames)) and frames[-1] == run.trainee.frames


def test_what_a_user_has_stopped_is_evaluated_once(tmp_path: Path) -> None:
    run = start(RUN, MAKE["train"](), tmp_path)
    run.train(lambda run, row: run.__setattr__("stopped", run.stopped or not row))
    rows = read_metrics(tmp_path)
    assert 0.0 < run.progress < 1.0 and rows[-1]["frames"] == run.trainee.frames
    run.train()
    assert read_metrics(tmp_path) == rows


def test_figures_of_numpy_do_not_damage_the_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    iterate = SingleAgent.iterate

    def figures(*given: Any) -> dict[str, float]:
        return {name: np.float64(value) for name, value in iterate(*given).items()}

    monkeypatch.setattr(SingleAgent, "iterate", figures)
    run = start(RUN, MAKE["train"](), tmp_path)
    run.train()
    assert run.figures and run.lock is not None
    run.lock.release()
    assert open_run(tmp_path).figures == run.figures


@pytest.mark.parametrize("command", ["train", "self-play"])
def test_a_run_is_reported_that_was_interrupted_before_its_first_evaluation(
    command: str, tmp_path: Path
) -> None:
    run = start(KIND[command], replace(MAKE[command](), frames=10**8), tmp_path / "run")
    with pytest.raises(Stopped):
        run.train(lambda run, row: row or signal.raise_signal(signal.SIGTERM))
    run.lock.release()  # type: ignore[union-attr]
    assert status_of("report", tmp_path / "run", "--out", tmp_path / "report") == 0
    assert status_of("view", tmp_path / "run", "--no-open", "--out", tmp_path / "page.html") == 0
    assert load_results(tmp_path / "run")["interrupted"]


def test_a_progress_line_ends_where_the_next_work_begins(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a terminal, also if the share of the work is not known."""
    now = iter(np.arange(0.0, 100.0, 3.0))
    monkeypatch.setattr(progress, "perf_counter", lambda: next(now))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with contextlib.closing(progress.ProgressLine()) as tell:
        for what, share in (("long", 0.1), ("long", 0.5), ("b", np.nan), ("b", np.nan), ("c", 0)):
            tell(what, share)
        tell("c", 0.25)
    said = capsys.readouterr().err
    lines = ["long: 50 %, 3 s so far, about 3 s left", "", "b: 3 s so far", ""]
    lines += ["c: 25 %, 3 s so far, about 9 s left", ""]
    assert said == "".join(f"\r\x1b[K{line}" for line in lines)


def test_progress_is_a_line_a_minute_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = iter(range(0, 100_000, 10))
    monkeypatch.setattr(progress, "perf_counter", lambda: next(now))
    with contextlib.closing(progress.ProgressLine()) as tell:
        for step in range(1, 601):
            tell("a study with a title of many words " * 4, step / 600)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 99 and max(map(len, lines)) == 100
    assert (
        lines[0].startswith("a study with") and ": 1 %, 60 s so far, about 85 min left" in lines[0]
    )
    assert lines[-1].endswith(": 99 %, 99 min so far, about 50 s left"), lines[-1]


@pytest.mark.parametrize("form", ["auto", "bag", "dense"])
def test_a_setting_that_was_removed_is_not_read_and_counts_in_fingerprints(
    form: str, tmp_path: Path
) -> None:
    """`first_layer` chose one of two forms of one function of the same weights."""
    settings = MAKE["train"](evaluate="sampled")
    run = start(RUN, settings, tmp_path)
    run.train()
    path = tmp_path / "config.json"
    content = json.loads(path.read_text())
    assert "first_layer" not in content
    path.write_text(json.dumps({**content, "first_layer": form}))
    kind, found = read_settings(tmp_path)
    assert found == settings
    maze = settings.task.build().mazes[0]
    table = run.trainee.policy.action_probabilities(maze)
    loaded = load_policy(tmp_path, greedy=False).action_probabilities(maze)
    np.testing.assert_array_equal(loaded, table)
    counted = {"kind": kind, "episodes": 20, "first_layer": "auto", **asdict(settings)}
    counted["task"]["maze"] = settings.task.maze_text
    for name in RunSettings.ADDED:  # runs had their names before these settings were added
        del counted[name]
    whole = json.dumps({**counted, "parts": {}}, sort_keys=True).encode()
    assert fingerprint(kind, found, 20, {}) == hashlib.sha256(whole).hexdigest()[:10]


def test_a_run_without_readable_metrics_is_not_resumed(
    finished: tuple[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(finished[1], tmp_path / "run")
    (folder / "results.json").unlink()
    (folder / "metrics.csv").unlink()
    assert "metrics.csv: cannot be read" in error_of(capsys, finished[0], "--resume", folder)
    (folder / "metrics.csv").symlink_to("metrics.csv")
    assert "metrics.csv: cannot be read" in error_of(capsys, finished[0], "--resume", folder)


def test_a_second_signal_ends_it_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without saving, as the learner may be in the middle of an iteration."""
    iterate, iterations = SingleAgent.iterate, []

    def interrupted(trainee: SingleAgent, clock: Any) -> dict[str, float]:
        iterations.append(iterate(trainee, clock))
        if len(iterations) == 2:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
        return iterations[-1]

    monkeypatch.setattr(SingleAgent, "iterate", interrupted)
    monkeypatch.setattr("train.runs.loop.EVALUATIONS", 1)
    start(RUN, MAKE["train"](), tmp_path / "run")
    assert status_of("train", "--resume", tmp_path / "run", "--episodes", 2) == 143
    assert "interrupted; nothing is saved; resume with" in capsys.readouterr().err
    left = {path.name for path in (tmp_path / "run").iterdir()}
    assert left <= {".lock", "config.json", "tensorboard"}


@pytest.mark.parametrize("algorithm", ["ppo", "a2c", "dqn"])
def test_the_error_of_diverged_training_has_time_and_reason(
    algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sizes = {"maze": "2x2", "num_games": 16, "width": 8, "frames": 200_000, "threads": 1}
    more = {"learning_starts": 64, "batch_size": 32} if algorithm == "dqn" else {}
    if algorithm == "ppo":
        more = {"minibatch_size": 64}
    settings = settings_of(algorithm=algorithm, learning_rate=1e30, **sizes, **more)
    start(RUN, settings, tmp_path / "run")
    told = error_of(capsys, "train", "--resume", tmp_path / "run", status=1)
    assert "training diverged at frame" in told and "learning_rate" in told
    assert not (tmp_path / "run" / "results.json").exists()
    if (tmp_path / "run" / "checkpoint.pt").exists():
        assert "is kept" in told
        open_run(tmp_path / "run")


def test_the_last_checkpoint_before_a_divergence_is_kept(
    finished: tuple[str, Path], tmp_path: Path
) -> None:
    folder = copy_of(finished[1], tmp_path / "run")
    before = (folder / "checkpoint.pt").read_bytes()
    run = open_run(folder)
    learner = run.trainee.learner if finished[0] == "train" else run.trainee.sides["chaser"].learner
    next(learner.network.parameters()).data.fill_(float("nan"))
    with pytest.raises(ArithmeticError, match=r"1,0\d\d frames is kept.*learning_rate"):
        run._check_learned()
    assert (folder / "checkpoint.pt").read_bytes() == before


@pytest.mark.parametrize("arguments", [["--help"], ["maze", "9x9"]])
def test_a_closed_pipe_gives_no_traceback(arguments: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    process = subprocess.run(
        [sys.executable, "-m", "train.commands.main", *arguments],
        stdout=writer,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(writer)
    assert process.returncode == 141
    assert "Traceback" not in process.stderr and "Exception" not in process.stderr


def test_results_are_numbers_of_json(finished: tuple[str, Path]) -> None:
    json.loads((finished[1] / "results.json").read_text(), parse_constant=pytest.fail)


def test_seconds_of_the_processor_pass_only_while_it_computes() -> None:
    ours, wall = Budget(1.0, None, clock="processor"), Budget(1.0, None)
    began = ours.now(), wall.now()
    time.sleep(0.3)
    slept = ours.now() - began[0], wall.now() - began[1]
    assert slept[0] < 0.2 <= slept[1]
    begun = time.process_time()
    while time.process_time() < begun + 0.1:
        pass
    assert ours.now() - began[0] >= 0.1
    clocks = ("processor", "wall")
    ours, wall = (Budget.of(settings_of(maze="2x2", seconds=1, clock=clock)) for clock in clocks)
    assert (ours.threads, wall.threads) == (1, 0) and wall.free_threads
    fixed = Budget.of(settings_of(maze="2x2", frames=9_000_000))
    assert not ours.free_threads and not fixed.free_threads and fixed.threads == os.cpu_count()


@pytest.mark.parametrize("clock", ["wall", "processor"])
def test_the_compilation_of_kernels_does_not_count(clock: str) -> None:
    """It happens once per machine, so the first run would have less of its budget than others."""
    budget, real = Budget(1.0, None, clock=clock), time.process_time
    numba.njit(lambda values: values.sum())(np.ones(9))  # what Numba sets up once does count
    gc.disable()  # nor does the garbage of the tests before this one belong to the compilation
    try:
        began, begun = budget.now(), real()
        assert numba.njit(lambda values: values.sum() + values[::2].max())(np.ones(9)) == 10.0
        assert budget.now() - began < 0.5 * (real() - begun)
    finally:
        gc.enable()


def test_a_run_counts_by_the_clock_of_its_settings(tmp_path: Path) -> None:
    flat = {**SMALL, "seconds": 0.2, "clock": "processor"}
    run = start(RUN, settings_of(**flat), tmp_path / "run")
    began = time.process_time()
    run.train()
    assert 0.2 <= run.seconds <= time.process_time() - began
    assert run.results(2)["clock"] == "processor"
    with pytest.raises(ValueError, match="unknown clock 'sundial'; one of wall, processor"):
        settings_of(**{**flat, "clock": "sundial"})


def test_the_clock_of_a_sweeps_runs_counts() -> None:
    one = {"task": "maze", "maze": "5x5", "algorithm": "ppo", "curriculum": "none", "threads": 1}

    def digest(**more: Any) -> str:
        return fingerprint("run", settings_of(**one, **more), 1000, {})

    assert digest(seconds=10.0, clock="processor") != digest(seconds=10.0)
