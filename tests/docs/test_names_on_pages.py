"""The names and files that the text of pages and of CONTRIBUTING gives exist in the code."""

from __future__ import annotations

import fnmatch
import re

import pytest
import torch
from test_docs import ELSEWHERE, FENCE, ROOT, TEXTS


def files_of_the_repository() -> list[str]:
    """The paths of all files, as text, without what commands write."""
    return [
        str(path.relative_to(ROOT))
        for top in ROOT.iterdir()
        if top.name not in (".venv", ".git", "build", "runs", "sweeps", "ablations")
        for path in ([top] if top.is_file() else sorted(top.rglob("*")))
        if path.is_file() and "__pycache__" not in path.parts
    ]


@pytest.fixture(scope="module")
def words_of_the_code() -> set[str]:
    """All words of the code, of the names of its files, and of PyTorch's layers."""
    words = set(dir(torch.nn))
    for name in files_of_the_repository():
        words.update(re.findall(r"\w+", name))
        if name.endswith((".py", ".toml", ".js", "Makefile")):
            words.update(re.findall(r"\w+", (ROOT / name).read_text(encoding="utf-8")))
    return words


def code_in_text(page: str) -> list[str]:
    """What stands between backticks in the text, but for what a former commit had."""
    parts = re.split(r"\n\n|\n(?=\|)", FENCE.sub("", TEXTS[page]))
    present = [part for part in parts if not re.search(r"commit \w{7}", part)]
    return re.findall(r"`([^`\n]+)`", "\n\n".join(present))


@pytest.mark.parametrize("page", [p for p in TEXTS if p not in (*ELSEWHERE, "CHANGELOG.md")])
def test_the_names_in_the_text_of_a_page_exist(page: str, words_of_the_code: set[str]) -> None:
    """Names with an underscore or a capital inside are words of the code; paths are of files."""
    files = files_of_the_repository()
    folders = {name.partition("/")[0] for name in files if "/" in name}
    for code in code_in_text(page):
        if re.fullmatch(r"[A-Za-z_][\w.]*(\(.*\))?", code):
            for word in code.partition("(")[0].split("."):
                if re.search(r"[a-z]_|[a-z][A-Z]", word):
                    assert word in words_of_the_code, code
        elif re.fullmatch(r"[\w.*-]+/[\w./*-]*\.\w+", code) and code.partition("/")[0] in folders:
            assert fnmatch.filter(files, code), code


def test_the_files_that_contributing_names_exist() -> None:
    """Also those in tables, without their folders, with patterns."""
    files = files_of_the_repository()
    for code in re.findall(r"`([\w*./-]+(?:\.py|/))`", TEXTS["CONTRIBUTING.md"]):
        wanted = code.rstrip("/") + ("/*" if code.endswith("/") else "")
        assert fnmatch.filter(files, f"*{wanted}"), code
