"""Scores as a table on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.hidden_contest import Certificate
from train.evaluation.scores import Score, optimality_gap


def print_floor(floor: float | None, discount: float) -> None:
    """One line on the floor of the training objective, where it is known."""
    if floor is not None:
        print(
            f"floor of the objective: {100 * floor:+.2f} % (the gap of the policy that is best by "
            f"the rewards with discount {discount:g}; exact, over all starts)"
        )


def print_bounds(contest: ArmContest) -> None:
    """One line on how well the least steps of an arm are known."""
    bounds = contest.bounds()
    if contest.task.discrete_actions:
        print(
            "optimal: the least steps with continuous actions; discrete ones need as many or more"
        )
    elif bounds.share_exact == 1.0:
        print("optimal: the least steps, exact from every start")
    else:
        print(
            f"optimal: at least {bounds.lower.mean():.3f} steps and at most "
            f"{bounds.upper.mean():.3f}, exact from {100 * bounds.share_exact:.1f} % of the "
            "starts; gaps are to the lower bound"
        )


def certificate_of(contest: Any) -> Certificate | None:
    """What is proven of the optimum of a contest, of an agent with limited sight only."""
    return contest.certificate() if isinstance(contest, GameContest) else None


def print_certificate(certificate: Certificate | None) -> None:
    """One line on what is proven of the optimum of an agent with limited sight."""
    if certificate is not None:
        print(certificate.line() + "; the gaps above are to its far end")


def print_scores(scores: Sequence[Score], certificate: Certificate | None = None) -> None:
    """A table of scores with the gap to the optimal one, or to what is proven of it."""
    optimum = next((score for score in scores if score.name == "optimal"), None)
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    certain = () if certificate is None else ("discounted", certificate.head)
    cut = [s for s in scores if s.success_rate < 1.0 and s.solved_gap is not None]
    solved = ("of the solved",) if cut else ()
    for column in ("steps", "95 % interval", "success", "gap to optimum", *solved, *certain):
        table.add_column(column, justify="right")
    for score in scores:
        gap = optimality_gap(score, optimum)
        interval = "exact" if score.exact else f"± {score.ci95:.3f}"
        steps = score.discounted_steps
        proven = ["", ""]
        if certificate is not None and steps is not None:
            proven = [f"{steps:.3f}", f"{100 * certificate.gap(steps):+.2f} %"]
        table.add_row(
            score.name,
            f"{score.mean_steps:.3f}",
            interval,
            f"{100 * score.success_rate:.1f} %",
            _percent(None if score is optimum else gap),
            *(
                ["" if score not in cut else f"{100 * (score.solved_gap or 0.0):+.2f} %"]
                * len(solved)
            ),
            *(proven if certain else ()),
            style="bold" if score.name == "learned" else "",
        )
    Console(width=None if sys.stdout.isatty() else 100).print(table)
    print_certificate(certificate)


def _percent(gap: float | None) -> str:
    return "" if gap is None else f"{100 * gap:+.2f} %"
