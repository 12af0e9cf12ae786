"""Pages of results: Markdown as HTML in one file, with its figures inside."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Mapping
from html import escape, unescape
from pathlib import Path
from typing import Any

import markdown

from pursuit.replays.viewer.page import PLAYER, page
from train.files import write_text
from train.reports.tables import ResultTable, in_markdown, words

KINDS = {".png": "image/png", ".svg": "image/svg+xml"}
LINK = re.compile(r'<(?P<tag>a|img)\b[^>]*? (?:href|src)="(?P<address>[^"]*)"[^>]*>')


class Html(str):
    """A part of a page that is HTML already; every text of others in it is escaped."""


PLAYER_ROOM = Html('<div id="pursuit"></div>')
"""Where the player goes, if the page has replays."""


def in_html(text: str) -> Html:
    """Markdown as HTML, with tables; HTML in it stands there as text."""
    converter = markdown.Markdown(extensions=["tables"])
    converter.preprocessors.deregister("html_block")
    converter.inlinePatterns.deregister("html")
    found = re.sub(
        r'(<t[hd]) style="text-align: right;">', r'\1 class="number">', converter.convert(text)
    )
    found = found.replace("<table>", '<div class="wide"><table>')
    return Html(found.replace("</table>", "</table></div>"))


def pairs(found: Mapping[str, Any]) -> str:
    """Names and values as a table, one row each."""
    rows = [{"name": name, "value": value} for name, value in found.items()]
    return ResultTable(rows, [words("", "name"), words("", "value")]).markdown()


def section(title: str, *parts: str) -> list[str]:
    """A heading and what stands under it; nothing where all parts are empty."""
    return [f"## {title}", *parts] if any(parts) else []


def picture(path: Path, text: str) -> Html:
    """A picture inside the page; nothing where there is no such file."""
    if not path.is_file():
        return Html()
    return Html(f'<figure><img alt="{escape(text)}" src="{_embedded(path)}"></figure>')


def details(title: str, text: str) -> Html:
    """Markdown that is folded away at first."""
    return Html(f"<details><summary>{escape(title)}</summary>\n{in_html(text)}\n</details>")


def write_page(path: Path, title: str, parts: Iterable[str], data: Any = None) -> None:
    """Write a page of results, beside `path` and renamed; with `data` it has the player.

    Args:
        path: of the page.
        title: plain text.
        parts: Markdown, or `Html`.
        data: what the player shows.

    Raises:
        ValueError: data that JSON cannot hold.
        OSError: it cannot be written.
    """
    found = [part if isinstance(part, Html) else in_html(part) for part in parts if part]
    scripts = PLAYER if data is not None else ()
    body = "\n".join([f"<h1>{escape(title)}</h1>", *found])
    write_text(path, page(title, data, scripts, body))


def page_of(report: Path) -> Path:
    """Write `report.html` beside a `report.md`; where it is.

    Nothing in the text is HTML, and nothing leads out of the report's folder: other links are left
    as text, and other pictures out. So are figures that are not there, or of another kind than .png
    and .svg.

    Raises:
        OSError: it cannot be read or written.
    """

    def inside(found: re.Match[str]) -> str:
        path, is_link = report.parent / found["address"], found["tag"] == "a"
        here = path.parent == report.parent and path.resolve().parent == report.parent.resolve()
        if not here or not path.is_file() or (path.suffix not in KINDS and not is_link):
            return "<a>" if is_link else ""
        if is_link:
            return found[0]
        return found[0].replace(f'src="{found["address"]}"', f'src="{_embedded(path)}"')

    head, _, body = in_html(report.read_text(encoding="utf-8")).partition("</h1>")
    path = report.with_suffix(".html")
    write_page(path, unescape(re.sub("<[^>]*>", "", head)), [Html(LINK.sub(inside, body))])
    return path


def _embedded(path: Path) -> str:
    """The content of a picture as an address."""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{KINDS[path.suffix]};base64,{content}"


def write_markdown(path: Path, title: str, parts: Iterable[str]) -> Path:
    """Write a report as Markdown, and as a page beside it; empty parts are left out."""
    text = "\n\n".join(part for part in [f"# {in_markdown(title)}", *parts] if part)
    write_text(path, text + "\n")
    page_of(path)
    return path
