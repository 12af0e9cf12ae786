"""Scores as a table on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from scripted_agents import count_joint_states
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.hidden_contest import Certificate
from train.evaluation.joint_contest import MAX_EVALUATED_WORK, MAX_WORK, joint_work
from train.evaluation.scores import (
    BY_STEPS,
    Measure,
    Reference,
    Score,
    score_table,
)
from train.reports.tables import print_table


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
    agent = contest.agent
    found = (
        ("mean optimum over all starts", " steps", contest.best_of_steps),
        (f"most that {agent} can be paid, over all starts", "", contest.best_of_returns),
        (
            f"most goals that {contest.agent} can collect, over all starts",
            "",
            contest.best_of_goals,
        ),
    )
    for text, unit, best in found:
        if best is not None:
            print(f"{text}: {best.mean_over_starts:.4f}{unit} (exact)")


def certificate_of(contest: Any) -> Certificate | None:
    """What is proven of the optimum of a contest, of an agent with limited sight only."""
    return contest.certificate() if isinstance(contest, GameContest) else None


def print_scores(
    scores: Sequence[Score], certificate: Certificate | None = None, measure: Measure = BY_STEPS
) -> None:
    """A table of scores (`score_table`), and what is proven of the optimum."""
    print_table(score_table(scores, certificate, measure), width=100)
    if certificate is not None:
        print(
            certificate.line() + "; the gaps above are to its far end. Whoever sees everything, as "
            "scripted references may, can lie below 0"
        )
