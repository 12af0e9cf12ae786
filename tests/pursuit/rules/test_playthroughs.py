"""The golden playthroughs: what the rules do, in plain text, is what it was."""

import pytest
from playthroughs import FOLDER, NAMES, playthrough


@pytest.mark.parametrize("name", NAMES)
def test_the_game_is_the_one_that_is_written_down(name: str) -> None:
    """Where a rule is changed on purpose: `python tests/playthroughs.py`, and read the change."""
    assert playthrough(name) == (FOLDER / f"{name}.txt").read_text(encoding="utf-8")


def test_every_text_belongs_to_a_game() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(NAMES)
