"""The pages: their Python runs, their commands parse, their tables are those of the code.

The Python blocks of a page run in order, in one namespace, in a folder of their own. A block that
begins with `# NAME.py` is that file instead, which the blocks and commands of the page may import;
further blocks of the same name are added to it. Files in `examples/` that a page links are there
too. A page whose examples take long says so in a
comment, `<!-- slow: why -->`, and is left to `make test-all` and `make docs`.
"""

from __future__ import annotations

import itertools
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from inspect import ismodule
from pathlib import Path
from typing import Any

import environment_tables
import pytest

from pursuit import plugins as parts
from pursuit.plugins import is_reference
from pursuit.tasks.rewards import REWARDS
from train.commands.main import COMMANDS, command, main
from train.experiments.replication import load_replication
from train.experiments.stages import stages_of
from train.experiments.study import shipped

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {
    str(page.relative_to(ROOT)): page.read_text(encoding="utf-8")
    for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))
}
CHANGES = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
TEXTS = {
    **PAGES,
    "CONTRIBUTING.md": (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"),
    "CHANGELOG.md": CHANGES.partition("**Renamed options")[0],  # after it stand former names
}
"""The pages, and what else names commands, files and parts of the code."""
TUTORIALS = [page for page in PAGES if page.startswith("docs/tutorials/")]
OPTIONAL = {"stable_baselines3", "sb3_contrib", "supersuit", "ray", "pygame", "imageio",
            "benchmarl", "agilerl", "tianshou"}  # fmt: skip
FENCE = re.compile(r"^```([\w-]*)[^\n]*\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"# (\w+\.py)\n")
LINKED = re.compile(r"\]\((examples/\w+\.py)\)")
TOML_FILE = re.compile(r"# (\w+\.toml)\n")


def with_slow(pages: list[str]) -> list[Any]:
    """Parameters of a test, those of slow pages marked."""
    return [
        pytest.param(name, marks=pytest.mark.slow if "<!-- slow:" in PAGES[name] else ())
        for name in pages
    ]


def blocks(page: str, *languages: str) -> list[str]:
    return [code for language, code in FENCE.findall(TEXTS[page]) if language in languages]


def files_of(page: str) -> dict[str, str]:
    """The files that a page writes, or links in `examples/`, by name."""
    found: dict[str, list[str]] = {}
    for linked in LINKED.findall(TEXTS[page]):
        file = (ROOT / page).parent / linked
        found[file.name] = [file.read_text(encoding="utf-8")]
    for code in blocks(page, "python"):
        if named := FILE.match(code):
            found.setdefault(named[1], []).append(code)
    return {name: "\n\n".join(parts) for name, parts in found.items()}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where a page's examples run; what they register and allow is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(parts, "_allowed", set())
    monkeypatch.setattr(parts, "_named", set())
    monkeypatch.setattr(parts, "_folders", [])
    modules, rewards = set(sys.modules), set(REWARDS.names())
    yield tmp_path
    for name in set(sys.modules) - modules:
        if (tmp_path / f"{name}.py").exists():
            del sys.modules[name]
    for name in set(REWARDS.names()) - rewards:
        REWARDS.remove(name)


def written(page: str, folder: Path) -> None:
    for name, text in files_of(page).items():
        (folder / name).write_text(text, encoding="utf-8")


ELSEWHERE = {
    "docs/guides/other_libraries.md": "pursuit/environments/test_other_libraries.py",
}
"""Pages whose Python runs in a test of their own."""

PROMISES: dict[str, Callable[[dict[str, Any], Path], bool]] = {
    # The best response caught the evader that it was solved for.
    "docs/guides/simulator.md": lambda names, _: names["simulator"].episode_lengths.mean() < 40,
    # The curriculum reacted to the outcomes.
    "docs/guides/curricula.md": lambda names, _: names["curriculum"].epsilon < 1.0,
    "docs/guides/viewer.md": lambda names, _: (
        len(names["replay"].episodes) == 3 and "my games" in names["html"]
    ),
    "docs/guides/own_parts.md": lambda names, _: parts.allowed() == ("my_parts",),
}
"""What a page's examples come to, beyond running, from the names that they leave behind."""


# -- examples --------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", sorted(set(ELSEWHERE) & set(PAGES)))
def test_a_page_with_a_test_of_its_own_has_one(page: str) -> None:
    test = (ROOT / "tests" / ELSEWHERE[page]).read_text(encoding="utf-8")
    assert Path(page).name in test and "```python" in test


@pytest.mark.parametrize(
    "page",
    with_slow(
        [p for p in PAGES if blocks(p, "python") and p not in ELSEWHERE and p not in TUTORIALS]
    ),
)
def test_the_python_of_a_page_runs_in_order(page: str, folder: Path) -> None:
    written(page, folder)
    names: dict[str, Any] = {"__name__": page}
    for number, code in enumerate(blocks(page, "python")):
        if FILE.match(code):
            continue
        try:
            exec(compile(code, f"{page}, Python block {number}", "exec"), names)
        except ModuleNotFoundError as missing:
            if missing.name and missing.name.partition(".")[0] in OPTIONAL:
                pytest.skip(f"{missing.name} is not installed")
            raise
    if page in PROMISES:
        assert PROMISES[page](names, folder)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_runs_from_top_to_bottom(page: str, folder: Path) -> None:
    written(page, folder)
    names: dict[str, Any] = {"__name__": page}
    for number, (language, code) in enumerate(FENCE.findall(PAGES[page])):
        if language == "python" and not FILE.match(code):
            exec(compile(code, f"{page}, block {number}", "exec"), names)
        elif language == "toml":
            (folder / code[2 : code.index("\n")]).write_text(code, encoding="utf-8")
        elif language == "":
            for words in in_words(code):
                if words[0] == "pursuit":
                    main([*words[1:], *(["--no-open"] if words[1] == "view" else [])])


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [f"docs/guides/own_{name}.md" for name in ("parts", "games")],
)
def test_the_commands_of_own_parts_run_in_order(page: str, folder: Path) -> None:
    written(page, folder)
    for text in blocks(page, "toml"):
        if named := TOML_FILE.match(text):
            (folder / named[1]).write_text(text, encoding="utf-8")
    commands = [words for words in commands_of(page) if words[0] == "pursuit"]
    assert commands
    for words in commands:
        main(words[1:])
        if "--allow" in words:  # each is a process of its own
            parts._allowed.clear()


@pytest.mark.parametrize(
    "example", sorted((DOCS / "guides" / "examples").glob("*.py")), ids=lambda file: file.stem
)
def test_an_example_is_linked_by_one_guide_and_runs(example: Path, folder: Path) -> None:
    [page] = [page for page in PAGES if f"](examples/{example.name})" in PAGES[page]]
    if page not in ELSEWHERE:
        written(page, folder)
        import_module(example.stem)


# -- commands --------------------------------------------------------------------------------------


def commands_of(page: str) -> list[list[str]]:
    """The words of every command in blocks without a language."""
    return in_words("\n".join(blocks(page, "", "sh", "bash", "console")))


def in_words(text: str) -> list[list[str]]:
    """The words of every line of a block of commands, an array job's with its number."""
    lines = text.replace("\\\n", " ").replace("$SLURM_ARRAY_TASK_ID", "3").split("\n")
    return [
        words for line in lines if (words := shlex.split(line.removeprefix("$ "), comments=True))
    ]


def commands_in_text(page: str) -> list[list[str]]:
    """The words of every `pursuit ...`, `python ...` and `make ...` in the text."""
    text = FENCE.sub("", TEXTS[page])
    found = re.findall(r"`(?:PYTHONPATH=\. )?((?:pursuit|python|make) [^`]+)`", text)
    return [shlex.split(" ".join(said.split())) for said in found]


def is_a_name(words: list[str]) -> bool:
    """Whether words name a command, with placeholders or without options, rather than give one."""
    return len(words) == 2 or any(re.fullmatch(r"[A-Z.]{2,}|.*\|.*", word) for word in words[1:])


SHIPPED = {
    "sweep": shipped(),
    "ablate": shipped("ablation"),
    "compare": shipped("comparison"),
    "reproduce": [
        study.id
        for name in shipped("replication")
        for study in load_replication(["all"], "full", None, name).studies
    ],
}
"""The names of files and studies that these commands take."""


def check_shipped(words: list[str]) -> None:
    """Fail if a command names a shipped file or study that does not exist."""
    for name in itertools.takewhile(lambda word: word[0] != "-", words[2:]):
        if words[1] not in SHIPPED or name.isupper() or name == "all":
            continue
        if (ROOT / name).is_file():
            kind = {"sweep": "sweep", "ablate": "ablation"}[words[1]]
            for stage in stages_of(str(ROOT / name), kind, None, ROOT / "out"):
                assert stage.expand().runs
        elif not name.endswith(".toml"):  # that of a page
            assert name in SHIPPED[words[1]], f"{' '.join(words)}: no such file is shipped"


class Parsed(BaseException):
    """The options were taken; nothing is to be done."""


def parses(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse a command as the real one does, and stop there."""
    assert words[1] in COMMANDS, f"no such command: {' '.join(words)}"
    run, arguments = command(words[1]), words[2:]
    module: Any = sys.modules[run.__module__]
    real = module.parse

    def stop(*given: Any, **named: Any) -> Any:
        try:
            real(*given, **named)
        except ValueError as error:  # of folders that commands before would have made, and of
            # options that are only named
            assert re.search("no such folder|Missing value for argument", str(error)), error
        raise Parsed

    monkeypatch.setattr(module, "parse", stop)
    try:
        run(arguments)
    except Parsed:
        return
    except SystemExit as end:  # --help, or an error, which stands in the captured output
        assert not end.code and {"--help", "--help-all"} & {*words}, " ".join(words)


@pytest.mark.parametrize("page", [p for p in TEXTS if commands_of(p) or commands_in_text(p)])
def test_the_commands_of_a_page_parse(page: str, folder: Path) -> None:
    written(page, folder)
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for words in [*commands_of(page), *commands_in_text(page)]:
        if ">" in words[:-1]:  # later commands read the file
            (folder / words[words.index(">") + 1]).touch()
        for cut in ("|", "&&", ";", ">"):
            words = words[: words.index(cut)] if cut in words else words
        if words[0] == "pursuit":
            check_shipped(words)
        if words[0] == "make":
            assert words[1] in targets, words
        elif words[:2] == ["python", "-m"]:
            assert find_spec(words[2]), words
        elif words[0] == "python" and words[1] != "-m":
            assert (ROOT / words[1]).is_file(), words
        elif words[0] == "pursuit" and is_a_name(words):
            known = words[1] in COMMANDS or words[1].startswith("-") or words[1].isupper()
            assert known or is_reference(words[1]), f"no such command: {' '.join(words)}"
        elif words[1:2] == ["maze"] and "--out" in words:  # later commands read the file
            main(words[1:])
        elif words[0] == "pursuit":
            with pytest.MonkeyPatch.context() as own:
                parses(words, own)


@pytest.mark.parametrize("page", [p for p in PAGES if "title = " in "".join(blocks(p, "toml"))])
def test_the_sweep_files_of_a_page_load(page: str, folder: Path) -> None:
    written(page, folder)
    parts.allow(*(name.removesuffix(".py") for name in files_of(page)))
    for number, text in enumerate(blocks(page, "toml")):
        if "title = " in text:
            file = folder / f"{number}.toml"
            file.write_text(text, encoding="utf-8")
            kind = "ablation" if "control = " in text else "sweep"
            kind = "comparison" if "contestant" in text else kind
            for stage in stages_of(str(file), kind, "short", folder / "out"):
                assert stage.expand().runs


# -- what the pages say of the code ----------------------------------------------------------------


@pytest.mark.parametrize("page", environment_tables.pages())
def test_the_tables_of_an_environment_are_those_of_the_code(page: str) -> None:
    """To update them: `PYTHONPATH=. python tests/environment_tables.py`; read the change."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert environment_tables.renewed(text) == text


def test_every_file_of_data_is_named() -> None:
    folder = DOCS / "results" / "data"
    text = PAGES["docs/results/data/README.md"]
    for file in sorted(folder.rglob("*.csv")):
        assert f"({file.relative_to(folder)})" in text, file


@pytest.mark.parametrize("package", ["pursuit", "scripted_agents", "curricula", "train"])
def test_every_public_name_is_in_the_reference(package: str) -> None:
    def named_on(page: str) -> list[str]:
        return re.findall(r"^::: (\S+)$", PAGES[page], re.MULTILINE)

    named, found = named_on(f"docs/api/{package}.md"), import_module(package)
    names = [name for name in vars(found) if name[0] != "_" and not ismodule(vars(found)[name])]
    pages = [page for page in PAGES if page.startswith("docs/api/")]  # of shared names: one of them
    places = named if package != "pursuit" else [name for page in pages for name in named_on(page)]
    assert not {*getattr(found, "__all__", names)} - {name.split(".")[-1] for name in places}
    for name in named:
        module, _, last = name.rpartition(".")
        assert hasattr(import_module(module), last), name


def test_the_pictures_of_the_pages_exist() -> None:
    for page, text in PAGES.items():
        for path in re.findall(r'src="([^"]+)"|!\[[^\]]*\]\(([^)\s]+)', text):
            assert ((ROOT / page).parent / (path[0] or path[1])).is_file(), (page, path)


def test_the_names_to_follow_through_the_files_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = re.findall(r"`((?:pursuit|scripted_agents|train)/[\w/]+)\.py:([\w.]+)`", text)
    assert len(named) >= 15
    for module, path in named:
        found: Any = import_module(module.replace("/", "."))
        for name in path.split("."):
            assert hasattr(found, name), f"{module}: {path}"
            found = getattr(found, name, None)
