"""Outputs of commands: files that a command did not write are not replaced without --overwrite."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from played_by_hand import NORTH

from train.commands import play as play_command
from train.commands.main import main
from train.files import check_new_files, check_output_folder
from train.play.replay_folder import PATTERN

TINY = [
    *("--task", "maze", "--num-goals", "1", "--maze", "3x3", "--algorithm", "q_learning"),
    *("--num-games", "16", "--threads", "1", "--episodes", "20", "--frames", "512"),
]
SWEEP = 'title = "{}"\n{}[settings]\ntask = "maze"\nmaze = "2x2"\nframes = 64\n'
VARIANTS = '[[variants]]\nname = "a"\n[[variants]]\nname = "b"\ncurriculum = "num-goals"\n'


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "run"
    main(["train", *TINY, "--out", str(folder)])
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "command",
    [
        ["view", "RUN", "--no-open", "--out", "FILE"],
        ["view", "RUN", "RUN", "--no-open", "--out", "FILE"],
        ["render", "--maze", "3x3", "--out", "FILE"],
        ["evaluate", "RUN", "--episodes", "2", "--out", "FILE"],
        ["evaluate", "RUN", "--episodes", "2", "--replays", "STEM"],
        ["maze", "3x3", "--out", "FILE"],
        ["solve", "--maze", "2x2", "--out", "PICTURE"],
        ["maze", "2x2", "--picture", "PICTURE"],
    ],
    ids=" ".join,
)
def test_an_existing_file_is_not_replaced(
    command: list[str], trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, picture = (tmp_path / name for name in ("of.json", "of.png"))
    file.write_text("mine")
    picture.write_text("mine")
    places = {"RUN": trained, "FILE": file, "STEM": tmp_path / "of"}
    places |= {"PICTURE": picture}
    said = error_of(capsys, *(places.get(word, word) for word in command))
    assert "exists already; give a new file, or --overwrite" in said
    assert contents(tmp_path) == {str(file): b"mine", str(picture): b"mine"}


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (["view", "RUN", "--no-open", "--out", "FILE"], "checkpoint.pt"),
        (["view", "FILE", "--no-open", "--out", "LINK"], "replays.json"),
        (["evaluate", "RUN", "--episodes", "2", "--replays", "FILE"], "config.json"),
        (["evaluate", "RUN", "--episodes", "2", "--out", "LINK"], "results.json"),
        (["render", "RUN", "--out", "FILE"], "metrics.csv"),
        (["maze", "3x3", "--out", "FILE"], "metrics.csv"),
    ],
)
def test_a_run_and_the_input_are_never_replaced(
    command: list[str],
    name: str,
    trained: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before, file, link = contents(trained), trained / name, tmp_path / "link"
    link.symlink_to(file)
    places = {"RUN": trained, "FILE": file, "LINK": link}
    said = error_of(capsys, *(places.get(word, word) for word in command), "--overwrite")
    assert f"{name}: is " in said or "link: is " in said
    assert "never replaced; give a new file" in said
    assert contents(trained) == before and link.is_symlink()


@pytest.mark.parametrize(
    "command",
    [
        ["league", "astar", "random", "--maze", "2x2", "--games", "2"],
        ["report", "RUN"],
        ["sweep", "FOLDER/plan.toml"],
        ["ablate", "FOLDER/variants.toml"],
        ["compare", "ppo"],
        ["reproduce", "figure-2.2"],
        ["reproduce", "figure-2.2", "--page"],
        ["play", "--no-browser"],
    ],
    ids=" ".join,
)
def test_a_folder_with_other_files_is_not_written_to(
    command: list[str], trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text(SWEEP.format("one", ""))
    (tmp_path / "variants.toml").write_text(SWEEP.format("three", 'control = "a"\n') + VARIANTS)
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in ("report.md", "methods.md", "table.csv"):
        (folder / name).write_text("mine")
    before = contents(tmp_path)
    places = {"RUN": str(trained), "FOLDER/": f"{tmp_path}/"}
    for name, place in places.items():
        command = [word.replace(name, place) for word in command]
    said = error_of(capsys, *command, "--out", folder)
    assert f"{folder}: contains files that this command did not write; give a new folder" in said
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "command",
    [
        ["sweep", "maze_by_size", "--dry-run"],
        ["ablate", "opponent-epsilon", "--dry-run"],
        ["compare", "ppo", "--dry-run"],
        ["reproduce", "figure-2.2", "--dry-run"],
    ],
    ids=" ".join,
)
def test_a_dry_run_refuses_the_folder_that_the_command_refuses(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "report.md").write_text("mine")
    said = error_of(capsys, *command, "--out", tmp_path)
    assert "contains files that this command did not write" in said
    main([*command, "--out", str(tmp_path), "--overwrite"])


def test_a_command_writes_again_into_its_own_folder_and_overwrites_where_it_is_to(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in (
        ["league", "astar", "random", "--maze", "2x2", "--games", "2"],
        ["report", str(trained)],
    ):
        out = tmp_path / command[0]
        for _ in range(2):
            main([*command, "--out", str(out)])
    mixed = ["league", "astar", "random", "--maze", "2x2", "--games", "2", "--out"]
    assert "did not write" in error_of(capsys, *mixed, tmp_path / "report")
    main([*mixed, str(tmp_path / "report"), "--overwrite"])
    assert (tmp_path / "report" / "league.json").exists()
    page = tmp_path / "page.html"
    page.write_text("mine")
    main(["view", str(trained), "--no-open", "--out", str(page), "--overwrite"])
    assert page.read_text().startswith("<!DOCTYPE html>")


def test_a_sweep_keeps_its_folder_and_its_title(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, title in (("a", "one"), ("b", "two")):
        (tmp_path / f"{name}.toml").write_text(SWEEP.format(title, ""))
    out = tmp_path / "out"
    out.mkdir()
    (out / "runs").mkdir()
    (out / "sweep.json").write_text(json.dumps({"title": "one", "format": 2, "runs": []}))
    main(["sweep", str(tmp_path / "a.toml"), "--out", str(out), "--dry-run"])
    assert "did not write" in error_of(capsys, "sweep", tmp_path / "b.toml", "--out", out)
    main(["sweep", str(tmp_path / "b.toml"), "--out", str(out), "--dry-run", "--overwrite"])


def test_options_are_checked_before_anything_is_written(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = contents(trained)
    assert "hours" in error_of(capsys, "report", trained, "--x", "hours")
    evaluate = ("evaluate", trained, "--episodes", "2")
    same = error_of(capsys, *evaluate, "--out", tmp_path / "a.json", "--replays", tmp_path / "a")
    assert "two outputs" in same
    lost = error_of(capsys, *evaluate, "--replays", tmp_path / "a", "--out", tmp_path / "no" / "b")
    assert "make it first" in lost
    assert "p.txt" in error_of(capsys, "maze", "2x2", "--picture", tmp_path / "p.txt")
    assert contents(trained) == before and contents(tmp_path) == {}


def test_allowed_outputs(tmp_path: Path) -> None:
    new, held = tmp_path / "new", tmp_path / "held"
    held.mkdir()
    (held / ".lock").touch()
    for folder in (new, held):
        check_output_folder(folder, lambda folder: False)
    (held / "note.txt").touch()
    check_output_folder(held, lambda folder: (folder / "note.txt").exists())
    check_output_folder(held, lambda folder: False, overwrite=True)
    for name in ("config.json", "results.json"):  # of another program
        (held / name).write_text("{}")
    check_new_files([None, new, held / "note.txt", held / "results.json"], overwrite=True)
    with pytest.raises(ValueError, match=r"give a new folder$"):
        check_output_folder(held, lambda folder: False)
    with pytest.raises(ValueError, match="a file; give a folder"):
        check_output_folder(held / "note.txt", lambda folder: True, overwrite=True)
    with pytest.raises(ValueError, match="a folder; give the path of a file"):
        check_new_files([held], overwrite=True)


def test_games_that_could_not_be_written_are_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def play(session: Any, port: int, browser: bool, keeper: Any) -> None:
        for broken in (False, True):
            while not session.over:
                session.move(NORTH)
            if broken:
                monkeypatch.setattr("train.play.replay_folder.write_atomically", full)
            with contextlib.suppress(OSError):  # as the page does, which shows it
                keeper.keep(session)
            session.next_game()

    monkeypatch.setattr(play_command, "on_page", play)
    with pytest.raises(SystemExit) as ended:
        main(["play", "--maze", "2x2", "--max-steps", "3", "--out", str(tmp_path / "hand")])
    said = capsys.readouterr()
    assert ended.value.code == 1 and f"replays: {tmp_path / 'hand'}" in said.out
    assert "hand: 1 of 2 finished games could not be written; free" in said.err
    assert len(list((tmp_path / "hand").glob(PATTERN))) == 1
