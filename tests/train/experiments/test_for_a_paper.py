"""Outputs for papers: tables, figures, methods and names; and the text of documents."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from train.commands.main import COMMANDS, command, main
from train.experiments.statistics import least_p, permutation_p
from train.reports.curves import on_one_axis
from train.reports.figures import pyplot, save
from train.reports.tables import Column, ResultTable, words
from train.self_play.names import entry_names

ROOT = Path(__file__).parents[3]
TINY = "--maze 3x3 --frames 2000 --num-games 16 --threads 1"
COMMANDS_OF_A_PAPER = (
    f"pursuit train {TINY} --minibatch-size 64 --out runs/ppo",
    f"pursuit train {TINY} --algorithm a2c --out runs/a2c",
    "pursuit solve --maze 3x3 --out game.svg",
    "pursuit maze 3x3 --picture maze.svg",
    "pursuit report runs/ppo runs/a2c --x seconds --log --out comparison",
    "pursuit league runs/ppo runs/a2c astar random --games 20 "
    "--names PPO A2C 'A star' chance --out league",
)
"""What the figures and tables of a paper are made by, on runs too short to learn anything."""
HOSTILE = "a_b & 50 % of $x^2$ {~} #1 \\input{/etc/passwd} [-3, -0.5] | <b> ± --x\nnext"


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """The folder in which the commands ran in sequence, and their outputs."""
    folder, printed = tmp_path_factory.mktemp("paper"), {}
    with contextlib.chdir(folder):
        for line in COMMANDS_OF_A_PAPER:
            said = io.StringIO()
            with contextlib.redirect_stdout(said):
                main(shlex.split(line)[1:])
            printed[line] = said.getvalue()
        yield folder, printed


@pytest.mark.slow  # the runs take a minute
def test_figures_are_vector_graphics_and_bitmaps(paper: tuple[Path, dict[str, str]]) -> None:
    folder, printed = paper
    names = ("runs/ppo/learning_curve", "comparison/learning_curves", "league/league")
    for name in (*names, "game", "maze"):
        assert "<svg" in (folder / f"{name}.svg").read_text(encoding="utf-8"), name
    assert all((folder / f"{name}.png").exists() for name in names)
    assert not (folder / "maze.png").exists() and printed


@pytest.mark.slow  # the runs take a minute
def test_one_table_two_forms(paper: tuple[Path, dict[str, str]]) -> None:
    """Report and CSV have the same rows and values."""
    out = paper[0] / "comparison"
    rows = list(csv.DictReader((out / "table.csv").open()))
    report = (out / "report.md").read_text()
    cells = [line.strip("| ").split(" | ") for line in report.splitlines() if line[:2] == "| "]
    for row, shown in zip(rows, cells[1:], strict=True):
        assert row["group"] == shown[0] and f"{float(row['gap']):.2f}" in shown[6]
    final = json.loads((paper[0] / "runs/ppo/results.json").read_text())["evaluation"]
    assert float(rows[0]["gap"]) == pytest.approx(100 * final["optimality_gap"])


@pytest.mark.slow  # the runs take a minute
def test_a_league_uses_the_given_names(paper: tuple[Path, dict[str, str]]) -> None:
    content = json.loads((paper[0] / "league/league.json").read_text())
    assert content["chasers"] == ["PPO", "A2C", "A star", "chance"]
    rows = list(csv.DictReader((paper[0] / "league/table.csv").open()))
    assert [row["chaser"] for row in rows] == content["chasers"]
    assert float(rows[0]["against A star"]) == content["payoff"][0][0]
    assert "A2C" in (paper[0] / "league/chasers.csv").read_text()


def test_names_are_the_shortest_unique_ones(tmp_path: Path) -> None:
    runs = ["a/one", "b/one", "b/two", "c/b/two", "x/astar", "pair", "pair/chaser", "z/pair"]
    for run in runs:
        (tmp_path / run).mkdir(parents=True, exist_ok=True)
    (tmp_path / "pair" / "config.json").touch()
    entries = [*(str(tmp_path / run) for run in runs), "astar"]
    is_agent = ["astar", "random"].__contains__
    top = tmp_path.name
    assert entry_names(entries, is_agent) == [
        *("a/one", "b/one", f"{top}/b/two", "c/b/two", "x/astar"),
        *(f"{top}/pair", f"{top}/pair/chaser", "z/pair", "astar"),
    ]
    assert entry_names(entries[:3], is_agent, ["1", "2", "3"]) == ["1", "2", "3"]
    for chosen, message in (
        (["1"], "1 names for 3"),
        (["1", "1", "2"], "two names are '1'"),
        (
            ["1", "2", "a\x1bb"],
            r"name 'a\\x1bb' is empty, or has characters that are not printable",
        ),
        (["1", "2", " "], "name ' ' is empty"),
    ):
        with pytest.raises(ValueError, match=message):
            entry_names(entries[:3], is_agent, chosen)
    with pytest.raises(ValueError, match="give it once"):
        entry_names([entries[0], f"{entries[0]}/../one"], is_agent)
    with pytest.raises(ValueError, match=r"name 'a\\x07' is empty, or has characters"):
        entry_names([str(tmp_path / "a\x07")], is_agent)
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert entry_names([str(tmp_path / "loop")], is_agent) == ["loop"]


# -- tables ----------------------------------------------------------------------------------------


def test_hostile_names_are_escaped_everywhere(tmp_path: Path) -> None:
    table = ResultTable(
        [{"name": HOSTILE, "x": -0.5}], [words("name"), Column("x | y", lambda r: f"{r['x']}")]
    )
    assert all(line.replace("\\|", "").count("|") == 3 for line in table.markdown().splitlines())
    table.write(tmp_path)
    assert next(csv.DictReader((tmp_path / "table.csv").open(newline="")))["name"] == HOSTILE


# -- the smallest p --------------------------------------------------------------------------------


@pytest.mark.parametrize("sizes", [(2, 2), (3, 3), (2, 4), (4, 4), (3, 5)])
def test_the_least_p_is_that_of_all_ways_to_split_the_runs(sizes: tuple[int, int]) -> None:
    ours, theirs = sizes
    values = range(ours + theirs)
    found = [
        permutation_p([list(part)], [[v for v in values if v not in part]])
        for part in combinations(values, ours)
    ]
    assert least_p([sizes]) == pytest.approx(min(found))


def test_the_least_p_of_several_tasks_and_of_splits_that_are_drawn() -> None:
    apart = [[1.0, 2.0, 3.0]] * 2, [[4.0, 5.0, 6.0]] * 2
    assert least_p([(3, 3)] * 2) == 2 / 400 == pytest.approx(permutation_p(*apart), rel=0.3)
    assert least_p([(20, 20)]) == pytest.approx(1 / 20_001)


# -- figures ---------------------------------------------------------------------------------------


def test_figures_are_the_same_bytes_in_every_format(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        figure, axis = pyplot().subplots()
        axis.plot([1, 2], [3, 4], label="curve")
        axis.legend()
        save(figure, tmp_path / folder / "f.png", "svg")
        save(figure, tmp_path / folder / "g.pdf")
    for name in ("f.png", "f.svg", "g.pdf"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert ">curve</text>" in (tmp_path / "a" / "f.svg").read_text()
    assert Image.open(tmp_path / "a" / "f.png").size[0] > 500
    with pytest.raises(ValueError, match="unknown format of a figure 'gif'"):
        save(figure, tmp_path / "f.gif")


def test_a_logarithmic_axis_starts_above_0() -> None:
    curve = (np.array([0.0, 1.0, 10.0, 100.0]), np.array([9.0, 3.0, 2.0, 1.0]))
    points, values = on_one_axis([curve, curve], log=True)
    assert points[0] == 1.0 and (values[:, 0] == 3.0).all() and (values[:, -1] == 1.0).all()
    assert np.allclose(np.diff(np.log(points)), np.log(100) / (len(points) - 1))
    assert on_one_axis([curve])[0][0] == 0.0


# -- the command line ------------------------------------------------------------------------------


class Parsed(Exception):
    """The options are valid."""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_of_the_help_is_valid(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = import_module(command(name).__module__)
    parse = module.parse

    def parsed(*arguments: Any) -> None:
        try:
            parse(*arguments)
        except ValueError as error:
            assert "no such folder" in str(error)
        raise Parsed

    monkeypatch.setattr(module, "parse", parsed)
    with pytest.raises(Parsed):
        main([name, *shlex.split(COMMANDS[name])])
    main(["--help"])
    said = capsys.readouterr().out
    assert f"pursuit {name} {COMMANDS[name]}".rstrip() in said
    assert max(map(len, said.splitlines())) <= 100


def test_the_citation_is_one() -> None:
    yaml = pytest.importorskip("yaml")
    content = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(content)  # what CFF 1.2 requires
    assert content["type"] == "software" and all("name" in author for author in content["authors"])
    project = (ROOT / "pyproject.toml").read_text()
    assert f'version = "{content["version"]}"' in project
    assert f'license = "{content["license"]}"' in project


def test_the_changelog_keeps_its_form() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    kinds = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert re.search(r"^## \[Unreleased\]", text, re.MULTILINE) and "Keep a Changelog" in text
    assert set(re.findall(r"^### (.+)$", text, re.MULTILINE)) <= kinds
