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
    "term",
    ["hyperparameters", "callback", "custom environment", "evaluate", "save", "load"],
)
def test_the_search_finds_what_users_of_other_libraries_look_for(term: str, browser: Any) -> None:
    page = browser.new_page()
    page.goto((SITE / "index.html").as_uri())
    page.keyboard.press("f")
    page.keyboard.type(term)
    page.locator(".md-search-result__item").first.wait_for()
    links = page.locator(".md-search-result__link").evaluate_all("all => all.map(a => a.href)")
    page.close()
    assert any(part in links[0] for part in ("guides/", "tutorials/", "environments/"))
