"""Files are written atomically, and folders are locked."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from command_errors import error_of, status_of

from pursuit import Replay, make_task
from train.files import (
    check_new_files,
    hold,
    is_leftover,
    only_one,
    remove_leftovers,
    reserved,
    write_text,
)
from train.kinds import start
from train.runs.folder import RUN, check_new
from train.runs.parts import settings_of

TASK = make_task("maze", maze="2x2")


def test_a_failing_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_text(path, "\ud800")
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.txt"]


def test_a_device_or_folder_is_not_replaced_by_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(ValueError, match="not a file"):
            write_text(path, "content")
    assert stat.S_ISFIFO(os.stat(tmp_path / "pipe").st_mode)


def test_locking_a_folder_removes_temporary_files_of_ended_processes(tmp_path):
    gone = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True
    )
    left = tmp_path / "runs" / f".results.parquet.{int(gone.stdout)}.part"
    left.parent.mkdir()
    left.write_text("half")
    own = tmp_path / f".a.txt.{os.getpid()}.part"
    own.write_text("still being written")
    with only_one(tmp_path, "sweep"):
        assert not left.exists() and own.exists()


KILLED = """
import os, signal, sys
import gymnasium
import pursuit
from PIL import Image
from pursuit.rendering.animation import save_animation

class Still:
    def picture(self, size):
        return Image.new("RGB", (64, 64))

path = sys.argv[1]
replace = os.replace

def killed(source, target):
    if os.path.basename(target) == os.path.basename(path):  # numba replaces files of its own
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target)

os.replace = killed
if path.endswith(".json"):
    env = gymnasium.make("pursuit/Chaser-v0", maze="2x2")
    recorder = pursuit.Recorder(env)
    env.reset(seed=0)
    recorder.stop().save(path)
save_animation(path, [Still(), Still()])
"""


@pytest.mark.parametrize("name", ["replay.gif", "replay.mp4", "replays.json"])
def test_temporary_files_of_a_killed_process_are_removed(name, tmp_path):
    killed = subprocess.run([sys.executable, "-c", KILLED, tmp_path / name])
    assert killed.returncode == -signal.SIGKILL
    assert len(os.listdir(tmp_path)) == 1
    check_new(tmp_path)
    remove_leftovers(tmp_path)
    assert os.listdir(tmp_path) == []


def test_processes_are_not_signalled_where_signal_0_is_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = tmp_path / f".config.json.{2**31 - 1}.part"
    left.touch()
    assert is_leftover(left)  # no process has this number
    monkeypatch.setattr("train.files.os.name", "nt")
    monkeypatch.setattr("train.files.os.kill", lambda *given: pytest.fail("a signal was sent"))
    assert not is_leftover(left)


# -- two processes at a time -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a complete run."""
    settings = settings_of(maze="2x2", algorithm="q_learning", num_games=16, frames=256, threads=1)
    made = start(RUN, settings, tmp_path_factory.mktemp("runs") / "run")
    made.train()
    made.results(2)
    return made.folder


@pytest.mark.parametrize("command", ["league", "report"])
def test_one_process_at_a_time_writes_a_folder_of_results(
    command: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = ["astar", "--maze", "2x2", "--games", "2"] if command == "league" else [run]
    given = [command, *entries, "--out", tmp_path / "out"]
    held = hold(tmp_path / "out", "writer")
    told = error_of(capsys, *given)
    assert f"{tmp_path / 'out'}: another {command} uses this folder" in told
    held.release()
    assert status_of(*given) == 0


def test_one_process_at_a_time_writes_a_new_file(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "found.json"
    given = ["evaluate", run, "--episodes", "2", "--out", path]
    with reserved(path):
        assert f"{path}: another process is writing this file" in error_of(capsys, *given)
    assert status_of(*given) == 0
    assert os.listdir(tmp_path) == ["found.json"]
    assert f"{path}: exists already" in error_of(capsys, *given)
    assert "does not exist" in error_of(capsys, *given[:-1], tmp_path / "a" / "b.json")


@pytest.mark.parametrize("write", [write_text, lambda path, text: Replay(TASK, ()).save(path)])
def test_a_link_is_kept_and_the_file_that_it_names_is_written(write, tmp_path):
    (tmp_path / "real").mkdir()
    old, new = tmp_path / "real" / "old.json", tmp_path / "real" / "new.json"
    old.write_text("before")
    for name, target in (("live", old), ("dangling", new)):
        link = tmp_path / f"{name}.json"
        link.symlink_to(target)
        write(link, "content")
        assert link.is_symlink() and not target.is_symlink()
        assert target.read_text() != "before" and target.read_text() == link.read_text()
    (tmp_path / "lost.json").symlink_to(tmp_path / "nowhere" / "a.json")
    with pytest.raises(OSError, match=r"lost\.json"):
        write(tmp_path / "lost.json", "content")
    (tmp_path / "loop.json").symlink_to(tmp_path / "loop.json")
    with pytest.raises(ValueError, match="not a file"):
        write(tmp_path / "loop.json", "content")
    assert sorted(os.listdir(tmp_path / "real")) == ["new.json", "old.json"]


def test_outputs_through_links_are_checked_before_the_work(tmp_path):
    (tmp_path / "lost").symlink_to(tmp_path / "nowhere" / "a")
    with pytest.raises(ValueError, match=r"folder .*nowhere does not exist"):
        check_new_files([tmp_path / "lost"])
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(ValueError, match="a link to itself"):
        check_new_files([tmp_path / "loop"])
    (tmp_path / "new").symlink_to(tmp_path / "target")
    check_new_files([tmp_path / "new"])
