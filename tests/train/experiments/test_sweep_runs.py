"""Runs of a sweep are identified by content, not by path; and killed sweeps lose no work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock, Timeout
from waiting import PATIENCE, wait_until

from pursuit import load_maze
from pursuit.tasks.task import make_task
from scripted_agents import AStarEvader, evaluate_joint, solve_joint
from train.commands.main import main
from train.commands.studies import SweepWatch
from train.experiments import executors
from train.experiments.expansion import load_study
from train.experiments.rows import read_all, read_run
from train.experiments.runs import prepare, status_of
from train.kinds import KINDS, open_run, start
from train.runs.folder import RUN
from train.runs.opponents import load_policy
from train.runs.parts import settings_of

MAZE = "+-+-+\n|   |\n+ + +\n|   |\n+-+-+\n"
OTHER = "+-+-+\n|   |\n+-+ +\n|   |\n+-+-+\n"
SWEEP = """
episodes = {episodes}
[settings]
task = "chase"
role = "chaser"
frames = 2000
num_games = 32
minibatch_size = 32
curriculum = "maze-size"
opponent = "{opponent}"
[grid]
maze = ["{maze}"]
curriculum_mazes = ["{lesson}, 2x2"]
"""


def evader(folder: Path, seed: int = 0) -> Path:
    """The folder of a run that is not trained yet."""
    asked: dict[str, Any] = {"task": "chase", "role": "evader", "maze": "3x3", "frames": 100}
    settings = KINDS[RUN].settings_of(**asked, num_games=8, minibatch_size=8, seed=seed)
    start(RUN, settings, folder).save()
    return folder


@pytest.fixture
def given(tmp_path: Path) -> dict[str, Any]:
    """The files of a sweep, and its sweep file."""
    (tmp_path / "mazes").mkdir()
    maze, lesson = tmp_path / "mazes" / "maze.txt", tmp_path / "mazes" / "lesson.txt"
    maze.write_text(load_maze("3x3").to_text())
    lesson.write_text(OTHER)
    opponent = evader(tmp_path / "evader")
    return {"maze": maze, "lesson": lesson, "opponent": opponent, "episodes": 5}


def names(tmp_path: Path, given: dict[str, Any]) -> list[str]:
    (tmp_path / "s.toml").write_text(SWEEP.format(**given))
    return [run.name for run in load_study(str(tmp_path / "s.toml")).runs]


# -- identity --------------------------------------------------------------------------------------


def test_moved_files_give_the_same_run_and_changed_files_another(
    given: dict[str, Any], tmp_path: Path
) -> None:
    (before,) = names(tmp_path, given)
    for name in ("maze", "lesson", "opponent"):
        moved = given[name].with_name(f"moved-{given[name].name}")
        given[name] = given[name].rename(moved)
    (after,) = names(tmp_path, given)
    assert before[-10:] == after[-10:]
    seen = {before[-10:]}
    given["maze"].write_text(load_maze("3x3-open").to_text())
    seen.add(names(tmp_path, given)[0][-10:])
    given["lesson"].write_text(MAZE)
    seen.add(names(tmp_path, given)[0][-10:])
    given["opponent"] = evader(tmp_path / "another", seed=1)
    seen.add(names(tmp_path, given)[0][-10:])
    given["episodes"] = 6
    seen.add(names(tmp_path, given)[0][-10:])
    assert len(seen) == 5


def test_a_sweep_over_files_is_resumed_and_reads_its_copies(
    given: dict[str, Any], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    names(tmp_path, given)
    ((run, folder),) = prepare(load_study(str(tmp_path / "s.toml")), out)
    assert prepare(load_study(str(tmp_path / "s.toml")), out) == [(run, folder)]
    # The maze's file is changed and the opponent goes on learning: not in this run.
    for name in ("maze", "lesson"):
        given[name].write_text(MAZE)
    given["opponent"].rename(tmp_path / "gone")
    trainee = open_run(folder).trainee
    assert trainee.parts.world.task.mazes[0] == load_maze("3x3")
    assert len(trainee.parts.plan.task.mazes) == 3
    # The whole sweep is moved: its copies with it.
    (tmp_path / "gone").rename(given["opponent"])
    given["maze"].write_text(load_maze("3x3").to_text())
    given["lesson"].write_text(OTHER)
    out.rename(tmp_path / "elsewhere")
    prepare(load_study(str(tmp_path / "s.toml")), tmp_path / "elsewhere")
    open_run(tmp_path / "elsewhere" / "runs" / run.name)
    # Reports call them what the sweep file does.
    row = read_all(tmp_path / "elsewhere").everything[0]
    assert (row["maze"], row["opponent"]) == (str(given["maze"]), str(given["opponent"]))


# -- nothing is lost -------------------------------------------------------------------------------

LONG = """
episodes = 5
[settings]
task = "maze"
maze = "2x2"
algorithm = "q_learning"
frames = 1000000000
num_games = 32
[search]
samples = 2
gamma = {choices = [0.9, 0.95]}
"""


@pytest.mark.slow
def test_a_killed_sweep_leaves_no_process_and_the_next_one_waits_for_its_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "s.toml").write_text(LONG)
    sweep, out = load_study(str(tmp_path / "s.toml")), tmp_path / "out"
    command = [sys.executable, "-m", "train.commands.main", "sweep", str(tmp_path / "s.toml")]
    driver = subprocess.Popen([*command, "--out", str(out), "--workers", "1"])
    folder = out / "runs" / sweep.runs[0].name
    lock = FileLock(folder / ".worker.lock")
    wait_until(lambda: list(folder.rglob("events*")), driver)
    with pytest.raises(Timeout), lock.acquire(blocking=False):
        pass
    time.sleep(0.5)  # it learns
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    with lock.acquire(timeout=PATIENCE):  # the run has noticed it, saved, and ended
        assert status_of(folder) == "interrupted"
        before = open_run(folder).trainee.frames
    assert before > 0
    show = SweepWatch.__call__

    def interrupt(watch: SweepWatch, statuses: dict[str, str], progress: dict[str, float]) -> None:
        show(watch, statuses, progress)
        if "running" in statuses.values():
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(SweepWatch, "__call__", interrupt)
    with pytest.raises(SystemExit) as ended:
        main(["sweep", str(tmp_path / "s.toml"), "--out", str(out), "--workers", "1"])
    said = capsys.readouterr()
    assert ended.value.code == 130 and "kept: 1 interrupted" in said.err
    assert "Continue with: pursuit sweep" in said.err
    assert status_of(folder) == "interrupted" and open_run(folder).trainee.frames >= before


@pytest.mark.slow
def test_without_a_fork_server_runs_are_executed_in_new_processes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "get_all_start_methods", lambda: ["spawn"])
    small = SWEEP.split("num_games")[0] + "num_games = 32\nminibatch_size = 32\nmaze = '2x2'\n"
    (tmp_path / "s.toml").write_text(small.format(episodes=4))
    main(["sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / "out"), "--workers", "1"])
    (folder,) = (tmp_path / "out" / "runs").iterdir()
    assert status_of(folder) == "complete" and (folder / executors.LOG).exists()


def test_a_run_is_executed_where_there_are_no_process_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[Path] = []
    monkeypatch.delattr(os, "setsid")
    monkeypatch.setattr(os, "dup2", lambda *_: None)
    monkeypatch.setattr(executors, "end_with_parent", lambda: None)
    monkeypatch.setattr(executors, "perform", done.append)
    executors.work(str(tmp_path), {})
    assert done == [tmp_path]


def test_the_row_of_a_team_has_the_mean_gap_of_its_members(tmp_path: Path) -> None:
    small: dict[str, Any] = {
        "task": "chase",
        "role": "chaser",
        "num_chasers": 2,
        "maze": "2x2",
        "max_steps": 10,
    }
    sizes = {"num_games": 16, "rollout_steps": 4, "minibatch_size": 32, "frames": 2560}
    run = start(RUN, settings_of(algorithm="ippo", n_catch=2, **small, **sizes), tmp_path / "run")
    run.train()
    run.results(10)
    task = make_task("chase", maze="2x2", num_chasers=2, max_steps=10, n_catch=2)
    team, evader = load_policy(tmp_path / "run"), AStarEvader(0.2)
    steps = evaluate_joint(task, {"chaser": team, "evader": evader}, 10).length
    gaps = []
    for member, other in (("chaser_0", "chaser_1"), ("chaser_1", "chaser_0")):
        best = solve_joint(task, member, {other: team, "evader": evader}, 10)
        gaps.append(steps / best.mean_over_starts - 1.0)
    row = read_run(tmp_path / "run")[0]
    assert row["members_gap"] == pytest.approx(sum(gaps) / 2)
    assert 0.0 <= row["members_gap"] <= row["optimality_gap"]
