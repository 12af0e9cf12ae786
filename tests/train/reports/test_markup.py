"""No text of a file becomes markup in a report: no link, no picture, no HTML, no emphasis."""

from __future__ import annotations

import os
from html.parser import HTMLParser
from pathlib import Path

import markdown
import pytest

from train.commands.main import main
from train.reports.pages import page_of
from train.reports.tables import ResultTable, in_markdown, words

HOSTILE = [
    "[x](javascript:alert(1))",
    "![x](http://localhost/x.png)",
    "[x][y]",
    "<b>bold</b>",
    "<http://localhost>",
    "<img src=x onerror=alert(1)>",
    "&lt;b&gt;",
    "`code`",
    "**strong** and *weak*",
    "__strong__ and _weak_",
    "~~gone~~",
    "a|b\\",
    "\\[x](y)",
    "two\nlines\n\n[y]: javascript:alert(1)",
]
HARMLESS = ["A* chaser", "opponent_epsilon 0.2", "1.00 [0.52, 1.48]", "below < 5 %", "7x7-tree"]
SHOWS = {"a", "img", "b", "strong", "em", "i", "code", "del", "script"}


class Tags(HTMLParser):
    """The tags that show something, the addresses in them, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags += [tag] if tag in SHOWS else []
        self.addresses += [str(value) for name, value in attrs if name in ("href", "src")]

    def handle_data(self, data: str) -> None:
        self.text += data


def body_of(page: Path) -> Tags:
    return Tags(page.read_text().partition("<body>")[2].partition("<script")[0])


@pytest.mark.parametrize("text", [*HOSTILE, *HARMLESS])
def test_a_text_is_shown_letter_by_letter(text: str, tmp_path: Path) -> None:
    table = ResultTable([{"arm": text}], [words("arm"), words(text, "arm")]).markdown()
    report = tmp_path / "report.md"
    report.write_text(f"# {in_markdown(text)}\n\nOf {in_markdown(text)}.\n\n{table}\n")
    page = body_of(page_of(report))
    assert page.tags == page.addresses == []
    assert page.text.count(" ".join(text.split())) == 5  # both headings, the paragraph, the cells
    assert text not in HARMLESS or in_markdown(text) == text


def test_nothing_on_a_page_leads_out_of_its_folder(tmp_path: Path) -> None:
    (tmp_path / "methods.md").touch()
    (tmp_path.parent / "above.png").write_bytes(b"picture")
    report = tmp_path / "report.md"
    report.write_text(
        "# A\n\n[a](javascript:alert(1)) [b](//localhost/b) ![c](http://localhost/c.png) "
        "![d](../above.png) [e](data:text/html,x) [f][g] <http://localhost> [m](methods.md)\n\n"
        "[g]: https://localhost\n"
    )
    page = body_of(page_of(report))
    assert set(page.addresses) <= {"methods.md"} and "methods.md" in page.addresses


@pytest.mark.slow
def test_the_report_of_a_sweep_has_no_markup_of_others(tmp_path: Path) -> None:
    hostile = "[x](javascript:alert(1)) ![](http://localhost/x.png) <b>bold</b>"
    maze = tmp_path / f"{hostile.replace('/', '_')}.txt"
    maze.write_text("+-+-+\n|S G|\n+-+-+")
    path, out = tmp_path / "sweep.toml", tmp_path / "out"
    path.write_text(
        f"title = '{hostile}'\nepisodes = 2\n"
        "[settings]\nalgorithm = 'q_learning'\nframes = 256\nnum_games = 16\n"
        f"maze = '{maze}'\n[[variants]]\nname = '{hostile}'\nlearning_rate = 0.1\n"
        "[[variants]]\nname = 'other'\nlearning_rate = 0.2\n"
    )
    main(["sweep", str(path), "--out", str(out), "--workers", "1"])
    text = (out / "report" / "report.md").read_text()
    tags = Tags(markdown.markdown(text, extensions=["tables", "fenced_code"]))
    assert not any(":" in address for address in tags.addresses)
    assert not {"b", "script"} & {*tags.tags}
    page = body_of(out / "report" / "report.html")
    assert all(address.startswith("data:image/") for address in page.addresses)
    assert hostile in page.text and "b" not in page.tags


def test_a_page_has_the_newer_of_two_formats_of_a_picture(tmp_path: Path) -> None:
    """A former report may have left an .svg; a link to another folder is not followed."""
    (tmp_path / "outside").mkdir()
    report, picture, drawn = (tmp_path / name for name in ("r.md", "p.png", "p.svg"))
    report.write_text("# A\n\n![p](p.png)\n")
    picture.write_bytes(b"picture")
    os.utime(picture, (2, 2))
    for seconds, form in ((1, "image/png"), (3, "image/svg+xml")):
        drawn.write_text("<svg/>")
        os.utime(drawn, (seconds, seconds))
        (address,) = Tags(page_of(report).read_text()).addresses[-1:]
        assert address.startswith(f"data:{form};")
    (tmp_path / "outside" / "secret").write_text("secret")
    drawn.unlink()
    drawn.symlink_to(tmp_path / "outside" / "secret")
    assert Tags(page_of(report).read_text()).addresses[-1].startswith("data:image/png;")
