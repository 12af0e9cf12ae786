"""Meta-strategies and PSRO on matrices: OpenSpiel's alpha-rank, values of games."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from scripted_agents import alpha_rank, meta_strategy, psro, solve_matrix_game

ROCK_PAPER_SCISSORS = [[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]]
BIASED = [[0.0, -1.0, 2.0], [1.0, 0.0, -1.0], [-2.0, 1.0, 0.0]]
DOMINATED = [*ROCK_PAPER_SCISSORS, [-2.0, -2.0, -2.0]]
RECTANGLE = [[3.0, 1.0], [0.5, 2.0], [1.0, 1.0]]

# open_spiel 2.0.2: alpharank.compute([payoff, -payoff], use_inf_alpha=True, inf_alpha_eps=0.01),
# its stationary distribution summed over columns and over rows.
OPEN_SPIEL = [
    (ROCK_PAPER_SCISSORS, [1 / 3, 1 / 3, 1 / 3], [1 / 3, 1 / 3, 1 / 3]),
    (BIASED, [1 / 3, 1 / 3, 1 / 3], [1 / 3, 1 / 3, 1 / 3]),
    (RECTANGLE, [0.42438859, 0.38696194, 0.18864947], [0.48166094, 0.51833906]),
    (DOMINATED, [0.33221477, 0.33221477, 0.33221477, 0.0033557], [1 / 3, 1 / 3, 1 / 3]),
]


@pytest.mark.parametrize(("payoff", "row", "column"), OPEN_SPIEL)
def test_alpha_rank_against_values_of_open_spiel(
    payoff: list[list[float]], row: list[float], column: list[float]
) -> None:
    found = meta_strategy(payoff, "alpha-rank")
    np.testing.assert_allclose(found[0], row, atol=1e-7)
    np.testing.assert_allclose(found[1], column, atol=1e-7)


ALPHA_RANK = """
import json, sys
import numpy as np
from open_spiel.python.egt import alpharank

for payoff in map(np.array, json.load(sys.stdin)):
    found = alpharank.compute([payoff, -payoff], use_inf_alpha=True, inf_alpha_eps=0.01)
    print(json.dumps(found[2].tolist()))
"""


def test_alpha_rank_against_open_spiel() -> None:
    """In a process of its own, as the Python part of OpenSpiel closes the streams that pytest
    reads."""
    pytest.importorskip("pyspiel")
    rng = np.random.default_rng(0)
    sizes = rng.integers(2, 6, size=(10, 2)).tolist()
    payoffs = [rng.integers(-2, 3, size=size).astype(float) for size in sizes]
    done = subprocess.run(
        [sys.executable, "-c", ALPHA_RANK],
        input=json.dumps([payoff.tolist() for payoff in payoffs]),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    theirs = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("[")]
    for payoff, known in zip(payoffs, theirs, strict=True):
        np.testing.assert_allclose(alpha_rank(payoff).ravel(), known, atol=1e-9)


def stationary_by_steps(payoff: NDArray[np.float64]) -> NDArray[np.float64]:
    """The chain of alpha-rank pair by pair, run for many steps."""
    m, n = payoff.shape
    pairs = [(i, j) for i in range(m) for j in range(n)]
    chain = np.zeros((len(pairs), len(pairs)))
    for a, (i, j) in enumerate(pairs):
        for b, (k, h) in enumerate(pairs):
            if (i == k) == (j == h):
                continue
            gain = payoff[k, h] - payoff[i, j] if j == h else payoff[i, j] - payoff[k, h]
            chance = 0.5 if gain == 0 else 0.99 if gain > 0 else 0.01
            chain[a, b] = chance / (m + n - 2)
        chain[a, a] = 1.0 - chain[a].sum()
    return np.linalg.matrix_power(chain, 100_000)[0].reshape(m, n)


@pytest.mark.parametrize("seed", range(5))
def test_alpha_rank_against_the_chain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    payoff = rng.integers(-2, 3, size=(4, 3)).astype(float)
    np.testing.assert_allclose(alpha_rank(payoff), stationary_by_steps(payoff), atol=1e-9)
    np.testing.assert_allclose(alpha_rank(1000.0 * payoff), alpha_rank(payoff), atol=1e-12)


def test_nash_and_uniform() -> None:
    row, column = meta_strategy(BIASED, "nash")
    np.testing.assert_allclose(row, [0.25, 0.5, 0.25])
    np.testing.assert_allclose(column, [0.25, 0.5, 0.25])
    row, column = meta_strategy(RECTANGLE, "uniform")
    assert row.tolist() == [1 / 3, 1 / 3, 1 / 3] and column.tolist() == [0.5, 0.5]
    assert alpha_rank([[2.0]]).tolist() == [[1.0]]


@pytest.mark.parametrize(
    "payoff",
    [
        ROCK_PAPER_SCISSORS,
        BIASED,
        DOMINATED,
        RECTANGLE,
        np.random.default_rng(1).normal(size=(12, 9)),
    ],
)
def test_psro_with_nash_ends_at_the_value(payoff: object) -> None:
    matrix = np.array(payoff)
    found = psro(matrix)
    assert found.row @ matrix @ found.column == pytest.approx(solve_matrix_game(matrix).value)
    assert found.nash_convs[-1] == pytest.approx(0.0, abs=1e-9)
    assert found.nash_convs[-1] == pytest.approx(
        (matrix @ found.column).max() - (found.row @ matrix).min(), abs=1e-12
    )
    assert len(set(found.rows)) == len(found.rows) and len(set(found.columns)) == len(found.columns)


def test_psro_leaves_out_a_dominated_row() -> None:
    assert sorted(psro(DOMINATED).rows) == [0, 1, 2]


def test_other_meta_strategies_may_end_elsewhere() -> None:
    """Uniform ends in rock-paper-scissors when the best response is there already."""
    found = psro(ROCK_PAPER_SCISSORS, "uniform")
    assert found.rows == [0, 1] and found.nash_convs == [2.0, 1.0]
    assert psro(ROCK_PAPER_SCISSORS, "alpha-rank").nash_convs[-1] == pytest.approx(0.0, abs=1e-9)
    assert psro(BIASED, "alpha-rank").nash_convs[-1] == pytest.approx(2 / 3)


def test_invalid_arguments() -> None:
    with pytest.raises(ValueError, match="unknown kind 'best'"):
        meta_strategy([[1.0]], "best")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="2600 pairs"):
        alpha_rank(np.zeros((52, 50)))
    with pytest.raises(ValueError, match="tolerance=-1"):
        psro([[1.0]], tolerance=-1.0)
    with pytest.raises(ValueError, match="payoff has shape"):
        psro([])
