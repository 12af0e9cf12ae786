"""The site that `make docs` builds, opened from the disk in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

SITE = Path(__file__).parents[2] / "build" / "docs"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (SITE / "index.html").exists(), reason="`make docs` builds the site"),
]


@pytest.mark.parametrize(
    "name", ["index", "environments/mazes", "api/pursuit", "notebooks/self_play"]
)
def test_a_page_asks_nothing_of_the_network_and_its_search_finds(name: str, browser: Any) -> None:
    page = browser.new_page()
    asked: list[str] = []
    wrong: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((SITE / f"{name}.html").as_uri())
    page.keyboard.press("f")
    page.keyboard.type("exploitability")
    page.locator(".md-search-result__item").first.wait_for()
    titles = page.locator(".md-search-result__item h1").all_inner_texts()
    page.close()
    assert any("exploitability" in title for title in titles)
    assert not wrong and all(url.startswith(("file:", "data:", "blob:")) for url in asked)


@pytest.mark.parametrize(
    ("term", "first"),
    [
        ("quick start", "tutorials/first_run"),
        ("learning rate", "guides/"),
        ("wandb", "tutorials/continue"),
        ("SLURM", "guides/sweeps"),
        ("hyperparameters", "guides/"),
        ("callback", ""),
        ("custom environment", ""),
        ("evaluate", ""),
        ("save", ""),
        ("load", ""),
    ],
)
def test_the_search_finds_what_users_look_for(term: str, first: str, browser: Any) -> None:
    page = browser.new_page()
    page.goto((SITE / "index.html").as_uri())
    page.keyboard.press("f")
    page.keyboard.type(term)
    page.locator(".md-search-result__item").first.wait_for()
    links = page.locator(".md-search-result__link").evaluate_all("all => all.map(a => a.href)")
    page.close()
    parts = (first,) if first else ("guides/", "tutorials/", "environments/")
    assert any(part in links[0] for part in parts), links[:3]


def test_a_chase_can_be_played_to_its_end(browser: Any) -> None:
    """The rules stand in tables: the capture ends it, and the optimum is shown."""
    page = browser.new_page()
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((SITE / "live" / "play.html").as_uri())
    keys = ("ArrowUp", "ArrowRight", "ArrowDown", "ArrowLeft")
    for step in range(201):
        if page.locator(".result table").count():
            break
        page.keyboard.press(keys[step * step // 3 % 4])
    assert "steps in expectation" in page.inner_text(".result")
    page.keyboard.press("n")
    assert "game 2, step 0" in page.inner_text("[role=status]")
    page.close()
    assert not wrong
