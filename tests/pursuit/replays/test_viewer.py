"""The pages in a browser, controlled by keys and mouse, show the states of the simulator."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import networkx
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import pursuit
from pursuit import Recorder, Replay
from pursuit.rendering.rendering import ROLE_COLORS
from pursuit.replays.viewer.data import Builder, Extras, replay_page
from pursuit.replays.viewer.page import json_for_html, page
from scripted_agents import (
    AStarChaser,
    AStarEvader,
    InverseKinematics,
    RandomAgent,
    TablePolicy,
    action_values,
    best_response,
    evaluate_exactly,
    tour_length,
)
from scripted_agents.games.agents import named_agent
from scripted_agents.games.named import load_game
from scripted_agents.games.simulator import GameTask
from train.commands.main import main
from train.evaluation.recordings import add_compared
from train.evaluation.small_game_replay import add_small_game
from train.reports.pages import PLAYER_ELEMENT, page_of, write_page
from train.runs.parts import contest_of
from train.settings.task import ReacherSettings, TaskSettings

HOSTILE = """</script><script>window.hacked = 1</script><img src=x onerror="window.hacked=2">&'\""""


class Sheet:
    """An open page, with its console messages and requests."""

    def __init__(self, browser: Any, path: Path, **settings: Any) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        usual = {"viewport": {"width": 1200, "height": 900}, "reduced_motion": "reduce"}  # paused
        self.tab = browser.new_page(**{**usual, **settings})
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(path.as_uri())
        self.address = path.as_uri()

    def press(self, *keys: str) -> None:
        for key in keys:
            self.tab.keyboard.press(key)

    def state(self) -> dict[str, Any]:
        found: dict[str, Any] = self.tab.evaluate("window.pursuit.state()")
        return found

    def wait(self, until: Callable[[], bool]) -> None:
        for _ in range(200):
            if until():
                break
            self.tab.wait_for_timeout(50)
        assert until()

    def close(self) -> None:
        """No requests except the page, and no errors."""
        assert self.asked == [self.address] and self.said == []
        self.tab.close()


def random_replay(env: Any, episodes: int, title: str = "") -> Replay:
    recorder = Recorder(env)
    env.action_space.seed(0)
    for seed in range(episodes):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            over = terminated or truncated
    return replace(recorder.stop(), title=title)


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def duel() -> Replay:
    env = gymnasium.make("pursuit/Chaser-v0", maze="5x5", max_steps=16)
    return random_replay(env, 3)


@pytest.mark.slow
def test_keys_and_mouse_show_the_states_of_the_simulator(
    browser: Any, duel: Replay, tmp_path: Path
) -> None:
    sheet = Sheet(browser, written(tmp_path / "duel.html", duel.page("a duel")))
    sheet.tab.evaluate("window.pursuit.choose(0)")
    for number in range(3):
        states = duel.play(number).states
        for step, state in enumerate(states):
            shown = sheet.state()
            assert (shown["episode"], shown["step"]) == (number, step)
            assert shown["cells"] == state["cells"].tolist()
            sheet.press("ArrowRight")
        assert sheet.state()["step"] == len(states) - 1  # it stays at the end
        sheet.press("Home")
        assert sheet.state()["step"] == 0
        sheet.press("End", "ArrowLeft")
        assert sheet.state()["step"] == max(len(states) - 2, 0)
        sheet.press("ArrowDown")
    assert sheet.state()["episode"] == 0
    longest = max(range(3), key=lambda number: duel.episodes[number].length)
    sheet.tab.locator(".episodes button").nth(longest).click()
    bar = sheet.tab.locator("input[type=range]").bounding_box()
    sheet.tab.mouse.click(bar["x"] + bar["width"] / 2, bar["y"] + bar["height"] / 2)
    middle = sheet.state()["step"]
    assert abs(middle - duel.episodes[longest].length / 2) <= 1
    expected = duel.play(longest).states[middle]["cells"].tolist()
    assert sheet.state()["cells"] == expected
    sheet.tab.get_by_role("button", name="one step back (left)").click()
    assert sheet.state()["step"] == middle - 1
    sheet.press("Home", "0", " ")  # as fast as it goes
    sheet.wait(lambda: not sheet.state()["playing"])
    assert sheet.state()["step"] == duel.episodes[longest].length
    sheet.press("b")
    assert sheet.state()["several"] and sheet.tab.locator("svg.board").count() == 3
    sheet.press("b", "t", "?")
    assert not sheet.state()["shown"]["trails"] and sheet.tab.locator("dialog[open]").count() == 1
    sheet.press("Escape", "d")
    assert sheet.tab.evaluate("document.documentElement.dataset.theme") == "dark"
    sheet.close()


def compared(path: Path, epsilon: float = 0.4) -> list[dict[str, Any]]:
    """Write the page of a chaser that errs, with the optimal one beside it; the episodes."""
    contest: Any = contest_of(TaskSettings(maze="5x5", role="chaser"), 8)
    builder, games = Builder(), {f"episode {number + 1}": number for number in range(8)}
    add_compared(builder, contest, AStarChaser(epsilon), games, "A*", "index")
    write_page(path, "compared", [PLAYER_ELEMENT], builder.data(""))
    return builder.items


def test_a_page_opens_playing_at_the_episode_with_the_most_lost_steps(
    browser: Any, duel: Replay, tmp_path: Path
) -> None:
    items = compared(tmp_path / "page.html")
    lost = [item["length"] - item["beside"]["length"] for item in items]
    assert lost == [item["lost"] for item in items] and len({*lost}) > 3
    sheet = Sheet(browser, tmp_path / "page.html", reduced_motion="no-preference")
    state = sheet.state()
    assert state["playing"] and lost[state["episode"]] == max(lost)
    for name in ("trails", "values", "policy"):
        assert sheet.tab.get_by_role("button", name=name, pressed=True).count() == 1
    sheet.wait(lambda: sheet.state()["step"] > 1)
    assert sheet.tab.locator(".values rect[fill^=rgb]").count() >= 24
    sheet.close()
    sheet = Sheet(browser, tmp_path / "page.html", reduced_motion="reduce")
    assert not sheet.state()["playing"] and sheet.state()["step"] == 0
    sheet.close()
    sheet = Sheet(browser, written(tmp_path / "duel.html", duel.page()))
    lengths = [episode.length for episode in duel.episodes]  # without an optimum the longest
    assert sheet.state()["episode"] == lengths.index(max(lengths))
    assert sheet.tab.get_by_role("button", name="values", pressed=True).count() == 0  # no data
    sheet.close()


def test_the_optimal_agent_plays_beside_from_the_same_start(browser: Any, tmp_path: Path) -> None:
    items = compared(tmp_path / "page.html")
    sheet = Sheet(browser, tmp_path / "page.html")
    item = items[sheet.state()["episode"]]
    assert [path[0] for path in item["cells"]] == [path[0] for path in item["beside"]["cells"]]
    assert sheet.state()["length"] == max(item["length"], item["beside"]["length"])
    sheet.press("End")
    captions = sheet.tab.locator(".stage figcaption").all_text_contents()
    for name, each, caption in zip(
        ("A*", "optimal"), (item, item["beside"]), captions, strict=True
    ):
        assert caption.startswith(f"{name}: step {each['length']} of {each['length']} (terminated")
    assert f"Steps lost: {item['lost']} " in sheet.tab.locator(".side").inner_text()
    sheet.press("Home")
    boards = sheet.tab.locator(".stage svg").all()
    arrows = [board.locator(".arrows .learned[d^=M]").count() for board in boards]
    assert arrows[0] >= 24 and arrows[1] == 0  # that of the optimal agent has optimal moves only
    left, right = (board.bounding_box() for board in boards)
    assert left["y"] == right["y"] and left["x"] + left["width"] <= right["x"]
    sheet.press("c")
    assert sheet.tab.locator(".stage svg").count() == 1
    sheet.press("b")
    assert sheet.tab.locator(".stage svg").count() == 8
    sheet.close()


def test_a_map_of_the_steps_lost_by_start(browser: Any, tmp_path: Path) -> None:
    compared(tmp_path / "page.html")
    sheet = Sheet(browser, tmp_path / "page.html")
    maze, chaser = pursuit.load_maze("5x5"), AStarChaser(0.4)
    tables = [each.action_probabilities(maze) for each in (chaser, AStarEvader(0.2))]
    achieved = evaluate_exactly(maze, *tables).values
    lost = achieved - best_response("chaser", maze, tables[1]).values
    mean = lost.sum(axis=1) / (maze.num_cells - 1)  # 0 where both start in one cell
    shown = sheet.tab.locator(".map .labels text").all_text_contents()
    assert [float(text) for text in shown] == pytest.approx(mean.tolist(), abs=0.51)
    colors = sheet.tab.locator(".map .values rect").all()
    assert len({each.get_attribute("fill") for each in colors}) > 10
    assert f"0{mean.max():.2f}" in sheet.tab.locator(".map figcaption").text_content()
    sheet.close()


def runners(path: Path, task: TaskSettings | ReacherSettings, policy: Any) -> list[dict[str, Any]]:
    """As `compared`, of a task with one agent."""
    contest: Any = contest_of(task, 8)
    builder, games = Builder(), {f"episode {number + 1}": number for number in range(8)}
    add_compared(builder, contest, policy, games, "mine")
    write_page(path, "alone", [PLAYER_ELEMENT], builder.data(""))
    return builder.items


def test_the_optimal_tour_is_drawn_beside_the_path_of_a_runner(
    browser: Any, tmp_path: Path
) -> None:
    given = TaskSettings(task="maze", maze="5x5", num_goals=3)
    items = runners(tmp_path / "tour.html", given, RandomAgent())
    sheet = Sheet(browser, tmp_path / "tour.html")
    item, maze = items[sheet.state()["episode"]], pursuit.load_maze("5x5")
    start, goals = item["cells"][0][0], [cell for cell, _ in item["goals"]]
    tour = item["beside"]["cells"][0]
    assert len(tour) - 1 == item["beside"]["length"] == tour_length(maze, start, goals)
    drawn = sheet.tab.locator(".trail.tour").first
    points = [tuple(map(float, pair.split(","))) for pair in drawn.get_attribute("points").split()]
    assert points == [(10 * maze.columns[cell] + 5, 10 * maze.rows[cell] + 5) for cell in tour]
    assert drawn.evaluate("line => getComputedStyle(line).strokeDasharray") != "none"
    text = sheet.tab.locator(".legend").inner_text()
    assert f"optimal agent, {len(tour) - 1} steps; that of mine has {item['length']}" in text
    sheet.press("t")
    assert drawn.get_attribute("points") == ""
    sheet.close()
    arm = runners(tmp_path / "arm.html", ReacherSettings(joints=2), InverseKinematics())
    sheet = Sheet(browser, tmp_path / "arm.html")
    shown = arm[sheet.state()["episode"]]["beside"]["angles"]
    points = sheet.tab.locator(".trail.tour").first.get_attribute("points").split()
    assert len(points) == len(shown) and sheet.tab.locator(".stage svg").count() == 2
    sheet.close()


def test_grey_buttons_say_why_and_signs_what_they_mean(browser: Any, tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/Reacher-v0", joints=2, max_steps=5)
    path = written(tmp_path / "arm.html", random_replay(env, 1).page())
    sheet = Sheet(browser, path, viewport={"width": 390, "height": 800}, has_touch=True)
    for name in ("values", "policy", "observed", "beside optimal"):
        button = sheet.tab.get_by_role("button", name=name)
        assert button.is_disabled()
        why = button.get_attribute("title")
        said = "values, policy" if name == "values" else name
        assert f"{said} ({why})" in sheet.tab.locator(".why").inner_text()
    assert sheet.tab.locator(".sign").all_inner_texts() == ["tip", "target"]
    sheet.close()
    compared(tmp_path / "page.html")
    sheet = Sheet(browser, tmp_path / "page.html")
    assert sheet.tab.locator(".why").is_hidden()  # all are known here
    signs = [text.strip() for text in sheet.tab.locator(".sign").all_inner_texts()]
    assert signs[:2] == ["chaser", "evader"]
    assert signs[2:6] == ["played move, the most probable", "optimal moves", "waits", "not optimal"]
    assert signs[6].endswith("steps until capture")
    sheet.press("p", "v")
    assert len(sheet.tab.locator(".sign").all()) == 2
    sheet.close()


def test_arrows_stay_beside_the_numbers_and_waiting_is_a_dot(browser: Any, tmp_path: Path) -> None:
    contest: Any = contest_of(TaskSettings(maze="5x5", role="chaser", stay_action=True), 4)
    builder, waiting = Builder(), np.zeros((25, 25, 5))
    waiting[..., 4] = 1.0
    policy = TablePolicy(contest.task.mazes[0], waiting)
    add_compared(builder, contest, policy, {"one": 0}, "waiting")
    write_page(tmp_path / "page.html", "waits", [PLAYER_ELEMENT], builder.data(""))
    sheet = Sheet(browser, tmp_path / "page.html")
    dots = sheet.tab.locator(".stage .learned[d*=a]")  # arcs of a circle
    assert dots.count() == 24
    boxes: Any = sheet.tab.evaluate(
        "['.labels text', '.arrows .optimal'].map(name => [...document.querySelector('.stage')"
        ".querySelectorAll(name)].map(e => [e.getBBox(), e.textContent || e.getAttribute('d')])"
        ".map(([b, full]) => full ? [b.x, b.y, b.x + b.width, b.y + b.height] : null))"
    )
    for number, arrow in zip(*boxes, strict=True):
        if number and arrow:  # numbers have free room above and below their digits
            assert arrow[1] >= number[3] - 0.8 or arrow[0] >= number[2]
    sheet.close()


def test_a_shadow_says_that_a_table_scrolls(browser: Any, tmp_path: Path) -> None:
    row = "| " + " | ".join(["a rather long heading"] * 8) + " |\n"
    write_page(tmp_path / "page.html", "wide", [row + "|---" * 8 + "|\n" + row])
    tab = browser.new_page(viewport={"width": 390, "height": 800})
    tab.goto((tmp_path / "page.html").as_uri())
    table = tab.locator(".wide")
    assert table.evaluate("wide => wide.scrollWidth > wide.clientWidth")
    style = table.evaluate("wide => getComputedStyle(wide).backgroundAttachment")
    assert style == "local, local, scroll, scroll"
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    tab.close()


def small_game(path: Path, name: str, max_steps: int = 12) -> Any:
    """Write the page of an episode of a shipped game, by uniform players; its world."""
    builder, task = Builder(), GameTask(load_game(name), name, max_steps)
    uniform = {player: named_agent("uniform", task, player) for player in task.game.players}
    labels = dict.fromkeys(task.game.players, "uniform")
    add_small_game(builder, task, uniform, {"one": 0, "two": 1}, 0.95, labels)
    write_page(path, name, [PLAYER_ELEMENT], builder.data(""))
    return builder.worlds[0]


@pytest.mark.parametrize("name", ["soccer", "border_control", "maze_game"])
def test_grids_of_small_games_are_drawn(name: str, browser: Any, tmp_path: Path) -> None:
    world = small_game(tmp_path / "page.html", name)
    sheet = Sheet(browser, tmp_path / "page.html")
    lines = world["states"][sheet.state()["state"]]["drawing"].splitlines()
    rows = lines[1 : max(n for n, line in enumerate(lines) if line[:1] == "+")]
    marks: Any = [line.strip("| ").split() for line in rows]
    if name == "maze_game":  # between walls
        marks = [line[1::2] for line in rows[::2]]
    expected = {
        (row, column): mark
        for row, line in enumerate(marks)
        for column, mark in enumerate(line)
        if mark[0].isalnum()
    }
    drawn = sheet.tab.locator(".stage svg .agents > g").all()
    assert 2 <= len(drawn) == len(expected)
    for token in drawn:
        x, y = map(float, token.get_attribute("transform")[10:-1].split())
        mark = expected[(int(y // 10), int(x // 10))]
        assert token.text_content() == mark[0]
        assert token.locator(".ball").count() == (mark[1:] == "*")
        player = any(each["name"][0].upper() == mark[0] for each in world["agents"])
        assert ("token" in token.get_attribute("class")) == player
    assert sheet.tab.locator(".stage pre").is_hidden()
    assert sheet.tab.locator(".episodes button").all_text_contents() == ["one", "two"]
    sheet.tab.locator(".episodes button").nth(1).click()
    assert sheet.state()["episode"] == 1
    sheet.close()


def test_bids_are_cards_and_probabilities_bars(browser: Any, tmp_path: Path) -> None:
    world = small_game(tmp_path / "page.html", "goofspiel")
    sheet = Sheet(browser, tmp_path / "page.html")
    state = world["states"][sheet.state()["state"]]
    cards = sheet.tab.locator(".card").all_text_contents()
    assert cards == re.findall(r"\b\d+\b", state["drawing"]) and len(cards) > 6
    bars = sheet.tab.locator(".side table").nth(1).locator(".bar").all()
    widths = [bar.evaluate("bar => bar.getBoundingClientRect().width") for bar in bars]
    shares = np.stack([state["choices"][0][which] for which in ("played", "best")], axis=1)
    assert widths == pytest.approx((25.6 * shares).ravel().tolist(), abs=0.6)
    board = "new GameBoard(document.createElement('div'), {agents: []})"
    parse = f"text => {board}.pictureOf(text.split('\\n')) !== null"
    for text, is_drawn in (
        ("+-----+\n| . A |\n| . . |\n+-----+", True),
        ("+---+\n|   |\n+---+", False),  # not a grid of marks
        ("+-----+\n| A B |\n|   C |\n+-----+", False),
        ("+---+", False),
        ("<G...T>\n1 2", False),
        ("field #.A.#", True),
        ("only words", False),
    ):
        assert sheet.tab.evaluate(parse, text) == is_drawn, text
    sheet.close()


def near(picture: NDArray[Any], color: tuple[int, int, int]) -> NDArray[Any]:
    distance: NDArray[Any] = np.abs(picture.astype(int) - np.array(color)).sum(axis=2)
    return distance < 40


def test_the_board_matches_the_rendered_image(browser: Any, tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/Chaser-v0", maze="7x7", max_steps=30)
    replay = random_replay(env, 1)
    sheet = Sheet(browser, written(tmp_path / "board.html", replay.page()))
    sheet.press("t")
    states, maze = replay.play(0).states, replay.task.mazes[0]
    for step in (0, 3, 7):
        sheet.tab.evaluate(f"window.pursuit.go({step})")
        content = sheet.tab.locator("svg.board").screenshot()
        picture = np.array(Image.open(io.BytesIO(content)).convert("RGB"))
        side = min(picture.shape[:2]) / (10 * maze.width + 2)  # pixels of a unit
        left = (picture.shape[1] - side * (10 * maze.width + 2)) / 2
        for role, cell in zip(("chaser", "evader"), states[step]["cells"], strict=True):
            rows, columns = np.nonzero(near(picture, ROLE_COLORS[role]))
            assert len(rows) > 50
            row = (rows.mean() / side - 1) // 10
            column = ((columns.mean() - left) / side - 1) // 10
            assert (row, column) == (maze.rows[cell], maze.columns[cell])
    sheet.close()


def test_exits_are_drawn_in_their_cells(browser: Any, tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/EscapeChaser-v0", maze="4x4", exits=[3, 9], max_steps=20)
    sheet = Sheet(browser, written(tmp_path / "exits.html", random_replay(env, 1).page()))
    drawn = sheet.tab.locator("svg.board .exits rect").all()
    corners = [(int(each.get_attribute("x")), int(each.get_attribute("y"))) for each in drawn]
    assert corners == [(30, 0), (10, 20)]  # ten units a cell: row 0, column 3; row 2, column 1
    sheet.close()


def test_values_and_moves_are_the_exact_ones(browser: Any, tmp_path: Path) -> None:
    contest: Any = contest_of(TaskSettings(maze="5x5", role="chaser"), 2)
    maze, policy = contest.task.mazes[0], AStarChaser(0.0)
    simulator, play = contest.game(policy, 0)
    recorder = Recorder(simulator)
    for _ in play:
        pass
    builder = Builder()
    sides = contest.overlays(policy)
    builder.add(recorder.stop(), Extras(overlays=sides, seat="chaser_0", encoding="index"))
    path = tmp_path / "sides.html"
    write_page(path, "sides", [PLAYER_ELEMENT], builder.data(""))
    sheet = Sheet(browser, path)
    sheet.press("o", "ArrowRight")
    evader = AStarEvader(0.2).action_probabilities(maze)
    chaser = policy.action_probabilities(maze)
    found = {
        "chaser_0": (action_values("chaser", maze, evader), chaser),
        "evader_0": (action_values("evader", maze, chaser), evader),
    }
    assert [side.name for side in sides] == list(found)
    for number, (exact, table) in enumerate(found.values()):
        sheet.tab.evaluate(f"window.pursuit.side = {number}; window.pursuit.show()")
        other = sheet.state()["cells"][1 - number]
        texts = sheet.tab.locator(".labels text").all_text_contents()
        own = sheet.state()["cells"][number]  # the bars of its next move
        rows = sheet.tab.locator(".side table").nth(1).locator("tr").all_inner_texts()[1:]
        bars = np.array([re.findall(r"[\d.]+", row) for row in rows], dtype=float) / 100.0
        assert bars[:, 0] == pytest.approx(table[own, other], abs=0.003)
        best = exact.optimal[own, other]
        assert bars[:, 1] == pytest.approx(best / best.sum(), abs=6e-4)
        arrows = sheet.tab.evaluate(f"window.pursuit.sides()[{number}].arrowsAt({other})")
        for cell in range(maze.num_cells):
            if cell == other:
                assert texts[cell] == ""
                continue
            assert float(texts[cell]) == pytest.approx(exact.values[cell, other], abs=0.51)
            bits = [bool(arrows["optimal"][cell] >> action & 1) for action in range(4)]
            assert bits == exact.optimal[cell, other].tolist()
            learned = arrows["learned"][cell]
            assert learned == pytest.approx(table[cell, other], abs=0.003)
    numbers = sheet.tab.locator(".numbers").text_content()
    assert numbers.startswith("index: ")
    sheet.close()


def test_goals_and_scores_of_a_heist(browser: Any, tmp_path: Path) -> None:
    task = pursuit.make_task("heist", maze="4x4", num_evaders=2, max_steps=60)
    simulator = pursuit.Simulator(task, auto_restart=False)
    recorder, rng = Recorder(simulator), np.random.default_rng(3)
    while not simulator.ended[0]:
        simulator.step(rng.integers(4, size=(1, 3)))
    replay = recorder.stop()
    sheet = Sheet(browser, written(tmp_path / "heist.html", replay.page()))
    returns = replay.episodes[0].rewards.sum(axis=0)
    for step, state in enumerate(replay.play(0).states):
        sheet.tab.evaluate(f"window.pursuit.go({step})")
        shown = sheet.state()
        assert shown["cells"] == state["cells"].tolist()
        assert shown["goals"] == state["goals"].tolist()
    rows = sheet.tab.locator(".side table tr").all()[1:]
    sums = [float(row.locator("td").nth(2).text_content()) for row in rows]
    assert sums == pytest.approx(returns.tolist(), abs=2e-3)
    sheet.close()


def test_an_arm_moves_on_a_phone_in_the_dark(browser: Any, tmp_path: Path) -> None:
    env = gymnasium.make("pursuit/Reacher-v0", joints=3, max_steps=12)
    replay = random_replay(env, 2)
    path = written(tmp_path / "arm.html", replay.page("arm"))
    phone = {"width": 360, "height": 740}
    sheet = Sheet(browser, path, viewport=phone, has_touch=True, color_scheme="dark")
    sheet.tab.evaluate("window.pursuit.choose(0)")
    for step, state in enumerate(replay.play(0).states):
        assert sheet.state()["angles"] == pytest.approx(state["angles"].tolist(), abs=1e-4)
        assert sheet.state()["step"] == step
        sheet.tab.get_by_role("button", name="one step forward (right)").tap()
    wide = sheet.tab.evaluate("document.documentElement.scrollWidth")
    assert wide <= phone["width"]  # nothing to scroll sideways
    assert (
        sheet.tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(13, 17, 23)"
    )
    sheet.close()


def test_untrusted_texts_are_not_executed(browser: Any, duel: Replay, tmp_path: Path) -> None:
    labelled = tuple(replace(episode, label=HOSTILE) for episode in duel.episodes)
    hostile = replace(
        duel, title=HOSTILE, episodes=labelled, players={"chaser_0": HOSTILE}, versions={}
    )
    sheet = Sheet(browser, written(tmp_path / "one.html", replay_page({HOSTILE: hostile}, HOSTILE)))
    sheet.press("ArrowDown", "b")
    assert sheet.tab.evaluate("window.hacked") is None
    assert sheet.tab.title() == HOSTILE
    sheet.close()
    # What is put in unescaped is stopped by the page's own policy.
    bare = page("bare", None, (), f"<main>{HOSTILE}</main>")
    tab = browser.new_page()
    tab.goto(written(tmp_path / "bare.html", bare).as_uri())
    assert tab.evaluate("window.hacked") is None
    tab.close()
    assert "</script" not in json_for_html({"a": HOSTILE})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run with HTML in the names of its folder and maze."""
    folder = tmp_path_factory.mktemp("runs")
    maze = folder / "<img src=x onerror=hacked()>.txt"
    maze.write_text(pursuit.load_maze("4x4").to_text())
    name = folder / "<b>run&'"
    sizes = "--width 16 --num-games 64 --minibatch-size 256 --frames 4096 --episodes 200"
    main(["train", "--maze", str(maze), *sizes.split(), "--threads", "1", "--out", str(name)])
    return name


@pytest.mark.slow
def test_the_report_of_a_run(browser: Any, run: Path) -> None:
    report = run / "report.html"
    assert report.stat().st_size < 2_000_000
    replay = Replay.load(run / "replays.json")
    assert replay.check() == []
    sheet = Sheet(browser, report)
    labels = sheet.tab.locator(".episodes button").all_text_contents()
    assert labels[:3] == ["episode 1", "episode 2", "episode 3"]
    assert labels == [episode.label for episode in replay.episodes]
    text = sheet.tab.locator("body").inner_text()
    for expected in ("<b>run&'", "Learned:", "optimal"):
        assert expected in text
    assert sheet.tab.locator("b").count() == 0 and sheet.tab.locator("figure img").count() == 1
    sheet.press("p", "v", "End")
    sheet.close()


def test_view_writes_pages_of_runs_and_replays(
    browser: Any, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "report.html").unlink()
    main(["view", str(run), "--no-open"])
    assert (run / "report.html").is_file()
    out = tmp_path / "both.html"
    games = [str(run), str(run / "replays.json")]
    main(["view", *games, "--episodes", "2", "--out", str(out), "--no-open"])
    sheet = Sheet(browser, out)
    labels = sheet.tab.locator(".episodes button").all_text_contents()
    assert len(labels) == 2 + len(Replay.load(run / "replays.json").episodes)
    sheet.close()
    capsys.readouterr()
    for wrong, message in (
        ([], "nothing to view"),
        ([str(tmp_path / "none.json")], "no such file or folder"),
        ([str(out)], "not a valid replay"),
    ):
        with pytest.raises(SystemExit):
            main(["view", *wrong, "--no-open", "--out", str(tmp_path / "x.html")])
        assert message in capsys.readouterr().err


def test_a_notebook_shows_the_page(browser: Any, duel: Replay, tmp_path: Path) -> None:
    outer = f"<!DOCTYPE html><body>{duel._repr_html_()}</body>"
    tab = browser.new_page(reduced_motion="reduce")
    tab.goto(written(tmp_path / "cell.html", outer).as_uri())
    inner = tab.frame_locator("iframe")
    inner.locator("svg.board").first.wait_for()
    assert inner.locator("output").text_content().startswith("step 0 of")
    tab.close()


def test_the_report_of_a_sweep_is_one_page(browser: Any, tmp_path: Path) -> None:
    picture = tmp_path / "arms.png"
    Image.new("RGB", (4, 3), "red").save(picture)
    text = f"# {HOSTILE}\n\n| arm | gap |\n|---|---|\n| {HOSTILE} | 1 |\n\n![arms](arms.png)\n"
    written(tmp_path / "report.md", text + "\n![out](../secret.png)\n")
    page = page_of(tmp_path / "report.md")
    picture.unlink()
    tab = browser.new_page()
    tab.goto(page.as_uri())
    assert tab.evaluate("window.hacked") is None and tab.locator("td").count() == 2
    assert tab.locator("td").first.text_content() == HOSTILE
    widths = tab.evaluate("[...document.images].map((image) => image.naturalWidth)")
    assert widths == [4]  # the figure is inside, and nothing from elsewhere
    tab.close()


@pytest.mark.parametrize("places", ["springs", "one"])
def test_values_of_a_graph_do_not_overlap(browser: Any, tmp_path: Path, places: str) -> None:
    graph = networkx.connected_watts_strogatz_graph(60, 4, 0.2, seed=1)
    positions = {node: (node // 30, node % 30) for node in graph} if places == "one" else None
    written(path := tmp_path / "graph.txt", pursuit.Maze.from_graph(graph, positions).to_text())
    contest: Any = contest_of(TaskSettings(maze=str(path), role="chaser"), 2)
    simulator, play = contest.game(policy := AStarChaser(0.0), 0)
    recorder = Recorder(simulator)
    for _ in play:
        pass
    builder = Builder()
    builder.add(recorder.stop(), Extras(overlays=contest.overlays(policy)))
    write_page(tmp_path / "graph.html", "graph", [PLAYER_ELEMENT], builder.data(""))
    sheet = Sheet(browser, tmp_path / "graph.html")
    circles = sheet.tab.evaluate(
        "[...document.querySelectorAll('.values circle')]"
        ".map(c => ['cx', 'cy', 'r'].map(name => Number(c.getAttribute(name))))"
    )
    assert len(circles) == 60
    x, y, r = np.array(circles).T
    away = np.hypot(x[:, None] - x, y[:, None] - y)
    np.fill_diagonal(away, np.inf)
    assert (away >= r[:, None] + r).all() and np.median(r) > 2.0
    boxes = sheet.tab.evaluate(
        "[...document.querySelectorAll('.labels text')].filter(t => t.textContent)"
        ".map(t => t.getBBox()).map(b => [b.x, b.y, b.x + b.width, b.y + b.height])"
    )
    left, top, right, bottom = np.array(boxes).T
    overlap = (left[:, None] < right) & (left < right[:, None])
    overlap &= (top[:, None] < bottom) & (top < bottom[:, None])
    assert len(boxes) == 59 and overlap.sum() == 59  # each with itself
    sheet.close()
