"""Pictures of the site's most read pages, wide and narrow, light and dark.

    make docs
    python tools/screenshots.py OUT [PAGE.html ...]     # further pages, such as reports of runs

A Chromium is needed, named by PURSUIT_BROWSER or on the path.
"""

from __future__ import annotations

import os
import shutil
import sys
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
    from playwright.sync_api import sync_playwright

    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    pages = [SITE / f"{name}.html" for name in PAGES] + [Path(given) for given in sys.argv[2:]]
    browser = os.environ.get("PURSUIT_BROWSER") or shutil.which("chromium")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for page, width, scheme in product(pages, WIDTHS, SCHEMES):
            tab = opened.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
            tab.goto(page.resolve().as_uri())
            tab.wait_for_timeout(600)
            clip = {"x": 0, "y": 0, "width": width, "height": HEIGHT}
            name = f"{page.parent.name}-{page.stem}-{width}-{scheme}.png"
            tab.screenshot(path=out / name, full_page=True, clip=clip)
            tab.close()


if __name__ == "__main__":
    main()
