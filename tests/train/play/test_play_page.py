"""The page of a game by hand in a real browser: keys, buttons and touches become moves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from played_by_hand import EAST, NORTH, SOUTH, STAY, WEST, maze_session, serving

from train.play.server import PlayServer


class Page:
    """The page in a browser, and all that it said and asked for."""

    def __init__(self, browser: Any, server: PlayServer, **settings: Any) -> None:
        self.said: list[str] = []
        self.asked: list[str] = []
        self.session: Any = server.session
        self.tab = browser.new_page(**settings)
        self.tab.on("console", lambda message: self.said.append(message.text))
        self.tab.on("pageerror", lambda error: self.said.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(server.address)
        self.address = server.address

    def after(self, act: Callable[[], Any]) -> None:
        """Do it, and wait until the page shows the next step, or the next game."""
        line = self.tab.locator("[role=status]")
        before = line.inner_text()
        act()
        self.tab.wait_for_function(
            "before => document.querySelector('[role=status]').innerText !== before", arg=before
        )

    def press(self, *keys: str) -> None:
        for key in keys:
            self.after(partial(self.tab.keyboard.press, key))

    @property
    def moves(self) -> list[int]:
        """What the server was told to do in the person's seat."""
        return [moves[self.session.seat] for moves in self.session.actions]

    def close(self) -> None:
        """Nobody else was asked for anything, and nothing went wrong."""
        assert self.said == [] and all(url.startswith(self.address) for url in self.asked)
        self.tab.close()


@pytest.fixture
def evader(browser: Any) -> Iterator[Page]:
    session = maze_session(
        1, maze="9x9", role="evader", stay_action=True, opponent_epsilon=1.0, max_steps=30
    )
    with serving(session) as (_, server):
        page = Page(browser, server)
        yield page
        page.close()


def test_keys_move_and_the_end_shows_the_optimum(evader: Page) -> None:
    evader.press("ArrowUp", "ArrowDown", "ArrowRight", "ArrowLeft", "w", "S", "d", "a", "Space")
    assert evader.moves == [NORTH, SOUTH, EAST, WEST, NORTH, SOUTH, EAST, WEST, STAY]
    evader.tab.keyboard.press("x")  # means nothing
    evader.tab.keyboard.press("Control+w")  # is the browser's
    while not evader.session.over:
        evader.press("Space")
    outcome = evader.session.outcomes[0]
    table = evader.tab.locator("table").inner_text()
    assert f"you\t{outcome.steps} steps" in table and f"optimum\t{outcome.optimum}" in table
    evader.press("n")
    assert evader.session.game == 1 and evader.session.step == 0
    assert evader.tab.locator("table").count() == 0


def test_the_board_shows_what_the_simulator_has(evader: Page) -> None:
    for key in ("ArrowUp", "ArrowLeft", "ArrowDown"):
        evader.press(key)
        maze = evader.session.task.mazes[0]
        told = evader.tab.locator("svg.board").get_attribute("aria-label")
        for name, cell in zip(
            evader.session.task.agent_names, evader.session.frame()["cells"], strict=True
        ):
            assert f"{name} row {maze.rows[cell]} column {maze.columns[cell]}" in told
            place = f"translate({10 * maze.columns[cell] + 5:.2f} {10 * maze.rows[cell] + 5:.2f})"
            role = name.split("_")[0]
            assert evader.tab.locator(f".token.{role}").get_attribute("transform") == place
    own = evader.tab.locator(".token.own").get_attribute("class").split()
    assert "evader" in own  # whoever plays sees who they are
    evader.tab.reload()
    assert "game 1, step 3 / 30" in evader.tab.locator("[role=status]").inner_text()


def test_buttons_move_by_mouse_touch_and_keyboard(browser: Any) -> None:
    session = maze_session(2, task="heist", maze="5x5", role="evader")
    with serving(session) as (_, server):
        phone = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}
        page = Page(browser, server, **phone)
        assert page.tab.get_by_label("stay").count() == 0  # there is no such action here
        page.after(lambda: page.tab.get_by_label("west").tap())
        page.after(lambda: page.tab.get_by_label("south", exact=True).click())
        page.tab.get_by_label("east", exact=True).focus()
        page.press("Enter", "Space")
        assert page.moves == [WEST, SOUTH, EAST, EAST]
        wide = page.tab.evaluate("document.documentElement.scrollWidth")
        assert wide <= 360
        page.after(lambda: page.tab.get_by_text("next game (n)").tap())
        assert session.game == 1
        page.close()


def test_a_page_whose_server_has_ended_says_so(browser: Any) -> None:
    with serving(maze_session(maze="3x3")) as (_, server):
        page = Page(browser, server)
        server.stop()
        server.close()
        page.tab.keyboard.press("w")
        page.tab.get_by_text("does not answer").wait_for()
        page.tab.close()
