"""What a user's function returns in every state of a game, as one array."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pursuit.memory import check_memory
from pursuit.validation import as_array, check, raised
from scripted_agents.games.game import State


def encoded_states(
    states: Sequence[State], encode: Callable[[State], ArrayLike], call: Callable[[State], str]
) -> NDArray[np.float32]:
    """[states, *shape] float32: what a user's function of a state returns in every state.

    Args:
        states: all states.
        encode: the function.
        call: the call for a state as text, for messages.

    Raises:
        ValueError: an exception, arrays of different shapes, numbers that are not finite, or too
            little memory.
    """
    found: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
    for number, state in enumerate(states):
        try:
            given = encode(state)
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
