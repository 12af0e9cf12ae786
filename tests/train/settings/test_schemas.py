"""Contents of files are validated, with readable errors."""

from dataclasses import dataclass

import msgspec
import pytest

from train.schemas import read_as


@dataclass(frozen=True)
class Inner:
    steps: int
    share: float | None = None

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise ValueError(f"steps={self.steps}; at least 1")


class Outer(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    inner: Inner


GOOD = {"name": "a", "inner": {"steps": 3, "share": 1}}


def test_what_fits_is_read():
    assert read_as(Outer, GOOD, "f.json", "restore it") == Outer("a", Inner(3, 1.0))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ([], "a table expected, a list found"),
        ({"inner": {"steps": 1}}, "field 'name' is missing"),
        ({**GOOD, "nmae": 1}, "unknown field 'nmae'"),
        ({**GOOD, "name": 3}, "field name: a string expected, a whole number found"),
        ({**GOOD, "inner": {"steps": "3"}}, "field inner.steps: a whole number expected"),
        (
            {**GOOD, "inner": {"steps": 1, "share": "x"}},
            "field inner.share: a number or nothing expected, a string found",
        ),
        ({**GOOD, "inner": {"steps": 0}}, "field inner: steps=0; at least 1"),
    ],
)
def test_what_does_not_fit_is_one_line_with_file_field_and_remedy(content, said):
    with pytest.raises(ValueError) as caught:
        read_as(Outer, content, "f.json", "restore it")
    message = str(caught.value)
    assert message.startswith("f.json: ") and message.endswith("; restore it")
    assert said in message and "|" not in message and "`" not in message


def test_a_dataclass_takes_no_unknown_field():
    with pytest.raises(ValueError, match=r"unknown field 'setps' \(did you mean 'steps'\?\)"):
        read_as(Inner, {"steps": 1, "setps": 2}, "f.json", "restore it")
