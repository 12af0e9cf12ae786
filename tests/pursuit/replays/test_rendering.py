import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagonals import diagonal
from numpy.typing import NDArray
from PIL import Image

from pursuit.mazes.maze import Maze
from pursuit.rendering import rendering
from pursuit.rendering.animation import save_animation
from pursuit.rendering.rendering import (
    CAPTURED,
    EXIT,
    MARGIN,
    ROLE_COLORS,
    SHADES,
    WALL,
    WHITE,
    AgentMark,
    Scene,
    _shade,
)
from pursuit.rendering.windows import Window

MAZE = Maze.from_text("+-+-+-+-+\n|S  |   |\n+ +-+ + +\n| |  G| |\n+ + +-+ +\n|   |   |\n+-+-+-+-+")
BLOCKED = Maze.from_text("+-+-+-+\n|   |#|\n+   + +\n|  # #|\n+-+-+-+")
SCENE = Scene(
    MAZE,
    (AgentMark("chaser_0", 0), AgentMark("evader_0", 10), AgentMark("runner_0", 5)),
    goals=(3,),
    steps=12,
    max_steps=200,
)
CELL = 40


def open_maze(height: int, width: int) -> Maze:
    return Maze(
        np.ones((height, width), dtype=bool),
        np.ones((height - 1, width), dtype=bool),
        np.ones((height, width - 1), dtype=bool),
    )


def count(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> int:
    return int((picture == color).all(axis=-1).sum())


def cell_origin(maze: Maze) -> tuple[int, int]:
    """The first row and the first column of a picture that hold the colour of walls."""
    picture = Scene(maze, (), (), 0, 1).draw(cell_pixels=CELL)
    dark = (picture == WALL).all(axis=-1)
    longest = CELL * min(maze.height, maze.width)
    return int((dark.sum(axis=1) >= longest).argmax()), int((dark.sum(axis=0) >= longest).argmax())


@pytest.mark.parametrize(
    ("size", "cell_pixels"),
    diagonal([(1, 1), (2, 2), (5, 7), (30, 30), (1, 40), (40, 1)] * 2, [None, 3, 6, 7, 20]),
)
def test_a_picture_is_rgb_bytes_with_even_sides(
    size: tuple[int, int], cell_pixels: int | None
) -> None:
    height, width = size
    maze = open_maze(height, width)
    scene = Scene(maze, (AgentMark("chaser_0", maze.num_cells - 1),), (), 3, 200, "a caption")
    picture = scene.draw(cell_pixels=cell_pixels, size=300)
    assert picture.dtype == np.uint8
    assert picture.ndim == 3 and picture.shape[2] == 3
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    assert picture.flags.writeable
    if cell_pixels is None:
        assert max(picture.shape[0] - 60, picture.shape[1]) <= 300
        assert max(picture.shape) > 250
    else:
        assert picture.shape[0] > height * cell_pixels and picture.shape[1] > width * cell_pixels


@pytest.mark.parametrize("cell_pixels", [6, 13, 40, 100])
def test_every_role_and_goal_shows_its_colour(cell_pixels: int) -> None:
    picture = SCENE.draw(cell_pixels=cell_pixels)
    for color in ROLE_COLORS.values():
        assert count(picture, color) >= 8
    empty = replace(SCENE, agents=(), goals=()).draw(cell_pixels=cell_pixels)
    for color in ROLE_COLORS.values():
        assert count(empty, color) == 0


def test_agents_show_in_a_maze_of_100_by_100() -> None:
    maze = open_maze(100, 100)
    agents = (AgentMark("chaser_0", 0), AgentMark("evader_0", 9999), AgentMark("runner_0", 4567))
    picture = Scene(maze, agents, (99,), 0, 200).draw()
    for color in ROLE_COLORS.values():
        assert count(picture, color) >= 8


@pytest.mark.parametrize("agent", [0, 1, 2])
def test_a_move_changes_the_two_cells_and_nothing_else(agent: int) -> None:
    marks = list(SCENE.agents)
    marks[agent] = replace(marks[agent], cell=11)
    before = SCENE.draw(cell_pixels=CELL)
    after = replace(SCENE, agents=tuple(marks)).draw(cell_pixels=CELL)
    top, left = cell_origin(MAZE)
    changed = np.argwhere((before != after).any(axis=-1))
    cells = {((y - top) // CELL, (x - left) // CELL) for y, x in changed.tolist()}
    assert cells == {divmod(SCENE.agents[agent].cell, MAZE.width), divmod(11, MAZE.width)}


@pytest.mark.parametrize("maze", [MAZE, BLOCKED])
def test_walls_stand_where_the_maze_has_them(maze: Maze) -> None:
    picture = Scene(maze, (), (), 0, 200).draw(cell_pixels=CELL)
    top, left = cell_origin(maze)
    blocked = maze.cell_numbers < 0
    for row in range(maze.height):
        for column in range(maze.width):
            y, x = top + row * CELL, left + column * CELL
            if row:
                wall = not maze.open_south[row - 1, column]
                wall &= not (blocked[row, column] and blocked[row - 1, column])
                assert (tuple(picture[y, x + CELL // 2]) == WALL) == wall
            if column:
                wall = not maze.open_east[row, column - 1]
                wall &= not (blocked[row, column] and blocked[row, column - 1])
                assert (tuple(picture[y + CELL // 2, x]) == WALL) == wall
            assert tuple(picture[y + CELL // 2, x + CELL // 2]) != WALL
    for edge in (picture[top, left : left + maze.width * CELL], picture[top : top + CELL, left]):
        assert (edge == WALL).all()


def test_blocked_cells_differ_from_the_floor() -> None:
    picture = Scene(BLOCKED, (), (), 0, 200).draw(cell_pixels=CELL)
    top, left = cell_origin(BLOCKED)
    cell = picture[top + 10 : top + CELL - 2, left + 2 * CELL + 10 : left + 3 * CELL - 2]
    assert not (cell == 255).all(axis=-1).any()
    assert (picture[top + 10 : top + CELL - 2, left + 10 : left + CELL - 2] == 255).all()


@pytest.mark.parametrize("cell_pixels", [6, 20, 100])
def test_agents_in_the_same_cell_are_visible(cell_pixels: int) -> None:
    for cell in (0, 6, 11):
        marks = tuple(replace(mark, cell=cell) for mark in SCENE.agents)
        scene = replace(SCENE, agents=marks, goals=(cell,))
        picture = scene.draw(cell_pixels=cell_pixels)
        for color in ROLE_COLORS.values():
            assert count(picture, color) >= 8


def test_agents_of_one_role_carry_numbers() -> None:
    pair = (AgentMark("chaser_0", 0), AgentMark("chaser_1", 5))
    exchanged = (AgentMark("chaser_0", 5), AgentMark("chaser_1", 0))
    first = replace(SCENE, agents=pair).draw(cell_pixels=CELL)
    second = replace(SCENE, agents=exchanged).draw(cell_pixels=CELL)
    assert (first != second).any()


def test_exits_are_coloured_and_evaders_stand_on_them() -> None:
    maze = Maze.from_text("+-+-+-+\n|S G E|\n+-+-+-+")
    bare = Scene(maze, (AgentMark("evader_0", 0),), (), 0, 1)
    drawn = [replace(bare, exits=exits).draw(cell_pixels=CELL) for exits in ((), (2,), (0, 2))]
    assert [count(picture, EXIT) > 0 for picture in drawn] == [False, True, True]
    left = [picture[:, : picture.shape[1] // 2] for picture in drawn]
    assert [count(picture, EXIT) > 0 for picture in left] == [False, False, True]
    evader = [count(picture, ROLE_COLORS["evader"]) for picture in left]
    assert evader[0] == evader[1] == evader[2] > 0
    assert bare.text().splitlines()[1] == "|E    |"
    assert replace(bare, exits=(0, 2)).text().splitlines()[1] == "|E   X|"


def test_a_captured_evader_turns_grey() -> None:
    marks = (SCENE.agents[0], replace(SCENE.agents[1], active=False))
    picture = replace(SCENE, agents=marks).draw(cell_pixels=CELL)
    assert count(picture, ROLE_COLORS["evader"]) == 0
    assert count(picture, CAPTURED) >= 8


def test_the_footer_shows_steps_and_caption_and_keeps_its_size() -> None:
    pictures = [
        replace(SCENE, steps=steps, caption=caption).draw()
        for steps, caption in ((0, ""), (200, ""), (0, "short"), (0, "far too long " * 20))
    ]
    assert len({picture.shape for picture in pictures}) == 1
    assert len({picture.tobytes() for picture in pictures}) == 4


def test_a_picture_depends_on_the_scene_alone() -> None:
    first = SCENE.draw()
    first_bytes = first.tobytes()
    first[:] = 0  # the caller's array is its own
    replace(SCENE, agents=()).draw()
    rendering._background.cache_clear()
    rendering._token.cache_clear()
    assert SCENE.draw().tobytes() == first_bytes


def test_text_shows_every_agent_goal_and_the_step_count() -> None:
    assert SCENE.text() == (
        "+-+-+-+-+\n|C  |  G|\n+ +-+ + +\n| |R  | |\n+ + +-+ +\n|   |E  |\n+-+-+-+-+\n"
        "step 12 / 200\n"
    )


def test_text_lists_agents_in_the_same_cell() -> None:
    marks = (
        AgentMark("chaser_0", 5),
        AgentMark("evader_0", 5, active=False),
        AgentMark("evader_1", 2, active=False),
        *(AgentMark(f"runner_{i}", 11) for i in range(10)),
    )
    lines = replace(SCENE, agents=marks, caption="final").text().splitlines()
    assert lines[1] == "|   |e G|"
    assert lines[3] == "| |2  | |"
    assert lines[5] == "|   |  +|"
    assert lines[7] == "step 12 / 200  final"
    assert lines[8] == "2 at row 1, column 1: chaser_0, evader_0 (captured)"
    assert lines[9].endswith("runner_8, runner_9")


@pytest.mark.parametrize("name", ["chaser", "goal_0", "chaser_x", "", "Chaser_0"])
def test_unknown_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="chaser_N"):
        AgentMark(name, 0)


def test_invalid_cells_and_sizes_are_refused() -> None:
    with pytest.raises(ValueError, match="the cells are 0 to 11"):
        replace(SCENE, goals=(12,))
    with pytest.raises(ValueError, match="cell_pixels=2"):
        SCENE.draw(cell_pixels=2)
    with pytest.raises(ValueError, match="size=5"):
        SCENE.draw(size=5)


# -- animations --------------------------------------------------------------------------------


def episode(length: int) -> Iterator[Scene]:
    for step in range(length):
        marks = (AgentMark("chaser_0", step % 12), *SCENE.agents[1:])
        yield replace(SCENE, agents=marks, steps=step)


def test_a_gif_has_every_frame_in_true_colours(tmp_path: Path) -> None:
    path = tmp_path / "replay.gif"
    save_animation(path, episode(30), fps=10, size=200)
    with Image.open(path) as gif:
        assert getattr(gif, "n_frames", 1) == 30
        assert gif.info["loop"] == 0
        assert gif.info["duration"] == 100
        gif.seek(29)
        assert gif.info["duration"] == 1500
        shown = np.array(gif.convert("RGB"))
    drawn = list(episode(30))[29].draw(size=200)
    assert abs(shown.astype(int) - drawn).max() < 64  # blends at the edges are rounded
    for color in (WALL, *ROLE_COLORS.values()):
        assert abs(count(shown, color) - count(drawn, color)) < 0.2 * count(drawn, color)
    assert list(tmp_path.iterdir()) == [path]


def test_a_long_gif_is_small(tmp_path: Path) -> None:
    path = tmp_path / "replay.gif"
    save_animation(path, episode(200))
    assert path.stat().st_size < 1_000_000


def test_an_mp4_is_written(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "replay.mp4"
    save_animation(path, episode(8), fps=10, size=120)
    frames, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert frames == 8 + 14 and seconds == pytest.approx(2.2, abs=0.2)


def test_an_mp4_without_ffmpeg_names_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ImportError, match=r"pip install 'pursuit\[render\]'"):
        save_animation(tmp_path / "replay.mp4", episode(2))


def broken_episode() -> Iterator[Scene]:
    yield SCENE
    raise RuntimeError("the game broke")


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_failure_keeps_the_old_file(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / f"replay{suffix}"
    path.write_bytes(b"old")
    other_size = replace(SCENE, maze=open_maze(12, 1))
    with pytest.raises(RuntimeError, match="the game broke"):
        save_animation(path, broken_episode())
    with pytest.raises(ValueError, match="same height and width"):
        save_animation(path, [SCENE, other_size])
    with pytest.raises(ValueError, match="no scenes"):
        save_animation(path, [])
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_of_the_disk_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_disk(image: Image.Image, path: Path, **settings: Any) -> None:
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    path = tmp_path / "replay.gif"
    path.write_bytes(b"old")
    monkeypatch.setattr(Image.Image, "save", full_disk)
    with pytest.raises(OSError, match="No space left"):
        save_animation(path, [SCENE])
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_other_suffixes_and_rates_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"'\.avi'.*\.gif or \.mp4"):
        save_animation(tmp_path / "replay.avi", [SCENE])
    with pytest.raises(ValueError, match="fps=0"):
        save_animation(tmp_path / "replay.gif", [SCENE], fps=0)


# -- the window --------------------------------------------------------------------------------


def test_a_window_shows_scenes_until_its_button_closes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = Window()
    window.show(SCENE, fps=0)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert (shown == SCENE.draw()).all()
    window.show(replace(SCENE, maze=open_maze(12, 1)), fps=0)
    assert window.is_open
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    window.show(SCENE, fps=0)
    assert not window.is_open
    window.show(SCENE, fps=0)
    window.close()
    assert pygame.display.get_surface() is None


def test_a_window_without_pygame_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ImportError, match=r"pip install 'pursuit\[render\]'"):
        Window()


def test_values_moves_and_trails_are_in_the_cells() -> None:
    maze = Maze.from_text("+-+-+-+\n|     |\n+-+-+-+")
    agents = (AgentMark("chaser_0", 2),)
    moves, trails = (0, 2, 2), ((0, 1, 2),)
    scene = Scene(maze, agents, (), 2, 200, values=(5.0, 0.0, float("nan")), moves=moves)
    picture = scene.draw(cell_pixels=48)
    cells = [picture[MARGIN + 4 : MARGIN + 46, MARGIN + x : MARGIN + x + 36] for x in (6, 54, 102)]

    assert count(cells[0], _shade(SHADES)) > 1000 > count(cells[0], WHITE)
    assert count(cells[1], WHITE) > 1000
    arrows = [count(cell, ROLE_COLORS["runner"]) for cell in cells]
    assert 0 < arrows[0] < arrows[1] and arrows[2] == 0  # a dot to wait, an arrow, a token
    walked = replace(scene, trails=trails).draw(cell_pixels=48)
    assert count(walked[:, : MARGIN + 90], ROLE_COLORS["chaser"]) > 100
    assert count(picture[:, : MARGIN + 90], ROLE_COLORS["chaser"]) == 0
