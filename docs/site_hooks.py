"""What the site has besides docs/*.md: README, CONTRIBUTING, CHANGELOG, notebooks, references.

MkDocs calls these (mkdocs.yml names this file). One text serves the repository and the site, so
links are turned here from the one's paths to the other's.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import nbformat
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[1]
FROM_THE_ROOT = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Files beside docs/, and what they are called in the site."""


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made of something else."""
    for name, page in FROM_THE_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=in_the_site(text)))
    for notebook in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        add_notebook(notebook, files, config)
    sys.path.insert(0, str(ROOT / "docs"))
    import live_pages
    import reference_pages

    for name, make in (("viewer", live_pages.viewer_page), ("play", live_pages.play_page)):
        files.append(File.generated(config, f"live/{name}.html", content=make()))
    for name, make in (
        ("command_line", reference_pages.command_line),
        ("settings", reference_pages.settings),
    ):
        files.append(File.generated(config, f"reference/{name}.md", content=make()))
    return files


LIVE = """
[Open a trained chaser in the viewer](live/viewer.html){ .md-button .md-button--primary }
[Play against the evader yourself](live/play.html){ .md-button }
"""


def in_the_site(text: str) -> str:
    """A text of the repository's root with its links as the site has them."""
    text = text.replace("<!-- live pages -->", LIVE)
    text = text.replace("](docs/", "](").replace('src="docs/', 'src="')
    for name, page in FROM_THE_ROOT.items():
        text = re.sub(rf"\]\({re.escape(name)}(#[\w-]+)?\)", rf"]({page}\1)", text)
    return text


def add_notebook(notebook: Path, files: Files, config: Any) -> None:
    """A notebook as a page with the outputs that it was saved with, and its pictures."""
    page = f"notebooks/{notebook.stem}.md"
    body, resources = MarkdownExporter().from_notebook_node(
        nbformat.read(notebook, as_version=4), {"unique_key": notebook.stem}
    )
    body = re.sub(r"!\[png\]\(([^)]+)\)", r"![A figure of this notebook](\1)", body)
    for name, content in resources["outputs"].items():
        files.append(File.generated(config, f"notebooks/{Path(name).name}", content=content))
        body = body.replace(name, Path(name).name)
    body += f"\n\n[The notebook itself]({notebook.name}), to run and change.\n"
    files.append(File.generated(config, page, content=body))


COMMANDS = re.compile(r"^```\n(?=(?:pursuit|make|pip|python|OMP_NUM_THREADS=1) )", re.MULTILINE)
"""Where a block of commands begins."""


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to notebooks lead to their pages, and those to files beside docs/ to theirs.

    Blocks of commands are named, since long ones wrap (docs/extra.css). The search lists guides
    and tutorials before the many entries of the API and of results.
    """
    if page.file.src_uri.startswith(("guides/", "tutorials/")):
        page.meta["search"] = {"boost": 4}
    elif page.file.src_uri.startswith("results/"):
        page.meta["search"] = {"boost": 0.5}
    for name, page in FROM_THE_ROOT.items():
        markdown = markdown.replace(f"](../../{name}", f"](../{page}")
    markdown = COMMANDS.sub("``` { .text .commands }\n", markdown)
    return re.sub(r"\]\(((?:\.\./)?notebooks/\w+)\.ipynb\)", r"](\1.md)", markdown)


SHIM = "https://unpkg.com/iframe-worker/shim"
"""What the theme would load from elsewhere for searching in pages opened from the disk."""


def on_page_content(html: str, **_: Any) -> str:
    """Options such as --num-games do not break at their hyphens."""
    return re.sub(r"<code>(?=-[\w-]+</code>)", '<code class="option">', html)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Nothing is loaded from elsewhere: docs/file_worker.js does what the theme's script does.

    Raises:
        ValueError: the page would load something else from the network.
    """
    output = output.replace(SHIM, f"{'../' * page.url.count('/')}file_worker.js")
    if found := re.search(r"<(?:script|img|iframe|source)[^>]+src=\"?(https?:[^\" >]*)", output):
        raise ValueError(f"{page.file.src_uri}: would load {found[1]}; keep a copy in docs/")
    if found := re.search(r"<link[^>]+stylesheet[^>]+href=\"?(https?:[^\" >]*)", output):
        raise ValueError(f"{page.file.src_uri}: would load {found[1]}; keep a copy in docs/")
    return output


def on_post_template(output_content: str, **_: Any) -> str:
    """The same for the page that says that there is none."""
    return output_content.replace(SHIM, "/file_worker.js")
