"""The report of a sweep or of an ablation as one page, its figures inside."""

from __future__ import annotations

import base64
import re
from html import escape
from pathlib import Path

import markdown

from train.pages import write_page

KINDS = {".png": "image/png", ".svg": "image/svg+xml"}
PICTURE = re.compile(r'src="([^":]+)"')


def page_of(report: Path) -> Path:
    """Write `report.html` beside a `report.md`; where it is.

    All of the text is escaped first, so that nothing in it is HTML; figures that are not there, or
    of another kind than .png and .svg, are left as links that lead nowhere.

    Raises:
        OSError: it cannot be read or written.
    """
    text = report.read_text(encoding="utf-8")
    title = next((line[2:] for line in text.splitlines() if line.startswith("# ")), report.stem)
    body = markdown.markdown(escape(text, quote=False), extensions=["tables"])

    def inside(found: re.Match[str]) -> str:
        path = report.parent / found[1]
        kind = KINDS.get(path.suffix)
        if kind is None or not path.is_file() or path.resolve().parent != report.parent.resolve():
            return found[0]
        return f'src="data:{kind};base64,{base64.b64encode(path.read_bytes()).decode("ascii")}"'

    body = PICTURE.sub(inside, body.split("</h1>", 1)[-1])
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
