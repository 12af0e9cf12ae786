"""A page of a game by hand, served to a test that takes the part of the browser."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

from train.play.server import PlayServer
from train.play.session import Session
from train.play.setup import session_of
from train.settings.task import TaskSettings

NORTH, SOUTH, EAST, WEST, STAY = range(5)


def maze_session(seed: int = 0, beside: str = "astar", **settings: Any) -> Session:
    return session_of(TaskSettings(**settings), beside, seed)


class Visitor:
    """A browser that a test drives."""

    def __init__(self, address: str) -> None:
        port, token = address.removeprefix("http://127.0.0.1:").rstrip("/").split("/")
        self.port, self.path = int(port), f"/{token}/"

    def ask(self, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
        line = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        sent = {"Host": f"127.0.0.1:{self.port}", **headers}
        data = body if isinstance(body, bytes | None) else json.dumps(body).encode()
        if data is not None:
            sent.setdefault("Content-Type", "application/json")
        line.request(method, path, data, sent)
        answer = line.getresponse()
        text = answer.read().decode()
        line.close()
        is_json = answer.headers["Content-Type"].startswith("application/json")
        return answer.status, json.loads(text) if is_json else text

    def state(self) -> Any:
        return self.ask("GET", self.path + "state")[1]

    def move(self, action: Any) -> Any:
        now = self.state()
        sent = {"game": now["game"], "step": now["step"], "action": action}
        return self.ask("POST", self.path + "move", sent)[1]


@contextmanager
def serving(session: Any, after: Any = None) -> Iterator[tuple[Visitor, PlayServer]]:
    with closing(PlayServer(session, after=after)) as server:
        thread = threading.Thread(target=server.serve)
        thread.start()
        try:
            yield Visitor(server.address), server
        finally:
            server.stop()
            thread.join(20)
            assert not thread.is_alive()
