"""The rule of captures, used by the simulator and by the exact solvers."""

from __future__ import annotations

from typing import Any, NamedTuple

from pursuit.compilation.compiled import inlined


def captured(
    chasers_first: bool,
    chaser_before: Any,
    chaser_after: Any,
    evader_before: Any,
    evader_after: Any,
) -> Any:
    """Whether a chaser captures an evader, by their cells before and after their moves.

    It does if both moves lead to the same cell, if both move at once and swap cells, and, if
    chasers move first, if it moves to the cell of the evader. Cells are numbers or NumPy arrays.
    """
    reached = chaser_after == evader_before
    if not chasers_first:
        reached = reached & (chaser_before == evader_after)
    return reached | (chaser_after == evader_after)


captures = inlined(captured)
"""`captured`, for kernels."""


class Duel(NamedTuple):
    """One chaser against one evader, from the view of one of them: *own* against *other*."""

    own_chases: bool
    chasers_first: bool


@inlined
def ends_duel(duel: Duel, own: int, own_after: int, other: int, other_after: int) -> bool:
    """Whether two moves of a duel end in a capture."""
    if duel.own_chases:
        return captures(duel.chasers_first, own, own_after, other, other_after)
    return captures(duel.chasers_first, other, other_after, own, own_after)
