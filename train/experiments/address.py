"""The address of a Ray cluster: whether anybody answers there, before Ray waits for it."""

from __future__ import annotations

import socket

from train.settings.checks import check

SECONDS = 5.0
"""How long an answer is waited for."""


def check_answers(address: str | None) -> None:
    """Refuse an address where nobody answers; None, "auto" and "local" are for Ray to find out.

    Raises:
        ValueError: no address, or no answer within SECONDS.
    """
    if address in (None, "auto", "local"):
        return
    host, _, port = str(address).removeprefix("ray://").rpartition(":")
    check(
        bool(host) and port.isdecimal() and 0 < int(port) < 2**16,
        f"address={address!r}; give auto, HOST:PORT or ray://HOST:PORT",
    )
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=SECONDS).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(
            f"address={address!r}: no Ray cluster answers there ({reason}); start one by "
            "`ray start --head`, or leave the address out"
        ) from None
