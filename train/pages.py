"""Pages of results: parts of HTML in which every text of others is escaped."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from pursuit.viewer.page import PLAYER, page
from train.files import write_text

PLAYER_ROOM = '<div id="pursuit"></div>'
"""Where the player goes, if the page has replays."""


def section(title: str, *parts: str) -> str:
    """A part with a heading; nothing where all parts are empty."""
    inside = "\n".join(filter(None, parts))
    return f"<section><h2>{escape(title)}</h2>\n{inside}\n</section>" if inside else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table; columns whose first entry is a number are aligned as numbers."""
    found = list(rows)
    if not found:
        return ""
    kinds = ["" if isinstance(cell, str) else ' class="number"' for cell in found[0]]

    def row(tag: str, cells: Sequence[Any]) -> str:
        inside = (
            f"<{tag}{kind}>{_text(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True)
        )
        return f"<tr>{''.join(inside)}</tr>"

    body = "".join(row("td", cells) for cells in found)
    return f'<div class="wide"><table>{row("th", head)}{body}</table></div>'


def pairs(found: Mapping[str, Any]) -> str:
    """Names and values, one row each."""
    return table(("", ""), [(name, str(value)) for name, value in found.items()])


def picture(path: Path, text: str) -> str:
    """A picture inside the page; nothing where there is no such file."""
    if not path.is_file():
        return ""
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    source = f"data:image/png;base64,{content}"
    return f'<figure><img alt="{escape(text)}" src="{source}"></figure>'


def details(title: str, inside: str) -> str:
    """What is folded away at first."""
    return f"<details><summary>{escape(title)}</summary>\n{inside}\n</details>" if inside else ""


def write_page(path: Path, title: str, parts: Iterable[str], data: Any = None) -> None:
    """Write a page of results, beside `path` and renamed; with `data` it has the player.

    Raises:
        ValueError: data that JSON cannot hold.
        OSError: it cannot be written.
    """
    body = "\n".join([f"<h1>{escape(title)}</h1>", *filter(None, parts)])
    scripts = PLAYER if data is not None else ()
    write_text(path, page(title, data, scripts, body))


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return escape(f"{value:.4g}")
    return escape(str(value))
