"""The HTTP server of `pursuit play`: one session and one page on the loopback address.

The address contains a random token. Requests without it are refused, as are requests with another
host name (DNS rebinding) and from pages of another origin. Requests can only make a move or start
a game.
"""

from __future__ import annotations

import json
import secrets
import socketserver
import sys
from collections.abc import Callable
from dataclasses import asdict
from threading import Lock
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import bottle

from pursuit.replays.viewer.page import page
from train.files import Plain
from train.play.outcome import total_line
from train.play.session import Session

HOST = "127.0.0.1"
MAX_BODY = 4096
"""Maximum bytes of a request; a move takes about fifty."""
PATIENCE = 10.0
"""Timeout of idle connections in seconds; browsers open connections that they never use."""
SCRIPTS = ("board.js", "maze_board.js", "arm_board.js", "game_board.js", "play.js")
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",  # the address contains the token
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
}


class PlayServer:
    """Serves one session from construction until it is closed.

    Args:
        session: the session; not to be used by other code meanwhile.
        port: 0 for any free port.
        after: called with the session when a game is over; if it raises ValueError or OSError,
            the message is shown to the user as a warning.

    Attributes:
        token: required in every request.
        address: of the page, with the token.

    Raises:
        ValueError: the port is taken, or not allowed.
    """

    def __init__(
        self, session: Session, port: int = 0, after: Callable[[Session], None] | None = None
    ) -> None:
        self.session, self.after = session, after
        self.token = secrets.token_urlsafe(32)
        self.warning = ""
        self._lock = Lock()
        try:
            self._server = make_server(HOST, port, self._app(), _Threads, _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise ValueError(f"port={port}: {reason}; give another, or 0 for any") from None
        own = self._server.server_port
        self._hosts = {f"{name}:{own}" for name in (HOST, "localhost")}
        self.address = f"http://{HOST}:{own}/{self.token}/"

    def serve(self) -> None:
        """Answer requests until another thread calls `stop`, or a signal ends it."""
        self._server.serve_forever(poll_interval=0.2)

    def stop(self) -> None:
        """End `serve`, which runs in another thread."""
        self._server.shutdown()

    def close(self) -> None:
        """Close the port."""
        self._server.server_close()

    # -- requests ----------------------------------------------------------------------------------

    def _app(self) -> bottle.Bottle:
        app = bottle.Bottle()
        app.add_hook("before_request", self._admit)
        app.add_hook("after_request", _guard)
        app.route("/<token>/", "GET", self._show)
        app.route("/<token>/state", "GET", self._state)
        app.route("/<token>/move", "POST", self._move)
        app.route("/<token>/next", "POST", self._next)
        app.default_error_handler = _error_text
        return app

    def _admit(self) -> None:
        """Refuse requests without the token, with another host name or from another origin."""
        request = bottle.request
        given = request.environ.get("PATH_INFO", "/").split("/", 2)[1:2]
        token = given[0].encode("utf-8", "replace") if given else b""
        host, origin = request.get_header("Host", ""), request.get_header("Origin")
        site = request.get_header("Sec-Fetch-Site", "none")
        if (
            not secrets.compare_digest(token, self.token.encode())
            or host not in self._hosts
            or (origin is not None and origin != f"http://{host}")
            or site not in ("none", "same-origin")
        ):
            raise _answer(403, {"error": "refused; open the address printed by pursuit play"})

    def _show(self, token: str) -> bottle.HTTPResponse:
        with self._lock:
            text = page("pursuit: play", self.state(True), SCRIPTS, connects=True)
        return bottle.HTTPResponse(text, 200, {"Content-Type": "text/html; charset=utf-8"})

    def _state(self, token: str) -> bottle.HTTPResponse:
        with self._lock:
            return _answer(200, self.state(True))

    def _move(self, token: str) -> bottle.HTTPResponse:
        given = _body(("game", "step", "action"))
        with self._lock:
            session = self.session
            if (given["game"], given["step"]) != (session.game, session.step) or session.over:
                return _answer(409, self.state(True))
            try:
                session.move(given["action"])
            except ValueError as error:
                return _answer(400, {"error": str(error)})
            if session.over:
                self._finish_game()
            return _answer(200, self.state(False))

    def _next(self, token: str) -> bottle.HTTPResponse:
        given = _body(("game",))
        with self._lock:
            if given["game"] != self.session.game:
                return _answer(409, self.state(True))
            self.session.next_game()
            return _answer(200, self.state(True))

    def _finish_game(self) -> None:
        if self.after is None:
            return
        try:
            self.after(self.session)
            self.warning = ""
        except (ValueError, OSError) as error:
            self.warning = str(error)

    def state(self, whole: bool) -> Plain:
        """`state_of` the session."""
        return state_of(self.session, whole, self.warning)


def state_of(session: Session, whole: bool, warning: str = "") -> Plain:
    """The state of a session for the page; with title and board if `whole`."""
    outcome = session.outcome
    state: Plain = {
        "game": session.game,
        "step": session.step,
        "frame": session.frame(),
        "over": session.over,
        "outcome": None if outcome is None else asdict(outcome),
        "rows": [] if outcome is None else outcome.rows(),
        "total": total_line(session.outcomes),
        "warning": warning,
    }
    if whole:
        state |= {"title": session.title(), "board": session.board()}
    return state


def _answer(status: int, content: Plain) -> bottle.HTTPResponse:
    headers = {"Content-Type": "application/json"}
    return bottle.HTTPResponse(json.dumps(content), status, headers)


def _body(names: tuple[str, ...]) -> Plain:
    """The JSON object in a request, which has exactly these names.

    Raises:
        bottle.HTTPResponse: of status 400, 411, 413 or 415, with the reason.
    """
    request = bottle.request
    kind = request.get_header("Content-Type", "").partition(";")[0].strip().lower()
    if kind != "application/json":  # forms of other pages cannot send this type
        raise _answer(415, {"error": "send the request with Content-Type application/json"})
    length = request.get_header("Content-Length", "")
    if not (length.isascii() and length.isdecimal()):
        raise _answer(411, {"error": "send the request with its Content-Length"})
    if len(length) > 9 or int(length) > MAX_BODY:
        raise _answer(413, {"error": f"send a request of at most {MAX_BODY} bytes"})
    try:
        content = json.loads(request.environ["wsgi.input"].read(int(length)))
    except (ValueError, OSError, RecursionError):
        raise _answer(400, {"error": "the request is not valid JSON"}) from None
    if not isinstance(content, dict) or set(content) != set(names):
        raise _answer(400, {"error": f"send an object with the names {', '.join(names)}"})
    return content


def _guard() -> None:
    """Set the headers of every response."""
    for name, value in HEADERS.items():
        bottle.response.set_header(name, value)


def _error_text(error: bottle.HTTPError) -> str:
    """The body of responses to unknown addresses and to errors of the server."""
    bottle.response.content_type = "application/json"
    return json.dumps({"error": error.status_line})


class _Handler(WSGIRequestHandler):
    timeout = PATIENCE

    def log_message(self, format: str, *args: Any) -> None:
        """Log no requests: the terminal shows the results of the games."""


class _Threads(socketserver.ThreadingMixIn, WSGIServer):
    """A server with a thread for each connection: browsers keep idle connections open."""

    daemon_threads = True
    request_queue_size = 64  # by default 5: browsers with several connections would wait

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log no aborted connections."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)
