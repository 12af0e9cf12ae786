"""`pursuit demo`: a page if a browser can be shown, else an animation."""

from __future__ import annotations

import os
import subprocess
import sys
import webbrowser
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of, run
from PIL import Image

ROOT = Path(__file__).parents[3]
CODE = """
import sys
from train.commands.main import main
main(["demo"])
print(sorted({"torch", "torchrl", "matplotlib"} & {*sys.modules}))
"""


def test_without_a_display_an_animation_is_written_and_torch_is_not_loaded(tmp_path: Path) -> None:
    without = ("DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: value for name, value in os.environ.items() if name not in without}
    environment |= {"PYTHONPATH": str(ROOT), "SSH_CONNECTION": "a display of another machine"}
    command, how = [sys.executable, "-c", CODE], {"cwd": tmp_path, "env": environment}
    said = subprocess.run(command, capture_output=True, text=True, check=True, **how).stdout  # type: ignore[call-overload]
    (path,) = (tmp_path / "runs").iterdir()
    assert f"animation: {path.relative_to(tmp_path)}\n" in said and said.endswith("[]\n")
    with Image.open(path) as picture:
        assert picture.format == "GIF" and getattr(picture, "n_frames", 1) > 60


@pytest.mark.skipif(sys.platform == "win32", reason="DISPLAY says nothing there")
@pytest.mark.parametrize("opens", [True, False])
def test_with_a_display_the_page_is_opened(
    opens: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """Where the browser cannot be opened, the animation is written too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or opens)
    run("demo")
    pages = [*(tmp_path / "runs").glob("demo-*.html")]
    assert opened == [path.as_uri() for path in pages] and len(pages) == 1
    assert len([*(tmp_path / "runs").glob("demo-*.gif")]) == (not opens)
    assert ("animation: " in capsys.readouterr().out) == (not opens)


def test_the_page_plays_with_values_policies_and_trails(browser: Any, tmp_path: Path) -> None:
    page = tmp_path / "demo.html"
    run("demo", "--out", page)
    tab = browser.new_page()
    errors: list[str] = []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.goto(page.as_uri())
    state = tab.evaluate("window.pursuit.state()")
    assert state["playing"] and not errors
    assert all(state["shown"][name] for name in ("trails", "values", "policy"))
    tab.evaluate("window.pursuit.play(false); window.pursuit.go(1)")
    boards = tab.locator(".stage svg")  # of the A* chaser and of the optimal one
    assert boards.count() == 2
    for board in boards.all():
        assert board.locator(".values rect[fill^=rgb]").count() == 80  # all but that of the evader
    tab.close()


def test_no_file_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine = tmp_path / "mine.html"
    mine.write_text("mine")
    assert "exists already" in error_of(capsys, "demo", "--out", mine)
    assert ".html or .gif" in error_of(capsys, "demo", "--out", tmp_path / "demo.mp4")
    assert mine.read_text() == "mine" and [*tmp_path.iterdir()] == [mine]
