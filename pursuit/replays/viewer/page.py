"""Self-contained HTML pages without external resources."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib.resources import files

PLAYER = ("board.js", "maze_board.js", "arm_board.js", "game_board.js", "player.js")
"""The scripts of the replay viewer, in the order of their dependencies."""
STYLE = "style.css"


@cache
def resource(name: str) -> str:
    """The text of a file of this package."""
    return files("pursuit.replays.viewer").joinpath(name).read_text(encoding="utf-8")


def json_for_html(data: object) -> str:
    """`data` as JSON, escaped so that no text can end the script element.

    Raises:
        ValueError: NaN or infinity, which JSON cannot represent.
    """
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def digest(text: str) -> str:
    """The source expression of a content security policy that allows this inline text only."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def page(
    title: str,
    data: object,
    scripts: Sequence[str] = PLAYER,
    body: str = '<main id="pursuit"></main>',
    connects: bool = False,
) -> str:
    """Build one self-contained page.

    Its content security policy allows only the given scripts, and no requests except to the server
    of the page with `connects`.

    Args:
        title: plain text.
        data: JSON values, which the scripts read from the element "pursuit-data".
        scripts: files of this package.
        body: HTML; escape untrusted text with `html.escape`.
        connects: whether the scripts send requests to the server of the page.

    Raises:
        ValueError: data that JSON cannot represent.
    """
    code, style = "\n".join(resource(name) for name in scripts), resource(STYLE)
    policy = (
        f"default-src 'none'; script-src {digest(code)}; style-src {digest(style)}; "
        "img-src data:; base-uri 'none'; form-action 'none'"
        + ("; connect-src 'self'" if connects else "")
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>{style}</style>
</head>
<body>
{body}
<script type="application/json" id="pursuit-data">{json_for_html(data)}</script>
<script>{code}</script>
</body>
</html>
"""
