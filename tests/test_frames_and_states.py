"""Frames to a gap by the number of states: the line, its verdicts, and the recipe in short."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripted_agents import tour_lengths
from train.recipes import frames_and_states
from train.recipes.frames_and_states import (
    Reached,
    Recipe,
    learn,
    maze_file,
    power,
    powers,
    verdicts,
)
from train.recipes.frames_and_states import report as report_of


def grown(learner: str, exponent: float, number: int, reached: bool = True) -> list[Reached]:
    states = (10, 100, 1000)
    return [
        Reached(learner, size, number, n, round(50 * n**exponent), 0.01, reached or n < 1000)
        for size, n in zip((2, 3, 4), states, strict=True)
    ]


def test_a_power_law_is_found_and_judged() -> None:
    assert power(grown("table", 1.5, 0)) == pytest.approx(1.5, abs=0.01)
    runs = [run for n in range(8) for run in (*grown("table", 1.0, n), *grown("network", 0.4, n))]
    assert powers(runs)["network"][3] == pytest.approx(0.4, abs=0.01)
    p = "(p = 0.0078)"
    assert [line.partition(": ")[2] for line in verdicts(runs)] == [f"confirmed, 8 of 8 {p}"] * 2
    few = [run for run in runs if run.number < 5]  # the sign test of five cannot go below 0.0625
    told = ["undecided, 5 of 5 (p = 0.062)"] * 2
    assert [line.partition(": ")[2] for line in verdicts(few)] == told
    # A network that never gets there does not show that it needs few frames.
    never = [run for run in runs if (run.learner, run.number) != ("network", 1)]
    never = [run for run in never if (run.learner, run.number) != ("network", 2)]
    never += grown("network", 0.4, 1, False) + grown("network", 0.4, 2, False)
    assert verdicts(never)[1].endswith("undecided, 6 of 8 (p = 0.29)")
    slow = [run for n in range(8) for run in (*grown("table", 0.5, n), *grown("network", 0.4, n))]
    assert [line.partition(": ")[2] for line in verdicts(slow)] == [f"refuted, 0 of 8 {p}"] * 2


def test_a_table_ends_at_the_threshold_and_the_tables_say_so(tmp_path: Path) -> None:
    recipe = Recipe(sizes=(2, 3), num_goals=1, mazes=1, out=tmp_path, table_frames=100_000)
    found = [learn(recipe, ("table", size, 0)) for size in recipe.sizes]
    assert [run.states for run in found] == [12, 72]
    assert all(run.reached and run.gap <= 0.01 and run.frames < 50_000 for run in found)
    maze = maze_file(recipe, 3, 0)
    assert tour_lengths(frames_and_states.load_maze(maze), [0], [[8]])[0] >= 4
    short = Recipe(sizes=(3, 4), table_frames=4096, out=tmp_path / "short")
    few = learn(short, ("table", 4, 0))
    assert not few.reached and few.gap > 0.01 and few.frames == 4096
    networks = [Reached("network", r.size, 0, r.states, 2 * r.frames, 0.5, False) for r in found]
    lines = report_of([*found, *networks], recipe)
    assert any("| > " in line for line in lines[0].splitlines())
    assert (tmp_path / "frames_and_states.png").stat().st_size > 5000
    assert len((tmp_path / "runs.csv").read_text().splitlines()) == 5


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("--sizes 3", "at least two, or there is no line"),
        ("--sizes 1 3", "from 2 on"),
        ("--threshold 0", "it is above 0"),
        ("--mazes 0", "at least 1"),
        ("--workers 0", "at least 1"),
    ],
)
def test_nonsense_is_one_line(given: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        frames_and_states.main(given.split())
    assert told in capsys.readouterr().err


@pytest.mark.slow
def test_the_recipe_in_short(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = "--sizes 2 3 --mazes 1 --num-goals 1 --workers 2"
    frames_and_states.main([*short.split(), "--out", str(tmp_path / "runs")])
    told = capsys.readouterr().out
    assert "4 of 4: network, 3x3, maze 0, 72 states" in told and "power, set 0" in told
    assert (tmp_path / "runs" / "report.md").exists()
