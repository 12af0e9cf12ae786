"""What goes into papers: tables, figures, methods, names and power; the page as it stands."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy import stats
from scipy.integrate import quad

from train.commands.main import COMMANDS, main
from train.experiments.ablation import load_ablation
from train.experiments.methods import methods
from train.experiments.power import power_line, power_lines
from train.experiments.statistics import least_p, permutation_p, power
from train.experiments.sweep import load_sweep
from train.reports.curves import on_one_axis
from train.reports.figures import Look, pyplot, save
from train.reports.tables import Column, ResultTable, in_tex, words
from train.self_play.names import entry_names

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "for_a_paper.md"
HOSTILE = "a_b & 50 % of $x^2$ {~} #1 \\input{/etc/passwd} [-3, -0.5] | <b> ± --x\nnext"


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """Where the page's commands ran, one after the other, and what each printed."""
    folder, printed = tmp_path_factory.mktemp("paper"), {}
    text = PAGE.read_text(encoding="utf-8")
    commands = [line for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
                for line in block.splitlines()]  # fmt: skip
    with contextlib.chdir(folder):
        for line in commands:
            said = io.StringIO()
            with contextlib.redirect_stdout(said):
                main(shlex.split(line)[1:])
            printed[line] = said.getvalue()
        yield folder, printed


@pytest.mark.slow  # the page's runs take a minute
def test_the_commands_of_the_page_write_what_it_says(paper: tuple[Path, dict[str, str]]) -> None:
    folder, printed = paper
    for name in ("runs/ppo/learning_curve.pdf", "game.pdf", "comparison/curves.pdf"):
        assert (folder / name).read_bytes()[:5] == b"%PDF-", name
    for name in ("runs/ppo/learning_curve.svg", "maze.svg"):
        assert "<svg" in (folder / name).read_text(encoding="utf-8"), name
    assert (folder / "league" / "league.pdf").exists() and not (folder / "maze.png").exists()
    told = re.findall(r"```text\n(.*?)\n```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert told[0] in printed["pursuit ablate adaptive --dry-run"]


@pytest.mark.slow  # the page's runs take a minute
def test_the_python_of_the_page_runs(
    paper: tuple[Path, dict[str, str]], capsys: pytest.CaptureFixture[str]
) -> None:
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), {})
    assert "| algorithm | ppo or a2c | ppo |" in capsys.readouterr().out


@pytest.mark.slow  # the page's runs take a minute
def test_one_table_three_forms(paper: tuple[Path, dict[str, str]]) -> None:
    """Report, CSV and TeX say the same of the same rows."""
    out = paper[0] / "comparison"
    rows = list(csv.DictReader((out / "table.csv").open()))
    report = (out / "report.md").read_text()
    cells = [line.strip("| ").split(" | ") for line in report.splitlines() if line[:2] == "| "]
    tex = (out / "table.tex").read_text().split("\\midrule\n")[1].split("\\bottomrule")[0]
    for row, shown, line in zip(rows, cells[1:], tex.splitlines(), strict=True):
        assert row["group"] == shown[0] and f"{float(row['gap']):.2f}" in shown[6]
        assert line == " & ".join(map(in_tex, shown)) + " \\\\"
    final = json.loads((paper[0] / "runs/ppo/results.json").read_text())["evaluation"]
    assert float(rows[0]["gap"]) == pytest.approx(100 * final["optimality_gap"])


@pytest.mark.slow  # the page's runs take a minute
def test_methods_say_what_the_files_say(paper: tuple[Path, dict[str, str]]) -> None:
    folder = paper[0] / "runs/ppo"
    text = (folder / "methods.md").read_text()
    assert text == methods([folder])
    config, results = (
        json.loads((folder / f"{n}.json").read_text()) for n in ("config", "results")
    )
    facts = [
        results["versions"]["torch"],
        results["machine"]["processor"],
        "| seeds | 0 |",
        "| maze | 3x3 |",
    ]
    facts += ["| maze | 3x3 |", "| opponent_epsilon | 0.2 |", f"| {results['frames']:,} |"]
    facts += ["| evaluate | greedy |"]
    facts += [f"| num_games | {config['hyper']['num_games']} | 1024 |", "| threads | 1 | 0 |"]
    for fact in facts:
        assert fact in text, fact
    assert "learning_rate" not in text  # as it is by default
    league = (paper[0] / "league/methods.md").read_text()
    assert "| runs | 2 (" in league and "of 20 games a pair" in league


@pytest.mark.slow  # the page's runs take a minute
def test_a_league_calls_its_entries_as_asked(paper: tuple[Path, dict[str, str]]) -> None:
    content = json.loads((paper[0] / "league/league.json").read_text())
    assert content["chasers"] == ["PPO", "A2C", "A star", "chance"]
    rows = list(csv.DictReader((paper[0] / "league/table.csv").open()))
    assert [row["chaser"] for row in rows] == content["chasers"]
    assert float(rows[0]["against A star"]) == content["payoff"][0][0]
    assert "A2C" in (paper[0] / "league/chasers.tex").read_text()


def test_names_are_the_shortest_that_tell_apart(tmp_path: Path) -> None:
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
    for chosen, message in ((["1"], "1 names for 3"), (["1", "1", "2"], "called '1'")):
        with pytest.raises(ValueError, match=message):
            entry_names(entries[:3], is_agent, chosen)
    with pytest.raises(ValueError, match="give it once"):
        entry_names([entries[0], f"{entries[0]}/../one"], is_agent)


# -- tables ----------------------------------------------------------------------------------------


def test_hostile_names_are_escaped_everywhere(tmp_path: Path) -> None:
    table = ResultTable(
        [{"name": HOSTILE, "x": -0.5}], [words("name"), Column("x | y", lambda r: f"{r['x']}")]
    )
    assert all(line.replace("\\|", "").count("|") == 3 for line in table.markdown().splitlines())
    table.write(tmp_path)
    assert next(csv.DictReader((tmp_path / "table.csv").open(newline="")))["name"] == HOSTILE
    tex = in_tex(HOSTILE)
    for active in ("&", "%", "#", "_"):  # escaped, every time
        assert len(re.findall(re.escape(active), tex)) == tex.count("\\" + active) > 0
    assert "\\input" not in tex and "\n" not in tex and "--" not in tex
    assert "[$-$3, $-$0.5]".replace("[", "{[}").replace("]", "{]}") in tex
    for left, right in ("{}",):
        bare = tex.replace("\\{", "").replace("\\}", "")
        assert bare.count(left) == bare.count(right)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no pdflatex here")
@pytest.mark.slow  # the page's runs take a minute
def test_latex_takes_the_tables(tmp_path: Path, paper: tuple[Path, dict[str, str]]) -> None:
    table = ResultTable([{"name": HOSTILE}], [words("name")])
    table.write(tmp_path, "hostile")
    tables = [tmp_path / "hostile.tex", *paper[0].glob("*/*.tex")]
    inputs = "\n\n".join(f"\\input{{{path}}}" for path in tables)
    (tmp_path / "paper.tex").write_text(
        "\\documentclass{article}\\usepackage{booktabs}\\begin{document}\n"
        f"{inputs}\n\\end{{document}}\n"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]


# -- power -----------------------------------------------------------------------------------------


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


def test_the_power_of_four_against_four_is_an_integral() -> None:
    # p < 0.05 only where all runs of one side lie below all of the other: 2 of 70 splits, the next
    # being 4 of 70.
    def all_below(shift: float) -> float:
        def density(x: float) -> float:  # of the highest of four at x, with four others above
            own = 4.0 * stats.norm.pdf(x) * stats.norm.cdf(x) ** 3
            return float(own * stats.norm.sf(x - shift) ** 4)

        return float(quad(density, -10.0, 10.0)[0])

    for effect in (0.0, 0.5, 1.0, 2.0):
        exact = all_below(effect) + all_below(-effect)
        assert power([(4, 4)], effect) == pytest.approx(exact, abs=0.012)


@pytest.mark.parametrize(("effect", "arms"), [(0.0, 1), (1.0, 1), (1.0, 5), (2.0, 5)])
def test_the_power_is_that_of_scipys_test_and_little_less_than_of_students(
    effect: float, arms: int
) -> None:
    level = 0.05 / arms
    found = power([(9, 7)], effect, level)
    rng = np.random.default_rng(7)
    ours, theirs = rng.normal(size=(4000, 9)), rng.normal(effect, size=(4000, 7))
    p = stats.mannwhitneyu(ours, theirs, axis=1, method="exact").pvalue
    assert found == pytest.approx(float((p < level).mean()), abs=0.03)
    student = stats.nct(14, effect * np.sqrt(9 * 7 / 16))
    end = stats.t.isf(level / 2, 14)
    assert 0.0 < student.sf(end) + student.cdf(-end) - found < 0.15 * (effect > 0.0) + 0.02


def test_the_power_over_several_tasks_is_that_of_all_splits_within_them() -> None:
    rng, sizes, effect = np.random.default_rng(2), [(3, 3), (2, 4)], 1.5
    drawn = [rng.normal(size=(2000, n + m)) - effect * (np.arange(n + m) < n) for n, m in sizes]

    def improvements(runs: np.ndarray, own: tuple[int, ...]) -> np.ndarray:
        others = [i for i in range(runs.shape[1]) if i not in own]
        below = runs[:, list(own), None] < runs[:, None, others]
        return np.asarray(below.mean(axis=(1, 2)))

    every = [
        np.stack([improvements(runs, own) for own in combinations(range(n + m), n)])
        for runs, (n, m) in zip(drawn, sizes, strict=True)
    ]
    apart = abs((every[0][:, None] + every[1][None, :]) / 2 - 0.5)  # [splits, splits, studies]
    p = (apart >= apart[0, 0] - 1e-9).mean(axis=(0, 1))
    assert 0.2 < (p < 0.05).mean() < 0.9
    assert power(sizes, effect) == pytest.approx(float((p < 0.05).mean()), abs=0.03)


@pytest.mark.parametrize("sizes", [(1, 1), (3, 3), (2, 5), (6, 4)])
def test_the_smallest_attainable_p_is_the_least_level_with_power(sizes: tuple[int, int]) -> None:
    least = least_p([sizes])
    assert power([sizes], 9.0, least) == 0.0 < power([sizes], 9.0, 1.001 * least)


def test_what_is_called_power_is_power(tmp_path: Path) -> None:
    assert power_lines(load_ablation("adaptive", "short")) == [power_line([(6, 6)], 9)]
    for sizes, arms in (([(6, 6)], 9), ([(5, 5)], 1), ([(3, 3)] * 2, 1)):
        each = [f"{100 * power(sizes, effect, 0.05 / arms):.0f} %" for effect in (0.5, 1, 1.5, 2)]
        words_ = f"{', '.join(each[:3])} and {each[3]} at effects of 0.5, 1, 1.5 and 2 standard"
        assert words_ in power_line(sizes, arms)
    assert "smallest attainable p is 0.0079" in power_line([(5, 5)])
    assert "3 against 3 in each of 2 tasks: " in power_line([(3, 3)] * 2)
    assert power_line([(3, 3)]).startswith("3 against 3: 0 % at every effect")
    assert "U is 0.10; p < 0.05 takes 4 against 4 (0.029)" in power_line([(3, 3)])
    assert "p < 0.05 takes 6 against 6" in power_line([(5, 5)], 7)  # 7 times 2 of 252
    for seeds, words_ in (
        ("[0]", "of a single seed there is no interval"),
        ("[0, 1, 2]", "mean over 3 seeds. The power of a test of two settings, 3 against 3: 0 %"),
        ("[0, 1, 2, 3, 4]", "over 5 seeds. The power of a test of two settings, 5 against 5: 7 %"),
    ):
        file = tmp_path / "s.toml"
        file.write_text(
            f'seeds = {seeds}\nsettings = {{maze = "3x3", frames = 9}}\ngrid = {{gamma = [0.9, 1]}}'
        )
        assert words_ in power_lines(load_sweep(str(file)))[0]


# -- figures ---------------------------------------------------------------------------------------


def test_figures_are_the_same_bytes_in_every_format(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        figure, axis = pyplot().subplots()
        axis.plot([1, 2], [3, 4], label="curve")
        axis.legend()
        save(figure, tmp_path / folder / "f.png", formats=("pdf", "svg"))
    for name in ("f.png", "f.pdf", "f.svg"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert ">curve</text>" in (tmp_path / "a" / "f.svg").read_text()
    assert Image.open(tmp_path / "a" / "f.png").size[0] > 500
    for bad in ({"formats": ("gif",)}, {"x": "hours"}):
        with pytest.raises(ValueError, match="unknown"):
            Look(**bad)  # type: ignore[arg-type]


def test_a_logarithmic_axis_begins_above_nothing() -> None:
    curve = (np.array([0.0, 1.0, 10.0, 100.0]), np.array([9.0, 3.0, 2.0, 1.0]))
    points, values = on_one_axis([curve, curve], log=True)
    assert points[0] == 1.0 and (values[:, 0] == 3.0).all() and (values[:, -1] == 1.0).all()
    assert np.allclose(np.diff(np.log(points)), np.log(100) / (len(points) - 1))
    assert on_one_axis([curve])[0][0] == 0.0


# -- the command line ------------------------------------------------------------------------------


class Parsed(Exception):
    """The options are sound."""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_of_the_help_is_understood(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = __import__(f"train.commands.{name.replace('-', '_')}", fromlist=["parse"])
    parse = module.parse

    def parsed(*arguments: Any) -> None:
        try:
            parse(*arguments)
        except ValueError as error:
            assert "no such folder" in str(error)
        raise Parsed

    monkeypatch.setattr(module, "parse", parsed)
    with pytest.raises(Parsed):
        main([name, *shlex.split(COMMANDS[name].example)])
    main(["--help"])
    said = capsys.readouterr().out
    assert f"pursuit {name} {COMMANDS[name].example}" in said and COMMANDS[name].does in said
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
