"""The value of a matrix game, to compare solvers of games with."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linprog


def matrix_value(payoffs: Any) -> float:
    """The value for the row player: that of a saddle point, or else by a linear program."""
    pure = np.min(payoffs, axis=1).max()
    if pure == np.max(payoffs, axis=0).min():
        return float(pure)
    rows, columns = np.shape(payoffs)
    found = linprog(
        [0.0] * rows + [-1.0],
        A_ub=np.c_[-np.transpose(payoffs), np.ones(columns)],
        b_ub=np.zeros(columns),
        A_eq=[[1.0] * rows + [0.0]],
        b_eq=[1.0],
        bounds=[(0.0, None)] * rows + [(None, None)],
    )
    return float(-found.fun)
