"""A chase by hand, served."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from played_by_hand import Visitor, maze_session, serving

from train.play.server import PlayServer


@pytest.fixture
def chaser() -> Iterator[tuple[Visitor, PlayServer]]:
    with serving(
        maze_session(3, "optimal", maze="3x3", opponent_epsilon=0.0, max_steps=30)
    ) as both:
        yield both
