"""List the sentences of the pages with more than 35 words; `make docs` does so.

python tools/long_sentences.py [PAGE ...]
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MOST = 35
NOT_PROSE = re.compile(r"^```.*?^```|^ *\|.*?$|<!--.*?-->|^#.*?$", re.DOTALL | re.MULTILINE)
END = re.compile(r"(?<=[.!?])\s+(?=[A-Z`*\[])|\n\n+|\n(?= *[-*] |\d+\. )")


def long_sentences(text: str) -> Iterator[str]:
    """The sentences and items of lists with more than `MOST` words, each on one line."""
    for sentence in END.split(NOT_PROSE.sub("\n\n", text)):
        plain = " ".join(re.sub(r"\]\([^)]*\)", "]", sentence).split())
        if len(plain.split()) > MOST:
            yield plain


def main() -> None:
    """Print them by page."""
    data = ROOT / "docs" / "results" / "data"
    pages = [page for page in sorted((ROOT / "docs").rglob("*.md")) if data not in page.parents]
    for page in map(Path, sys.argv[1:] or [ROOT / "README.md", *pages]):
        for sentence in long_sentences(page.read_text(encoding="utf-8")):
            name, words = os.path.relpath(page), len(sentence.split())
            print(f"{name}: {words} words: {sentence[:100]} ...")


if __name__ == "__main__":
    main()
