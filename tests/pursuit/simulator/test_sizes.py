"""Objects too large for the memory are refused, with their size, before allocation."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from pursuit import memory
from pursuit.mazes.generation import generate_maze
from pursuit.mazes.maze import Maze, load_maze
from pursuit.simulator.simulator import Simulator
from pursuit.tasks.task import make_task


def test_a_batch_beyond_memory_is_refused() -> None:
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"=1000000000 needs \d+,000,000,000 bytes.*fewer"):
        Simulator(make_task("chase"), 10**9)
    assert tracemalloc.get_traced_memory()[1] < 10**6
    tracemalloc.stop()


def test_the_bytes_of_a_batch_are_what_it_takes() -> None:
    task, games = make_task("race"), 50_000
    Simulator(task)
    tracemalloc.start()
    kept = Simulator(task, games)
    taken = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    with pytest.raises(ValueError, match="bytes") as refused:
        Simulator(task, 10**15)
    needed = int(str(refused.value).split("needs ")[1].split()[0].replace(",", ""))
    needed = needed // 10**15 * kept.num_games
    assert 0.9 * taken < needed < 1.1 * taken


def test_a_maze_beyond_memory_is_refused_with_its_bytes_before_it_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endless = np.broadcast_to(True, (10**9, 10**9))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"1000000000x1000000000 cells needs 70,0[0,]* bytes"):
        Maze(endless, endless[1:], endless[:, 1:])
    file = tmp_path / "endless.txt"
    with file.open("wb") as sparse:
        sparse.truncate(10**12)
    with pytest.raises(ValueError, match=r"endless.txt needs 26,000,000,000,000 bytes.*smaller"):
        load_maze(file)
    assert tracemalloc.get_traced_memory()[1] < 10**6
    tracemalloc.stop()
    with pytest.raises(ValueError, match="/dev/zero: a directory or device; give a maze file"):
        load_maze("/dev/zero")


def test_a_generated_maze_has_a_largest_size() -> None:
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"3x1000000000 .*need 300,000,000,000 bytes.*4000000"):
        generate_maze("prim", height=3, width=10**9)
    assert tracemalloc.get_traced_memory()[1] < 10**6
    tracemalloc.stop()


def test_the_free_memory_is_the_least_that_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert 0 < memory.free_memory() < 2**50
    (tmp_path / "info").write_text("MemTotal: 9 kB\nMemAvailable:   2048 kB\n")
    (tmp_path / "most").write_text("max\n")
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "info")
    monkeypatch.setattr(memory, "LIMITS", (tmp_path / "most", tmp_path / "missing"))
    assert memory.free_memory() == 2048 * 1024
    (tmp_path / "most").write_text("1000000\n")
    assert memory.free_memory() == 1_000_000
    monkeypatch.setattr(memory, "SMALL", 0)
    with pytest.raises(ValueError, match="a cake needs 1,000,001 bytes of memory, and 1,000,000"):
        memory.check_memory("a cake", 1_000_001, "bake a smaller one")
    memory.check_memory("a cake", 1_000_000, "bake a smaller one")
    (tmp_path / "memory.current").write_text("400000\n")  # what the container has taken
    assert memory.free_memory() == 600_000
