"""Conversion of Markdown reports to single HTML files with embedded figures."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable
from html import escape, unescape
from pathlib import Path

from pursuit.replays.viewer.page import PLAYER, page
from train.files import Plain, write_text
from train.reports.tables import ResultTable, in_markdown, words

MEDIA_TYPES = {".png": "image/png", ".svg": "image/svg+xml"}
LINK = re.compile(r'<(?P<tag>a|img)\b[^>]*? (?:href|src)="(?P<address>[^"]*)"[^>]*>')


class Html(str):
    """A part of a page in HTML, with escaped texts."""


PLAYER_ELEMENT = Html('<div id="pursuit"></div>')
"""The HTML element of the player, for pages with replays."""


def in_html(text: str) -> Html:
    """Convert Markdown with tables to HTML; HTML in the text is escaped."""
    import markdown  # slow to import

    converter = markdown.Markdown(extensions=["tables"])
    converter.preprocessors.deregister("html_block")
    converter.inlinePatterns.deregister("html")
    found = re.sub(
        r'(<t[hd]) style="text-align: right;">', r'\1 class="number">', converter.convert(text)
    )
    found = found.replace("<table>", '<div class="wide"><table>')
    return Html(found.replace("</table>", "</table></div>"))


def pairs(found: Plain) -> str:
    """Names and values as a table, one row each."""
    rows = [{"name": name, "value": value} for name, value in found.items()]
    return ResultTable(rows, [words("", "name"), words("", "value")]).markdown()


def section(title: str, *parts: str) -> list[str]:
    """A heading followed by parts; empty if all parts are empty."""
    return [f"## {title}", *parts] if any(parts) else []


def embedded_picture(path: Path, text: str) -> Html:
    """An embedded picture, as `_embedded`; empty if the file does not exist."""
    if not path.is_file():
        return Html()
    return Html(f'<figure><img alt="{escape(text)}" src="{_embedded(path)}"></figure>')


def details(title: str, text: str) -> Html:
    """Markdown in a collapsed section."""
    return Html(f"<details><summary>{escape(title)}</summary>\n{in_html(text)}\n</details>")


def write_page(path: Path, title: str, parts: Iterable[str], data: object = None) -> None:
    """Write a page atomically; with `data` it contains the player.

    Args:
        path: of the page.
        title: plain text.
        parts: Markdown, or `Html`.
        data: of the player.

    Raises:
        ValueError: data that JSON does not support.
        OSError: it cannot be written.
    """
    found = [part if isinstance(part, Html) else in_html(part) for part in parts if part]
    scripts = PLAYER if data is not None else ()
    body = "\n".join([f"<h1>{escape(title)}</h1>", *found])
    write_text(path, page(title, data, scripts, body))


def page_of(report: Path) -> Path:
    """Write the HTML page of a Markdown report into its folder; returns its path.

    HTML in the text is escaped. Links to other folders are replaced by their text. Pictures in
    other folders, missing ones, and those other than .png and .svg are left out.

    Raises:
        OSError: it cannot be read or written.
    """

    def inside(found: re.Match[str]) -> str:
        path, is_link = report.parent / found["address"], found["tag"] == "a"
        here = path.parent == report.parent and path.resolve().parent == report.parent.resolve()
        if not here or not path.is_file() or (path.suffix not in MEDIA_TYPES and not is_link):
            return "<a>" if is_link else ""
        if is_link:
            return found[0]
        return found[0].replace(f'src="{found["address"]}"', f'src="{_embedded(path)}"')

    head, _, body = in_html(report.read_text(encoding="utf-8")).partition("</h1>")
    path = report.with_suffix(".html")
    write_page(path, unescape(re.sub("<[^>]*>", "", head)), [Html(LINK.sub(inside, body))])
    return path


def _embedded(path: Path) -> str:
    """The content of a picture as a data URL, of the .svg beside it unless that is older: then it
    is of a former report. Links may lead to other folders, and are not followed."""
    drawn = path.with_suffix(".svg")
    if drawn.is_file() and not drawn.is_symlink():
        path = max(path, drawn, key=lambda each: each.stat().st_mtime_ns)
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{MEDIA_TYPES[path.suffix]};base64,{content}"


def write_markdown(path: Path, title: str, parts: Iterable[str]) -> Path:
    """Write a report as Markdown and as an HTML page; empty parts are left out."""
    text = "\n\n".join(part for part in [f"# {in_markdown(title)}", *parts] if part)
    write_text(path, text + "\n")
    page_of(path)
    return path
