"""Rendering of the arm: all parts are drawn at their positions."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import reference_arm
from diagonals import diagonal
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from test_reacher_environments import ID

from pursuit import ReacherSimulator, ReacherTask, reacher_v0
from pursuit.mazes.maze import Maze
from pursuit.reacher.rendering import (
    LINK,
    REACHED,
    TARGET,
    TIP,
    ArmScene,
    scene_of,
)
from pursuit.rendering.animation import save_animation
from pursuit.rendering.rendering import Scene

SCENE = ArmScene((math.pi / 2, -math.pi / 2), (-1.0, -1.0), 0.2, steps=12, max_steps=400)


def middle_of(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> tuple[float, float]:
    """Of the pixels of a colour, from the middle of the square: x to the right, y up."""
    rows, columns = np.nonzero((picture == color).all(axis=-1))
    half = picture.shape[1] / 2
    return columns.mean() + 0.5 - half, half - rows.mean() - 0.5


def test_the_text_of_an_arm() -> None:
    lines = replace(SCENE, caption="a caption").text().splitlines()
    assert len(lines) == 18 and max(map(len, lines[:17])) <= 33
    assert lines[4] == " " * 16 + "o-------@"  # a link of two is half the way to the rim
    assert [line[16] for line in lines[5:8]] == ["|"] * 3 and lines[8][16] == "#"
    assert lines[12] == " " * 8 + "X"
    assert not any(lines[:4]) and not any(lines[13:17])
    assert lines[17] == "step 12 / 400, distance 2.83, angles 1.57 -1.57  a caption"
    held = replace(SCENE, target=(1.0, 1.0), held=2, hold=5)
    assert "distance 0.00, held 2 / 5, angles" in held.text()
    assert held.text().splitlines()[4][24] == "*"


@settings(max_examples=60)
@given(st.lists(st.floats(-math.pi, math.pi), min_size=1, max_size=8))
def test_every_mark_of_the_text_stands_where_it_is(angles: list[float]) -> None:
    joints = len(angles)
    ends = reference_arm.ends(angles)
    target = 0.9 * joints * np.exp(1j * sum(angles))
    scene = ArmScene(tuple(angles), (target.real, target.imag), 0.2, 0, 9)
    lines = [line.ljust(33) for line in scene.text().splitlines()]

    def character(place: complex) -> str:
        row, column = 8 - place.imag / joints * 8, 16 + place.real / joints * 16
        near = [lines[r][c] for r in rounded(row) for c in rounded(column)]
        return "".join(near)

    def rounded(value: float) -> set[int]:
        return {round(value - 1e-9), round(value + 1e-9)}

    assert set(character(ends[-1])) & set("@*")
    assert set(character(target)) & set("X@*")
    assert set(character(0j)) & set("#X@*")
    for end in ends[:-1]:
        assert set(character(end)) & set("o#X@*")


@pytest.mark.parametrize(("joints", "size"), diagonal(range(1, 9), [96, 201, 480]))
def test_tip_and_target_show_where_they_are(joints: int, size: int) -> None:
    rng = np.random.default_rng(joints)
    angles = tuple(rng.uniform(-math.pi / 3, math.pi / 3, joints))
    scene = ArmScene(angles, (-0.7 * joints, 0.1), 0.2, 3, 400, caption="a caption")
    picture = scene.draw(size)
    assert picture.dtype == np.uint8 and picture.shape[1] == size - size % 2
    assert picture.shape[0] % 2 == 0 and picture.flags.writeable
    unit = (picture.shape[1] / 2 - 12) / (joints + 0.2)
    tip = reference_arm.ends(angles)[-1]
    assert middle_of(picture, TIP) == pytest.approx((unit * tip.real, unit * tip.imag), abs=1.5)
    target = (-0.7 * joints * unit, 0.1 * unit)
    assert middle_of(picture, TARGET) == pytest.approx(target, abs=1.5)
    assert (picture == scene.draw(size)).all()
    assert (picture == LINK).all(axis=-1).sum() > 4


def test_the_target_disc_shows_tolerance_and_reach() -> None:
    picture = replace(SCENE, tolerance=0.5).draw()
    unit = (480 / 2 - 12) / 2.5
    area = (picture == TARGET).all(axis=-1).sum()
    assert area == pytest.approx(math.pi * (0.5 * unit) ** 2, rel=0.08)
    assert not (picture == REACHED).all(axis=-1).any()
    there = replace(SCENE, target=(1.0, 0.85)).draw()
    assert (there == REACHED).all(axis=-1).any() and not (there == TARGET).all(axis=-1).any()


def test_footer_and_trace_are_drawn() -> None:
    plain = SCENE.draw()
    assert (replace(SCENE, steps=13).draw()[480:] != plain[480:]).any()
    assert (replace(SCENE, caption="mine").draw()[480:] != plain[480:]).any()
    traced = replace(SCENE, trace=((1.0, -1.0), (1.0, 0.0), (1.0, 1.0))).draw()
    changed = np.argwhere((traced[:480] != plain[:480]).any(axis=-1))
    unit = 228 / 2.2
    assert changed[:, 1].mean() == pytest.approx(240 + unit, abs=1.5)
    assert changed[:, 0].max() == pytest.approx(240 + unit, abs=3)
    with pytest.raises(ValueError, match="size=95; a picture of an arm needs at least 96"):
        SCENE.draw(95)


def test_scenes_of_a_simulator() -> None:
    simulator = ReacherSimulator(ReacherTask(3, hold=4, max_steps=9), 2)
    simulator.configure(tolerance=0.7)
    simulator.place([[0.1, 0.2, 0.3], [0.0] * 3], [[1.0, 2.0], [3.0, 0.0]])
    assert scene_of(simulator, 0, "mine") == ArmScene(
        (0.1, 0.2, 0.3), (1.0, 2.0), 0.7, 0, 9, 0, 4, "mine"
    )
    simulator.step(np.zeros((2, 3)))
    scene = scene_of(simulator, 1)
    assert (scene.held, scene.in_reach, scene.distance, scene.steps) == (1, True, 0.0, 1)
    np.testing.assert_allclose(scene.points[1:], simulator.ends[1], atol=1e-12)


# -- windows, animations, environments -------------------------------------------------------------


def test_an_animation_of_an_arm(tmp_path: Path) -> None:
    scenes = [replace(SCENE, steps=step, angles=(0.1 * step, 0.2)) for step in range(6)]
    save_animation(tmp_path / "arm.gif", scenes, fps=20, size=200)
    with Image.open(tmp_path / "arm.gif") as image:
        assert image.n_frames == 6 and image.info["loop"] == 0
        for step in (0, 5):
            image.seek(step)
            frame = np.array(image.convert("RGB")).astype(int)
            drawn = scenes[step].draw(200).astype(int)
            assert frame.shape == drawn.shape
            assert np.abs(frame - drawn).mean() < 2.0  # one palette for all frames
    mixed = [SCENE, Scene(Maze.from_text("+-+-+\n|   |\n+-+-+"), (), (), 0, 1)]
    with pytest.raises(ValueError, match="after pictures of"):
        save_animation(tmp_path / "mixed.gif", mixed)
    assert not (tmp_path / "mixed.gif").exists()


def test_environments_show_the_scene_of_their_arm() -> None:
    modes: Any = ({"render_mode": "ansi"}, {"render_mode": "rgb_array"})
    for make in (lambda **mode: gymnasium.make(ID, **mode).unwrapped, reacher_v0.parallel_env):
        text, picture = (make(**mode) for mode in modes)
        for env in (text, picture):
            env.reset(seed=0)
        assert text.render() == scene_of(text.simulator).text()
        assert (picture.render() == scene_of(picture.simulator).draw()).all()
