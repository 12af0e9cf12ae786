"""The page of a game by hand answers its person and nobody else, whatever it is sent."""

from __future__ import annotations

import http.client
import json
import socket
from concurrent.futures import ThreadPoolExecutor

import pytest
from played_by_hand import Visitor, maze_session, serving

from train.play.server import MAX_BODY, PlayServer


def test_nothing_answers_without_the_token_or_under_another_name(
    chaser: tuple[Visitor, PlayServer],
) -> None:
    visitor, server = chaser
    path, port = visitor.path, visitor.port
    move = {"game": 0, "step": 0, "action": 0}
    wrong = "/" + "x" * 43 + "/"
    before = visitor.state()
    assert len(server.token) >= 40 and server.address.startswith("http://127.0.0.1:")
    for method, where, body in (
        *(("GET", wrong + end, None) for end in ("", "state", "move")),
        *(
            ("GET", end, None)
            for end in ("/", "//", "/favicon.ico", "/state", path[:-2] + "/", "/%C3%A9", "/%ff")
        ),
        ("POST", wrong + "move", move),
        ("POST", "/move", move),
        ("PUT", wrong + "move", move),
        ("GET", "/../" + path[1:], None),
    ):
        status, told = visitor.ask(method, where, body)
        assert status == 403, where
        assert server.token not in json.dumps(told)
    for headers in (
        {"Host": "evil.example"},
        {"Host": f"evil.example:{port}"},
        {"Host": "127.0.0.1"},
        {"Host": f"127.0.0.1:{port + 1}"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": f"http://127.0.0.1:{port + 1}"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):
        assert visitor.ask("GET", path, **headers)[0] == 403, headers
        assert visitor.ask("POST", path + "move", move, **headers)[0] == 403, headers
    own = {"Host": f"localhost:{port}", "Origin": f"http://localhost:{port}"}
    assert visitor.ask("GET", path, **own)[0] == 200
    assert visitor.state() == before
    with pytest.raises(OSError), socket.create_connection((_address_outside(), port), timeout=2):
        pass


def _address_outside() -> str:
    """Another address of this machine: all of 127.0.0.0/8 is, but nothing listens there."""
    return "127.0.0.2"


def test_the_page_may_be_shown_alone_and_may_ask_nothing_of_others(
    chaser: tuple[Visitor, PlayServer],
) -> None:
    visitor, _ = chaser
    line = http.client.HTTPConnection("127.0.0.1", visitor.port, timeout=20)
    for path in (visitor.path, "/"):
        line.request("GET", path)
        answer = line.getresponse()
        text = answer.read().decode()
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert answer.headers["Cache-Control"] == "no-store"
        assert answer.headers["Access-Control-Allow-Origin"] is None
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        if path == visitor.path:
            assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
            assert 'id="pursuit-data"' in text
    line.close()


def test_bad_and_late_requests_change_nothing_and_break_nothing(
    chaser: tuple[Visitor, PlayServer], capfd: pytest.CaptureFixture[str]
) -> None:
    visitor, server = chaser
    before, move = visitor.state(), visitor.path + "move"
    fine = {"game": 0, "step": 0, "action": 0}
    for action in (-1, 4, 2**70, 1.5, True, None, "north", [0], {}):
        status, told = visitor.ask("POST", move, {**fine, "action": action})
        assert status == 400 and "action=" in told["error"], action
    for body in (b"", b"{", b"\xff", b"[]", b"3", b"[" * 4000, {}, {"game": 0}, {**fine, "x": 1}):
        assert visitor.ask("POST", move, body)[0] == 400, body
    for late in ({"step": 1}, {"step": -1}, {"game": 1}, {"game": "0"}, {"game": None}):
        status, told = visitor.ask("POST", move, {**fine, **late})
        assert status == 409 and told["frame"] == before["frame"], late
    assert visitor.ask("POST", visitor.path + "next", {"game": 5})[0] == 409
    assert visitor.ask("POST", move, b" " * (MAX_BODY + 1))[0] == 413
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        assert visitor.ask("POST", move, fine, **{"Content-Type": kind})[0] == 415
    for length in ("-1", "x", "²", "9" * 30):
        raw = f"POST {move} HTTP/1.0\r\nHost: 127.0.0.1:{visitor.port}\r\n"
        raw += f"Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        assert b" 411 " in raw_answer(visitor, raw) or b" 413 " in raw_answer(visitor, raw)
    for raw in ("\r\n\r\n", "GET\r\n\r\n", "BREW / HTTP/1.0\r\n\r\n", "\x00" * 100 + "\r\n\r\n"):
        raw_answer(visitor, raw)
    for method, path, status in (("GET", "move", 405), ("POST", "", 405), ("GET", "x", 404)):
        assert (
            visitor.ask(method, visitor.path + path, None if method == "GET" else {})[0] == status
        )
    idle = socket.create_connection(("127.0.0.1", visitor.port), timeout=20)  # and says nothing
    assert visitor.state() == before
    idle.close()
    assert visitor.ask("POST", move, fine)[0] == 200
    assert visitor.ask("POST", move, fine)[0] == 409  # the same once more, as of a double click
    assert server.session.step == 1
    told = capfd.readouterr()
    assert "Traceback" not in told.err and server.token not in told.err + told.out


def raw_answer(visitor: Visitor, raw: str) -> bytes:
    with socket.create_connection(("127.0.0.1", visitor.port), timeout=20) as line:
        line.sendall(raw.encode())
        line.shutdown(socket.SHUT_WR)
        return line.recv(4096)


def test_of_many_that_move_at_once_one_does(chaser: tuple[Visitor, PlayServer]) -> None:
    visitor, server = chaser
    for step in range(3):
        sent = {"game": 0, "step": step, "action": 0}
        with ThreadPoolExecutor(8) as crowd:
            asked = [
                crowd.submit(visitor.ask, "POST", visitor.path + "move", sent) for _ in range(16)
            ]
        assert sorted(each.result()[0] for each in asked) == [200] + [409] * 15
        assert server.session.step == step + 1


def test_what_cannot_be_kept_is_told_and_the_game_goes_on() -> None:
    def full(session: object) -> None:
        raise OSError(28, "No space left on device")

    with serving(maze_session(maze="2x2", max_steps=1), full) as (visitor, _):
        state = visitor.move(0)
        assert state["over"] and "No space left" in state["warning"]
        assert visitor.ask("POST", visitor.path + "next", {"game": 0})[0] == 200


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=f"port={port}: .*in use; give another"):
            PlayServer(maze_session(maze="2x2"), port)
