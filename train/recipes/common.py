"""What recipes share: the command line, and the budget and file of a model of another library."""

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
    """The command line of a recipe: `run` with its options as a `form`; errors, those of a library
    too, are one line and exit status 2."""
    caught: tuple[type[Exception], ...] = (ValueError, OSError, ImportError, *errors)

    def main(arguments: Sequence[str] | None = None) -> None:
        try:
            run(parse(form, sys.argv[1:] if arguments is None else arguments, "recipe"))
        except caught as error:
            fail(str(error))

    return main


@dataclass(frozen=True, kw_only=True)
class LibraryRecipe:
    """How long Stable-Baselines3 trains, and where the model goes."""

    seconds: float = 60.0
    """Budget of training time."""
    frames: int | None = None
    """Budget in frames instead, which repeats better than seconds."""
    out: Path | None = None
    """A new .zip file for the model."""

    def __post_init__(self) -> None:
        check(self.seconds > 0, f"seconds={self.seconds}; it is above 0")
        check(self.frames is None or self.frames > 0, f"frames={self.frames}; it is above 0")
        if self.out is not None:
            check(self.out.suffix == ".zip", f"{self.out}: give a .zip file")
            check(not self.out.exists(), f"{self.out}: exists already; give a new file")

    def train(self, model: Any) -> None:
        """Have a model of Stable-Baselines3 learn until the budget is spent."""
        from stable_baselines3.common.callbacks import BaseCallback

        frames, seconds = self.frames, self.seconds

        class Budget(BaseCallback):
            """Ends the training when its time is over."""

            began = 0.0

            def _on_training_start(self) -> None:
                self.began = perf_counter()

            def _on_step(self) -> bool:
                return bool(frames) or perf_counter() - self.began < seconds

        model.learn(frames or 10**12, callback=Budget())
