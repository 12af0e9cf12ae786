"""Figures: every name is drawn as it is, and ticks of colour bars are round."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import pursuit
from scripted_agents import solve_chase
from train.commands.main import main
from train.commands.solve import draw_solution
from train.reports.curves import Level, Panel, Series, draw_panels
from train.reports.figures import PlottedEstimate, draw_intervals, draw_matrix, round_numbers

NAMES = ("cost$", "$x_1$", "a$b_$c", r"$\frac{$", "_hidden", r"50%_of {x}^c\d", "#1&<>")


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def texts(path: Path) -> list[str]:
    """The texts of an .svg file."""
    found = ElementTree.parse(path).iter("{http://www.w3.org/2000/svg}text")
    return ["".join(element.itertext()).strip() for element in found]


@pytest.mark.parametrize("name", NAMES)
def test_names_are_drawn_as_they_are(name: str, tmp_path: Path) -> None:
    """Of runs, variants, opponents and mazes: in titles, labels, ticks and legends."""
    points = np.array([0.0, 1.0, 2.0])
    curves = [(points, points + 1)]
    panel = Panel(
        [Series(curves, name), Series(curves, "other")], name, name, "gap", [Level(1.0, name)]
    )
    estimates = [PlottedEstimate(name, 1.0, 0.5, 2.0, (1.0,), group=group) for group in (name, "b")]
    for beside in (True, False):
        draw_panels(tmp_path / "curves.png", [[panel]], "frames", name, beside=beside)
        ends = [text.removesuffix(": 3.00 %") for text in texts(tmp_path / "curves.svg")]
        assert ends.count(name) == (4 if beside else 5)
    draw_intervals(tmp_path / "lines.png", {name: ("log", estimates)}, name, name)
    assert texts(tmp_path / "lines.svg").count(name) == 5
    labels = (name, [name, "b"])
    draw_matrix(
        tmp_path / "matrix.png", np.array([[1.0, 2.0], [3.0, 40.0]]), labels, labels, name, name
    )
    assert texts(tmp_path / "matrix.svg").count(name) == 6
    maze = pursuit.Maze.from_text(pursuit.load_maze("2x2-tree").to_text(), name)
    solution = replace(solve_chase(maze, horizon=2), maze=maze)  # of an equal maze if it is known
    draw_solution(tmp_path / "solution.svg", solution, 0, 1)
    assert f"{name}: exact solution, simultaneous" in texts(tmp_path / "solution.svg")


def test_a_maze_with_a_dollar_in_its_path_is_solved_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a$b_$c.txt").write_text(pursuit.load_maze("2x2-tree").to_text())
    main(["solve", "--maze", "a$b_$c.txt", "--horizon", "2", "--out", "solution.png"])
    assert Path("solution.png").stat().st_size > 1000


def test_numbers_on_a_logarithmic_scale_are_round() -> None:
    for low, factor in itertools.product(
        [1e-9, 0.013, 0.4, 1.0, 36.8, 999.0], [1.3, 2, 7, 99, 1e7]
    ):
        ticks = round_numbers(low, low * factor)
        assert 1 <= len(ticks) <= 11
        for tick in ticks:
            assert low <= tick <= low * factor
            assert len(f"{tick:.12g}".strip("0.").replace(".", "").lstrip("0").split("e")[0]) <= 3
    assert round_numbers(36.8, 101.2) == [40.0, 60.0, 80.0, 100.0]  # 36.8, 47.4, 61, ... before


def test_the_colour_bar_of_a_matrix_has_round_ticks(tmp_path: Path) -> None:
    names = ("r", ["a", "b"])
    draw_matrix(
        tmp_path / "m.png", np.array([[36.83, 47.21], [72.34, 101.29]]), names, names, "", ""
    )
    assert {"40", "60", "80", "100"} <= set(texts(tmp_path / "m.svg"))
