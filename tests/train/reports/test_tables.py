"""Plain tables: values as text."""

from __future__ import annotations

import pytest

from train.reports.tables import plain_table, plain_text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("as it is", "as it is"),
        (12345, "12345"),
        (12345.6, "12346"),
        (12.345, "12.3"),
        (-0.01234, "-0.0123"),
        (0.00123, "0.0012"),
        (0.00001, "< 0.0001"),
        (0.0, "0"),
        (None, ""),
        (True, "True"),
        (float("inf"), "inf"),
        ([0.5, 0.25, 1.0], "0.500 [0.250, 1.00]"),
    ],
)
def test_values_as_text(value: object, text: str) -> None:
    assert plain_text(value) == text


def test_headings_may_repeat() -> None:
    table = plain_table([{"a": 1, "b": 0.5}, {"a": 2, "b": None}], {"b": "a"})
    assert table.markdown() == "| a | a |\n|---|---|\n| 1 | 0.500 |\n| 2 |  |"
    assert plain_table([]).cells() == []
