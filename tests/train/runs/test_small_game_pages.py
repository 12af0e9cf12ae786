"""The files and pages of runs in small games, of one player and of self-play."""

from __future__ import annotations

import json
import shlex
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from command_errors import error_of
from drawn_games import HOSTILE
from PIL import Image

from pursuit import plugins
from train.commands.main import main

TINY = [
    *("--frames", "2048", "--num-games", "16", "--threads", "1"),
    *("--rollout-steps", "16", "--minibatch-size", "128"),
]
CORRIDOR = "drawn_games:Corridor(form={})"


class Parts(HTMLParser):
    """The elements of a page, what they refer to, and the data of the player."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.counts: dict[str, int] = {}
        self.addresses: list[str] = []
        self.texts: list[str] = []
        self.code: list[str] = []
        self.inside = ""
        self.feed(path.read_text(encoding="utf-8"))
        self.data: Any = json.loads(self.code[0])

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.addresses += [str(v) for name, v in attrs if name in ("src", "href", "data", "action")]
        self.inside = tag

    def handle_data(self, data: str) -> None:
        (self.code if self.inside == "script" else self.texts).append(data)


@pytest.fixture(autouse=True)
def trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(plugins.ALLOW, "drawn_games")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A folder for every kind of run and drawing."""
    root = tmp_path_factory.mktemp("runs")
    for form in ("text", "svg"):
        game = ["--game", CORRIDOR.format(form), "--max-steps", "20"]
        main(["train", *game, "--player", "thief", *TINY, "--out", str(root / form)])
    main(["train", "--game", "drawn_games:Three", *TINY, "--out", str(root / "three")])
    main(["train", "--game", "drawn_games:Hostile", *TINY, "--out", str(root / "hostile")])
    for name, game in (("together", "drawn_games:Three"), ("pair", CORRIDOR.format("svg"))):
        fixed = ["--b", "uniform"] if name == "together" else ["--max-steps", "20"]
        rest = ["--snapshots", "2", "--out", str(root / name)]
        main(["self-play", "--game", game, *fixed, *TINY, *rest])
    return {path.name: path for path in root.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["text", "svg", "three", "hostile", "together", "pair"])
def test_a_report_has_scores_curve_replay_and_settings(name: str, runs: dict[str, Path]) -> None:
    page = Parts(runs[name] / "report.html")
    assert all(address.startswith("data:") for address in page.addresses)
    assert page.counts["script"] == 2 and "svg" not in page.counts
    assert page.counts["img"] == 1 + (name == "pair")
    headings = {
        True: ["Evaluations over time", "Returns at the end", "Settings and command"],
        False: ["Scores", "Learning", "Settings and command"],
    }
    for heading in headings[name in ("together", "pair")]:
        assert heading in page.texts
    assert len(page.data["items"]) == 4 and page.data["worlds"][0]["kind"] == "game"
    assert (runs[name] / "learning_curve.png").exists()
    assert (runs[name] / "replay.gif").exists() == (name not in ("together", "pair"))
    assert not (runs[name] / "replays.json").exists()


@pytest.mark.slow
def test_the_page_names_the_policies_and_values_match_the_results(runs: dict[str, Path]) -> None:
    def item_and_evaluation(name: str) -> tuple[Any, Any]:
        results = json.loads((runs[name] / "results.json").read_text())
        return Parts(runs[name] / "report.html").data["items"][0], results["evaluation"]

    item, found = item_and_evaluation("three")
    assert item["players"] == ["ppo", "uniform", "uniform"]
    # One start, so the value of the first state is the exact return of the evaluation.
    assert item["values"][0][0] == pytest.approx(found["mean_return"], abs=1e-5)
    item, found = item_and_evaluation("together")
    assert item["players"] == ["ppo", "uniform", "ppo"]
    assert item["values"][0] == pytest.approx([found[f"{n}_return"] for n in "abc"], abs=1e-5)


def test_hostile_texts_stay_texts(runs: dict[str, Path], tmp_path: Path, browser: Any) -> None:
    page = Parts(runs["hostile"] / "report.html")
    assert page.data["worlds"][0]["states"][0]["text"] == HOSTILE
    assert not {"b", "i", "svg"} & set(page.counts)
    tab = browser.new_page(reduced_motion="reduce")
    tab.goto((runs["hostile"] / "report.html").as_uri())
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("window.hacked") is None
    assert tab.inner_text(".stage pre") == f"{HOSTILE}<svg>"
    assert tab.locator(".side b, .side i, .side img").count() == 0
    assert "<b>one</b>" in tab.inner_text(".side")
    tab.close()


def test_the_browser_shows_drawings_and_numbers_and_loads_nothing(
    runs: dict[str, Path], browser: Any
) -> None:
    said: list[str] = []
    asked: list[str] = []
    tab = browser.new_page(reduced_motion="reduce")
    tab.on("console", lambda message: said.append(message.text))
    tab.on("pageerror", lambda error: said.append(str(error)))
    tab.on("request", lambda request: asked.append(request.url))
    path = runs["svg"] / "report.html"
    tab.goto(path.as_uri())
    item, world = Parts(path).data["items"][0], Parts(path).data["worlds"][0]
    tab.evaluate("window.pursuit.choose(0)")
    assert tab.locator(".stage img").count() == 2  # the optimal thief is beside the learned one
    tab.keyboard.press("c")
    for step in range(item["length"] + 1):
        found = tab.evaluate("window.pursuit.state()")
        assert (found["step"], found["state"]) == (step, item["states"][step])
        rows = [
            row.split() for row in tab.locator(".side table >> nth=0").inner_text().splitlines()
        ]
        assert rows[0] == ["reward", "return", "value", "action"]
        for player, (name, *cells) in enumerate(rows[1:]):
            assert name == ["guard", "thief"][player]
            rewards = item["rewards"][player][:step]
            numbers = [*rewards[-1:], sum(rewards), item["values"][step][player]]
            assert [float(cell) for cell in cells[: len(numbers)]] == pytest.approx(
                numbers, abs=5e-4
            )
            assert cells[len(numbers) :] == [row[player] for row in item["actions"][:step][-1:]]
        if step < item["length"]:
            bold = tab.locator(".side strong").all_inner_texts()
            assert bold == item["actions"][step]
        image = tab.locator(".stage img")
        assert image.get_attribute("alt") == world["states"][item["states"][step]]["text"]
        image.evaluate("image => image.decode()")
        assert image.evaluate("image => image.naturalWidth") > 0
        tab.keyboard.press("ArrowRight")
    assert tab.evaluate("window.hacked") is None
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    assert said == []
    tab.close()


@pytest.mark.parametrize("name", ["text", "together", "pair"])
def test_view_writes_the_report_again(name: str, runs: dict[str, Path], tmp_path: Path) -> None:
    """And no other file."""
    page = tmp_path / "page.html"
    main(["view", str(runs[name]), "--no-open", "--out", str(page)])
    assert page.read_text() == (runs[name] / "report.html").read_text()
    assert [*tmp_path.iterdir()] == [page]


def test_several_runs_are_on_one_page(runs: dict[str, Path], tmp_path: Path) -> None:
    page, folders = tmp_path / "page.html", [runs["text"], runs["three"], runs["pair"] / "guard"]
    shown = ["--no-open", "--episodes", "2", "--out", page]
    main([str(part) for part in ("view", *folders, *shown)])
    data = Parts(page).data
    names = [f"{folder.name}, episode {number}" for folder in folders for number in (1, 2)]
    assert [item["name"] for item in data["items"]] == names
    assert [item["world"] for item in data["items"]] == [0, 0, 1, 1, 2, 2]


@pytest.mark.parametrize(("command", "name"), [("train", "svg"), ("self-play", "pair")])
def test_the_report_of_a_complete_run_is_drawn_again(
    command: str,
    name: str,
    runs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The last line is a command that shows it."""
    folder = Path(shutil.copytree(runs[name], tmp_path / "it's mine" / name))
    (folder / "report.html").unlink()
    main([command, "--resume", str(folder)])
    said = capsys.readouterr().out
    files = "curve, replay and report.html" if command == "train" else "curve and report.html"
    assert f"results, {files}" in said
    look, *view = shlex.split(said.splitlines()[-1])
    assert (look, *view[:2], view[-1]) == ("look:", "pursuit", "view", str(folder))
    drawn = (folder / "report.html").read_text()
    assert drawn == (runs[name] / "report.html").read_text()
    main([*view[1:-1], "--no-open", "--out", str(tmp_path / "again.html"), view[-1]])
    assert (tmp_path / "again.html").read_text() == drawn


@pytest.mark.parametrize("how", [[], ["--optimal"]])
def test_render_draws_text(
    how: list[str], runs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number, source in enumerate(([runs["text"]], ["--game", CORRIDOR.format("text")])):
        path = tmp_path / f"{number}.gif"
        main([str(part) for part in ("render", *source, *how, "--episodes", "1", "--out", path)])
        with Image.open(path) as image:
            assert image.n_frames > 1  # type: ignore[attr-defined]
            assert {color for _, color in image.convert("RGB").getcolors()} > {(255, 255, 255)}  # type: ignore[union-attr, misc]


def test_what_cannot_be_rendered_or_played_is_refused(
    runs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", tmp_path / "a.gif"]
    learners = " or ".join(str(runs["together"] / name) for name in "ac")
    assert f"give {learners}" in error_of(capsys, "render", runs["together"], *out)
    for game in (["--game", "drawn_games:Three"], ["--task", "game"]):
        assert "small games cannot be played by hand" in error_of(capsys, "play", *game)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "form"), [("self-play", "raises"), ("train", "number"), ("train", "broken")]
)
def test_a_game_that_cannot_be_drawn_is_trained_with_a_warning(
    command: str, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    main([command, "--game", CORRIDOR.format(form), *TINY, "--out", str(out)])
    said = capsys.readouterr().err
    assert said.count("warning: draw(state) of Corridor ") == 1
    assert (out / "results.json").exists() and (out / "report.html").exists()
