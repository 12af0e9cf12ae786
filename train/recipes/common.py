"""The command line of recipes, and the budget and file of a Stable-Baselines3 model."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, TypeVar

from train.commands.parse import fail, parse
from train.settings.checks import check

Form = TypeVar("Form")


def main_of(
    form: type[Form], run: Callable[[Form], object], *errors: type[Exception]
) -> Callable[..., None]:
    """The command line of a recipe, which calls `run` with the options as a `form`.

    Errors, also `errors` of libraries, are printed in one line, with exit status 2.
    """
    caught: tuple[type[Exception], ...] = (ValueError, OSError, ImportError, *errors)

    def main(arguments: Sequence[str] | None = None) -> None:
        try:
            run(parse(form, sys.argv[1:] if arguments is None else arguments, "recipe"))
        except caught as error:
            fail(str(error))

    return main


@dataclass(frozen=True, kw_only=True)
class LibraryRecipe:
    """The budget and the output file of a recipe with Stable-Baselines3."""

    seconds: float = 60.0
    """Budget of training time."""
    frames: int | None = None
    """Budget in frames instead of seconds, for reproducible results."""
    out: Path | None = None
    """A new .zip file for the model."""

    def __post_init__(self) -> None:
        check(self.seconds > 0, f"seconds={self.seconds}; give a number above 0")
        check(self.frames is None or self.frames > 0, f"frames={self.frames}; give at least 1")
        if self.out is not None:
            check(self.out.suffix == ".zip", f"{self.out}: give a .zip file")
            check(not self.out.exists(), f"{self.out}: exists already; give a new file")

    def train(self, model: Any) -> None:
        """Train a Stable-Baselines3 model until the end of the budget."""
        from stable_baselines3.common.callbacks import BaseCallback

        frames, seconds = self.frames, self.seconds

        class Budget(BaseCallback):
            """Stops the training after `seconds`."""

            began = 0.0

            def _on_training_start(self) -> None:
                self.began = perf_counter()

            def _on_step(self) -> bool:
                return bool(frames) or perf_counter() - self.began < seconds

        model.learn(frames or 10**12, callback=Budget())
