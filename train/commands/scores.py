"""Scores as a table on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console
from rich.table import Table

from scripted_agents import count_joint_states
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.hidden_contest import Certificate
from train.evaluation.joint_contest import MAX_EVALUATED_WORK, MAX_WORK, joint_work
from train.evaluation.scores import (
    BY_STEPS,
    FULL_SIGHT,
    Measure,
    Reference,
    Score,
    optimality_gap,
)


def print_floor(evaluation: Mapping[str, Any], discount: float) -> None:
    """One line on the floor of the training objective, where it is known."""
    floor, paid = evaluation.get("objective_floor"), evaluation.get("return_floor")
    best = f"of the policy that is best by the rewards with discount {discount:g}"
    if floor is not None and paid is None:
        print(
            f"floor of the objective: {100 * floor:+.2f} % (the gap {best}; exact, over all starts)"
        )
    if paid is not None:
        print(f"floor of the objective: {paid:.4f} (what is missing {best}; exact, all starts)")


def print_reference(held: Mapping[str, Any], contest: Any) -> None:
    """One line on what a result is held against where no exact optimum is known, and why not.

    Args:
        held: "reference" of `results.json`; {} where there is none.
        contest: whose.
    """
    if not held or held["kind"] in ("exact", "certified"):  # said by the table, with its intervals
        return
    print(Reference(**held).line())
    if isinstance(contest, GameContest) and held["kind"] == "best known":
        why = contest.in_full_sight.why_not_joint()
        if why is not None:
            print(f"no exact optimum: {why}")


def say_what_is_solved(contest: Any, interrupted: bool) -> None:
    """One line on stderr where results wait for a whole game that takes more than moments."""
    if not isinstance(contest, GameContest) or contest.task.num_agents == 1 or interrupted:
        return
    judged = replace(contest.in_full_sight, most_work=MAX_EVALUATED_WORK)
    if judged.is_exact or joint_work(judged.task) <= MAX_WORK or judged.why_not_joint():
        return
    states = count_joint_states(judged.task)
    print(f"solving the whole game exactly, {states:,} states ...", file=sys.stderr)


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


def print_whole_game(contest: GameContest) -> None:
    """The states of a game of teams or rivals, and its optima over all starts, or why there are
    none."""
    states = count_joint_states(contest.task)
    print(f"distinct states: {states:,}")
    obstacle = contest.why_not_joint()
    if obstacle is not None:
        print(f"no exact optimum: {obstacle}")
        return
    if contest.best_of_steps is not None:
        mean = contest.best_of_steps.mean_over_starts
        print(f"mean optimum over all starts: {mean:.4f} steps (exact)")
    if contest.best_of_returns is not None:
        mean = contest.best_of_returns.mean_over_starts
        print(f"most that {contest.agent} can be paid, over all starts: {mean:.4f} (exact)")
    if contest.best_of_goals is not None:
        mean = contest.best_of_goals.mean_over_starts
        print(f"most goals that {contest.agent} can collect, over all starts: {mean:.4f} (exact)")


def certificate_of(contest: Any) -> Certificate | None:
    """What is proven of the optimum of a contest, of an agent with limited sight only."""
    return contest.certificate() if isinstance(contest, GameContest) else None


def print_certificate(certificate: Certificate | None) -> None:
    """One line on what is proven of the optimum of an agent with limited sight."""
    if certificate is not None:
        print(
            certificate.line() + "; the gaps above are to its far end. Whoever sees everything, as "
            "scripted references may, can lie below 0"
        )


def print_scores(
    scores: Sequence[Score],
    certificate: Certificate | None = None,
    measure: Measure = BY_STEPS,
) -> None:
    """A table of scores with the gap to the optimal one, or to what is proven of it.

    Where they are compared by goals or returns, these stand first, with what is missing to the
    best where that is known.
    """
    optimum = next((score for score in scores if score.name == "optimal"), None)
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    certain = () if certificate is None else ("discounted", certificate.head)
    cut = [s for s in scores if s.success_rate < 1.0 and s.solved_gap is not None]
    solved = ("of the solved",) if cut else ()
    names = (measure.optimum, measure.optimum + FULL_SIGHT)
    best = next((score for score in scores if score.name in names), None)
    own: tuple[str, ...] = ()
    if measure.name != "steps":
        own = (measure.name, "below the best")[: 1 if best is None else 2]
    gaps = () if own else ("gap to optimum",)
    for column in (*own, "steps", "95 % interval", "success", *gaps, *solved, *certain):
        table.add_column(column, justify="right")
    for score in scores:
        gap = optimality_gap(score, optimum)
        interval = "exact" if score.exact else f"± {score.ci95:.3f}"
        steps = score.discounted_steps
        proven = ["", ""]
        if certificate is not None and steps is not None:
            proven = [f"{steps:.3f}", f"{100 * certificate.gap(steps):+.2f} %"]
        table.add_row(
            "optimal steps" if own and score is optimum else score.name,
            *_measured(measure, score, best)[: len(own)],
            f"{score.mean_steps:.3f}",
            interval,
            f"{100 * score.success_rate:.1f} %",
            *[_percent(None if score is optimum else gap)] * len(gaps),
            *(
                ["" if score not in cut else f"{100 * (score.solved_gap or 0.0):+.2f} %"]
                * len(solved)
            ),
            *(proven if certain else ()),
            style="bold" if score.name == "learned" else "",
        )
    Console(width=None if sys.stdout.isatty() else 100).print(table)
    print_certificate(certificate)


def _measured(measure: Measure, score: Score, best: Score | None) -> tuple[str, str]:
    """The goals or the return of an episode, and what is missing to the best."""
    value, missing = measure.of(score), measure.distance(score, best)
    return (
        "" if value is None else f"{value:.3f}",
        "" if missing is None or score is best else f"{missing:.3f}",
    )


def _percent(gap: float | None) -> str:
    return "" if gap is None else f"{100 * gap:+.2f} %"
