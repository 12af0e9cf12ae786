"""The report of a sweep or of an ablation as one page, its figures inside."""

from __future__ import annotations

import base64
import re
from html import unescape
from pathlib import Path

import markdown

from train.pages import write_page

KINDS = {".png": "image/png", ".svg": "image/svg+xml"}
LINK = re.compile(r'<(?P<tag>a|img)\b[^>]*? (?:href|src)="(?P<address>[^"]*)"[^>]*>')


def in_html(text: str) -> str:
    """Markdown as HTML, with tables; what is HTML in it already stands there as text."""
    converter = markdown.Markdown(extensions=["tables"])
    converter.preprocessors.deregister("html_block")
    converter.inlinePatterns.deregister("html")
    return converter.convert(text)


def page_of(report: Path) -> Path:
    """Write `report.html` beside a `report.md`; where it is.

    Nothing in the text is HTML, and nothing leads out of the report's folder: other links are left
    as text, and other pictures out. So are figures that are not there, or of another kind than .png
    and .svg.

    Raises:
        OSError: it cannot be read or written.
    """
    text = report.read_text(encoding="utf-8")
    title = next((line[2:] for line in text.splitlines() if line.startswith("# ")), report.stem)
    title = unescape(re.sub("<[^>]*>", "", in_html(title)))
    body = in_html(text)

    def inside(found: re.Match[str]) -> str:
        path, is_link = report.parent / found["address"], found["tag"] == "a"
        kind = KINDS.get(path.suffix)
        here = path.parent == report.parent and path.resolve().parent == report.parent.resolve()
        if not here or not path.is_file() or (kind is None and not is_link):
            return "<a>" if is_link else ""
        if is_link:
            return found[0]
        content = base64.b64encode(path.read_bytes()).decode("ascii")
        return found[0].replace(f'src="{found["address"]}"', f'src="data:{kind};base64,{content}"')

    body = LINK.sub(inside, body.split("</h1>", 1)[-1])
    path = report.with_suffix(".html")
    write_page(
        path,
        title,
        [
            body.replace("<table>", '<div class="wide"><table>').replace(
                "</table>", "</table></div>"
            )
        ],
    )
    return path
