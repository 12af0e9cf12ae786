"""Kernels that are compiled ahead: exactly those of the run, by processes that nothing hangs on."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest

from pursuit import kernel_cache
from train.commands import ahead, rehearsal

ANNOUNCEMENT = "pursuit: compiling kernels"
LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there it is done")
RUN = ("--maze", "3x3", "--frames", "20000")


def surroundings(cache: Path) -> dict[str, str]:
    root = str(Path(ahead.__file__).parents[2])
    return {**os.environ, "NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": root}


def processes_of(cache: Path) -> set[int]:
    """Whoever was started with this cache and still runs."""
    found = set()
    for process in Path("/proc").iterdir():
        try:
            if os.fsencode(cache) in (process / "environ").read_bytes():
                found.add(int(process.name))
        except (OSError, ValueError):
            continue
    return found


def pursuit(cache: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "train.commands.main", *arguments],
        env=surroundings(cache),
        cwd=cache.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """An empty cache, as on a machine where nothing was compiled yet."""
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


@pytest.fixture
def quiet() -> Iterator[None]:
    """Nothing is compiled elsewhere afterwards."""
    yield
    kernel_cache.elsewhere = None


def rehearsed(cache: Path, game: Sequence[str]) -> list[str]:
    """The kernels that a rehearsal compiles."""
    with subprocess.Popen(
        [sys.executable, "-m", "train.commands.rehearsal", *game, *RUN],
        env=ahead.surroundings() | surroundings(cache),
        stdin=subprocess.PIPE,  # held open: it ends with whoever holds it
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        names = process.stdout.read().split()
        assert process.wait() == 0
    return names


DUELS = [(), ("--role", "evader", "--stay-action"), ("--observation", "planes")]


@LINUX
@pytest.mark.parametrize(
    "game",
    [DUELS[0], *(pytest.param(game, marks=pytest.mark.slow) for game in DUELS[1:])],
    ids=" ".join,
)
def test_a_run_after_its_rehearsal_compiles_nothing(cache: Path, game: tuple[str, ...]) -> None:
    names = rehearsed(cache, game)
    assert {"start_games", "step_games", "respond", "choose_actions"} <= set(names)
    several = {"choose_actions"}  # a kernel for every kind of agent
    assert {name for name in names if names.count(name) > 1} <= several
    run = pursuit(cache, "train", *game, *RUN)
    _, said = run.communicate(timeout=300)
    assert run.returncode == 0 and ANNOUNCEMENT not in said, said


@LINUX
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGKILL], ids=["ctrl-c", "kill"])
def test_nobody_goes_on_compiling_when_the_run_is_gone(cache: Path, end: signal.Signals) -> None:
    run = pursuit(cache, "train", *RUN)
    assert len(os.sched_getaffinity(0)) < 2 or waited_for(lambda: len(processes_of(cache)) == 3)
    run.send_signal(end)
    _, said = run.communicate(timeout=60)
    assert run.returncode == (130 if end == signal.SIGINT else -signal.SIGKILL), said
    assert waited_for(lambda: not processes_of(cache))


def waited_for(true: Callable[[], bool]) -> bool:
    """Whether it comes true within a minute."""
    for _ in range(600):
        if true():
            return True
        time.sleep(0.1)
    return False


@pytest.mark.usefixtures("quiet")
@pytest.mark.parametrize("status", [0, 3])
def test_processes_that_fail_are_no_longer_waited_for(
    status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A kernel that they did not compile is compiled here; there is no error and no rest."""
    says = f"print('respond', flush=True); raise SystemExit({status})"
    found = ahead.Ahead([sys.executable, "-c", says])
    kernel_cache.elsewhere = found.wait
    assert kernel_cache.KernelCacheFile(str(tmp_path), "kernel", "stamp").load("one") is None
    assert found.process.returncode == status
    assert found.count == 1 and kernel_cache.elsewhere is None
    assert "Error" not in capsys.readouterr().err


@LINUX
@pytest.mark.usefixtures("quiet")
def test_processes_that_do_not_end_are_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that was started, and the one that it forked."""
    says = "import os, time; print(os.fork() or os.getpid(), flush=True); time.sleep(600)"
    found = ahead.Ahead([sys.executable, "-c", says])
    assert waited_for(lambda: found.wait() and found.count == 2)
    monkeypatch.setattr(ahead, "MOST_SECONDS", 0.0)
    assert not found.wait() and found.process.returncode == -signal.SIGKILL
    assert waited_for(lambda: not Path(f"/proc/{found.name}/cmdline").exists())


def test_nothing_is_begun_where_nothing_would_be_gained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead.sys, "platform", "linux")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(ahead, "is_new", lambda kernel: True)
    assert ahead.is_worth_it(["--maze", "5x5"])
    for arguments in (["--help"], ["--resume", "runs/one"], ["--task", "reacher"]):
        assert not ahead.is_worth_it(arguments)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    assert not ahead.is_worth_it([])
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1}, raising=False)
    monkeypatch.setattr(ahead, "is_new", lambda kernel: False)
    assert not ahead.is_worth_it([])


def test_the_game_is_that_of_the_arguments() -> None:
    task, agent, seen = rehearsal.game_of(["--maze=9x9", "--seconds", "30"])
    assert (task.name, agent, seen, task.max_cells) == ("chase", "chaser", "index", 25)
    of_game = ["--task", "heist", "--num-evaders", "3", "--role", "evader", "--stay-action"]
    of_sight = ["--view-radius", "chaser=2", "--line-of-sight", "--observation", "planes"]
    task, agent, seen = rehearsal.game_of([*of_game, "--opponent-epsilon", "0.1", *of_sight])
    assert (task.name, agent, seen, task.stay_action) == ("heist", "evader", "planes", True)
    assert task.num_evaders == 3 and task.sight.limited
    assert rehearsal.game_of(["--observation", "mine:Own"])[2] == "index"
    for wrong in (["--task", "chess"], ["--num-chasers", "400"]):
        with pytest.raises(ValueError):
            rehearsal.game_of(wrong)
