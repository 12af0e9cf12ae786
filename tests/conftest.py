"""Settings of the whole suite."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import settings

from pursuit.mazes import maze as maze_module
from pursuit.mazes import maze_arrays
from pursuit.mazes.maze_arrays import lay_out
from pursuit.tasks import placements
from scripted_agents.agents import scripted
from scripted_agents.exact.tours import tour

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
# One thread each: small networks gain nothing from more, and lose much where cores are shared.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# The processes that tests start read some 300 of our files each: let the first keep them compiled.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# `make test` is steady: the same examples every time. `make test-all` looks for new ones
# (--hypothesis-profile=random), and prints how to see a failure again.
settings.register_profile("steady", derandomize=True, database=None, deadline=None)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile("steady")


@pytest.fixture
def without_tables(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """Call it, and from then on every maze counts as too large for a table of distances."""

    def begin() -> None:
        for module in (maze_module, maze_arrays, placements, scripted, tour):
            monkeypatch.setattr(module, "MAX_TABLE_CELLS", 10)
        lay_out.cache_clear()

    yield begin
    lay_out.cache_clear()


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def find_browser() -> str | None:
    """A Chromium, named by PURSUIT_BROWSER or found on the path; None where there is none."""
    named = os.environ.get("PURSUIT_BROWSER")
    return named or next(filter(None, map(shutil.which, BROWSERS)), None)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium, driven by Playwright; skips where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api")
    path = find_browser()
    if path is None:
        pytest.skip(NO_BROWSER)
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield opened
        opened.close()


NO_BROWSER = "no Chromium found: the pages were not driven in a browser (apt install chromium)"


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say in one line that the pages were not looked at."""
    if any(NO_BROWSER in str(r.longrepr) for r in terminalreporter.stats.get("skipped", [])):
        terminalreporter.write_line(NO_BROWSER)
