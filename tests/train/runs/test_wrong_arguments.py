"""Values of a wrong type in the functions of `pursuit`: one line that names value and remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pursuit

NO_PATHS = [3, None, [], {}, 1.5, b"runs/a", "runs/a\0", "a" * 4000]


def evaluate(**given: Any) -> object:
    """The evaluation of a policy in two games."""
    settings = {"maze": "2x2", "episodes": 2, **given}
    return pursuit.evaluate(lambda seen: np.zeros(len(seen), int), "chase", **settings)


def settings() -> Any:
    return pursuit.settings_of(task="maze", maze="2x2", num_goals=1, frames=10**6)


def refused(call: Any) -> str:
    with pytest.raises(ValueError) as error:
        call()
    message = str(error.value)
    assert "\n" not in message and len(message) < 300
    return message


@pytest.mark.parametrize("seed", ["x", None, [1], b"x", 1.5, True, np.array([1]), -1, 2**62])
def test_seeds_of_evaluations(seed: Any) -> None:
    assert refused(lambda: evaluate(seed=seed)).startswith(f"seed={seed!r}")


def test_numpys_integers_are_seeds() -> None:
    assert evaluate(seed=np.int64(7)) == evaluate(seed=7)


@pytest.mark.parametrize("path", NO_PATHS)
def test_paths(path: Any, tmp_path: Path) -> None:
    for call in (pursuit.load_policy, pursuit.open_run, pursuit.Replay.load):
        assert str(path)[:50].strip("\0") in refused(lambda call=call: call(path))
    assert refused(lambda: pursuit.start("single", settings(), path)).startswith("path=")
    assert refused(lambda: pursuit.export_policy(None, path)).startswith("path=")


@pytest.mark.parametrize("given", [3, None, {}, "runs/a"])
@pytest.mark.parametrize("kind", ["single", "self-play"])
def test_settings_of_runs(kind: str, given: Any, tmp_path: Path) -> None:
    assert refused(lambda: pursuit.start(kind, given, tmp_path / "a")).startswith(
        f"settings={given!r}"
    )
    assert not (tmp_path / "a").exists()


def test_settings_of_another_kind_of_run(tmp_path: Path) -> None:
    message = refused(lambda: pursuit.start("self-play", settings(), tmp_path / "a"))
    assert message.endswith("give SelfPlaySettings")
