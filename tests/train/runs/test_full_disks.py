"""On a full disk every command names the file that cannot be written, and loses no other."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest
from command_errors import error_of
from torch.utils.tensorboard import SummaryWriter

from pursuit import Recorder
from pursuit.environments.parallel import scene_of
from pursuit.rendering.animation import save_animation
from train.experiments.rows import read_study
from train.kinds import start
from train.runs.folder import RUN
from train.runs.parts import settings_of

SETTINGS = settings_of(
    maze="2x2", num_games=16, rollout_steps=8, minibatch_size=64, width=8, frames=1024, threads=1
)


@contextlib.contextmanager
def limited_files(size: int) -> Iterator[None]:
    """No file becomes larger, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_checkpoint_that_cannot_be_written_is_one_line_and_the_old_one_stays(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "run"
    run = start(RUN, SETTINGS, folder)
    run.save()
    before = (folder / "checkpoint.pt").read_bytes()
    refused = pytest.raises(OSError, match=r"checkpoint.pt: cannot be written \(File too large\)")
    with limited_files(4096), refused as e:
        run.save()
    told = str(e.value)
    assert "\n" not in told and ".part" not in told and "Errno" not in told and "free space" in told
    assert (folder / "checkpoint.pt").read_bytes() == before and not list(folder.rglob("*.part"))


@pytest.mark.parametrize("step", ["open", "write", "close"])
def test_events_that_cannot_be_written_name_their_folder(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    run = start(RUN, SETTINGS, tmp_path / "run")
    run.lock.release()
    name = {"open": "__init__", "write": "add_scalar", "close": "close"}[step]
    monkeypatch.setattr(SummaryWriter, name, full)
    told = error_of(capsys, "train", "--resume", tmp_path / "run")
    assert f"{tmp_path / 'run' / 'tensorboard'}: cannot be written (No space left" in told


def test_tables_of_a_sweep_that_cannot_be_written_name_their_file(tmp_path: Path) -> None:
    run = start(RUN, SETTINGS, tmp_path / "runs" / "run")
    run.train()
    run.results(2)
    with limited_files(64), pytest.raises(OSError, match=r"results.csv: cannot be written"):
        read_study(tmp_path)
    assert os.listdir(tmp_path) == ["runs"]


@pytest.mark.parametrize("name", ["replay.gif", "replays.json"])
def test_a_replay_that_cannot_be_written_names_its_file(name: str, tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/Chaser-v0", maze="2x2")
    recorder = Recorder(env)
    env.reset(seed=0)
    replay = recorder.stop()
    with limited_files(64), pytest.raises(OSError, match="File too large") as e:
        if name == "replay.gif":
            save_animation(tmp_path / name, [scene_of(env.unwrapped.simulator)] * 2)
        else:
            replay.save(tmp_path / name)
    assert e.value.filename == str(tmp_path / name) and not list(tmp_path.iterdir())
