"""Calls of a user's functions: errors that name the call, and all observations as one array."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.validation import as_array, check, raised, shortened
from scripted_agents.games.game import State


@contextmanager
def mended(what: str) -> Iterator[None]:
    """Raise exceptions of a user's code as ValueError with `what`; ValueError and MemoryError pass.

    Notes of the exception are in the message.
    """
    try:
        yield
    except (ValueError, MemoryError):
        raise
    except Exception as error:
        reason = " ".join([raised(error), *getattr(error, "__notes__", ())])
        raise ValueError(f"{what} raised {reason}; mend it") from error


def encoded_states(
    states: Sequence[State], name: str, function: Callable[..., ArrayLike], *others: Any
) -> NDArray[np.float32]:
    """[states, *shape] float32: what a user's function returns in every state.

    Args:
        states: all states.
        name: of the function, for messages.
        function: of a state and the `others`.
        others: further arguments.

    Raises:
        ValueError: an exception, arrays of different shapes, numbers that are not finite, or too
            little memory.
    """

    def call(state: State) -> str:
        return f"{name}({', '.join(map(shortened, (state, *others)))})"

    found: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
    for number, state in enumerate(states):
        try:
            given = function(state, *others)
        except Exception as error:  # of the user's code
            raise ValueError(f"{call(state)} raised {raised(error)}; mend it") from error
        row = np.atleast_1d(as_array(call(state), given, "biuf", "return an array of numbers"))
        if number == 0:
            check(row.size > 0, f"{call(state)} is empty; return at least one number")
            needed = 12 * row.size * len(states)  # with copies
            check_memory(f"{call(state)} and of all states", needed, "return smaller arrays")
            found = np.empty((len(states), *row.shape), dtype=np.float32)
        if row.shape != found.shape[1:]:
            raise ValueError(
                f"{call(state)} has shape {row.shape}, and {found.shape[1:]} in the first state; "
                "return arrays of one shape"
            )
        with np.errstate(over="ignore"):  # infinite as float32
            found[number] = row
        if not np.isfinite(found[number]).all():
            raise ValueError(
                f"{call(state)} contains numbers that are not finite; return finite ones"
            )
    return found
