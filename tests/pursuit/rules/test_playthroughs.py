"""Games equal their stored playthroughs in plain text."""

import pytest
from playthroughs import FOLDER, NAMES, playthrough


@pytest.mark.parametrize("name", NAMES)
def test_the_game_matches_the_stored_playthrough(name: str) -> None:
    """After an intended change of a rule: `python tests/playthroughs.py`, and check the diff."""
    assert playthrough(name) == (FOLDER / f"{name}.txt").read_text(encoding="utf-8")


def test_every_text_belongs_to_a_game() -> None:
    assert {path.stem for path in FOLDER.glob("*.txt")} == set(NAMES)
