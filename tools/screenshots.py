"""Pictures of the site's most read pages, wide and narrow, light and dark.

    make docs
    python tools/screenshots.py OUT [PAGE.html ...]     # further pages, such as reports of runs

A Chromium is needed, named by PURSUIT_BROWSER or on the path.
"""

from __future__ import annotations

import argparse
import os
import shutil
from itertools import product
from pathlib import Path

SITE = Path(__file__).parents[1] / "build" / "docs"
PAGES = (
    "index",
    "tutorials/first_run",
    "tutorials/self_play",
    "environments/mazes",
    "guides/algorithms",
    "guides/own_games",
    "reference/settings",
    "results/index",
    "results/self_play_mixing",
    "live/viewer",
    "live/play",
)
WIDTHS, SCHEMES = (1280, 390), ("light", "dark")
HEIGHT = 2400
"""Of a picture at most, in pixels."""


def main() -> None:
    """Write the pictures into a folder."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=raw)
    parser.add_argument("out", type=Path, help="the folder of the pictures")
    parser.add_argument("pages", type=Path, nargs="*", help="further pages")
    given = parser.parse_args()
    pages: dict[str, Path] = {}  # by the beginning of the names of their pictures
    for page in [*(SITE / f"{name}.html" for name in PAGES), *given.pages]:
        name = f"{page.resolve().parent.name}-{page.stem}"
        if name in pages:
            parser.error(f"{page} and {pages[name]} have the same folder and name; give one")
        pages[name] = page
    from playwright.sync_api import sync_playwright

    given.out.mkdir(parents=True, exist_ok=True)
    browser = os.environ.get("PURSUIT_BROWSER") or shutil.which("chromium")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for (name, page), width, scheme in product(pages.items(), WIDTHS, SCHEMES):
            tab = opened.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
            tab.goto(page.resolve().as_uri())
            tab.wait_for_timeout(600)
            clip = {"x": 0, "y": 0, "width": width, "height": HEIGHT}
            path = given.out / f"{name}-{width}-{scheme}.png"
            tab.screenshot(path=path, full_page=True, clip=clip)
            tab.close()


if __name__ == "__main__":
    main()
