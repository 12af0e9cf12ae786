"""Speed of the viewer page when scrubbing in Chromium, and its size.

python tools/benchmarks/bench_viewer.py

Every step is drawn in one animation frame, so the screen's rate, such as 60 per second, is the
limit. "drawing" is the time in the code of the page; "could be" is the rate that it would allow.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from pursuit import Recorder
from pursuit.replays.viewer.data import Builder, Extras
from scripted_agents import AStarChaser
from train.machine import processor
from train.reports.pages import PLAYER_ELEMENT, write_page
from train.runs.parts import contest_of
from train.settings.task import TaskSettings

SCRUB = """() => new Promise((done) => {
  const times = [], drawing = [];
  let step = 0;
  const tick = (now) => {
    times.push(now);
    const before = performance.now();
    window.pursuit.go(step++);
    drawing.push(performance.now() - before);
    if (step <= window.pursuit.length) requestAnimationFrame(tick);
    else done([times, drawing]);
  };
  requestAnimationFrame(tick);
})"""


def page_of(maze: str, folder: Path) -> Path:
    """An episode of 200 steps, with data for all overlays."""
    contest: Any = contest_of(TaskSettings(maze=maze, role="chaser", opponent_epsilon=0.0), 2)
    policy = AStarChaser(1.0)
    for number in range(1000):
        simulator, play = contest.game(policy, number)
        recorder = Recorder(simulator)
        for _ in play:
            pass
        replay = recorder.stop()
        if replay.episodes[0].length == 200:
            break
    builder = Builder()
    builder.add(
        replay, Extras(overlays=contest.overlays(policy), seat="chaser_0", encoding="index")
    )
    path = folder / f"{maze}.html"
    write_page(path, maze, [PLAYER_ELEMENT], builder.data(maze))
    return path


def main() -> None:
    """Print one line per maze, without and with all overlays."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        sys.exit("no Chromium found (apt install chromium)")
    print(f"{processor()}\n{'':<28}{'page':>9}{'frames/s':>10}{'drawing':>10}{'could be':>10}")
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for maze in ("5x5", "9x9", "15x15"):
            path = page_of(maze, Path(folder))
            size = f"{path.stat().st_size / 1e3:.0f} kB"
            for keys in ("vp", "o"):  # values and policy are shown at first
                tab = browser.new_page(
                    viewport={"width": 1200, "height": 900}, reduced_motion="reduce"
                )
                tab.goto(path.as_uri())
                for key in keys:
                    tab.keyboard.press(key)
                times, drawing = tab.evaluate(SCRUB)
                rate = 1000 * (len(times) - 1) / (times[-1] - times[0])
                spent = float(np.mean(drawing))
                name = f"{maze}, 200 steps" + (", all overlays" if keys == "o" else "")
                print(f"{name:<28}{size:>9}{rate:>10.1f}{spent:>7.2f} ms{1000 / spent:>10.0f}")
                tab.close()
        browser.close()


if __name__ == "__main__":
    main()
