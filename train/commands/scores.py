"""Printing of scores and references."""

from __future__ import annotations

from collections.abc import Sequence

from train.evaluation.score_table import score_table
from train.evaluation.scores import OUTCOME, AnyContest, Reference, Score
from train.evaluation.team_contest import describe_team
from train.files import Plain
from train.reports.tables import print_table


def print_objective_gap(evaluation: Plain, discount: float) -> None:
    """Print the gap of the policy that is optimal for the training objective, if it is known."""
    gap, missing = evaluation.get("objective_gap"), evaluation.get("return_gap")
    outcome = evaluation.get("outcome_gap")
    best = f"a policy optimal for the training objective (discount {discount:g})"
    if gap is not None and missing is None:
        print(f"{best} has a gap of {100 * gap:+.2f} % (exact, over all starts)")
    if missing is not None:
        print(f"{best} misses {missing:z.4f} of the return (exact, over all starts)")
    if outcome is not None:
        print(f"{best} misses {outcome:z.4f} of {OUTCOME} (exact, over all starts)")


def print_reference(held: Plain, contest: AnyContest) -> None:
    """Print the reference of a result if no exact optimum is known, and the reason.

    Args:
        held: "reference" of `results.json`; {} if there is none.
        contest: the evaluation.
    """
    if not held or held["kind"] in ("exact", "certified"):  # shown in the table of scores
        return
    print(Reference(**held).line())
    if held["kind"] == "best known" and (why := contest.why_no_optimum):
        print(f"no exact optimum: {why}")


def print_team(results: Plain) -> None:
    """Print the "team" of results, if there is one."""
    if "team" in results:
        print(*describe_team(results["team"]), sep="\n")


def print_scores(scores: Sequence[Score], contest: AnyContest) -> None:
    """Print a table of scores (`score_table`), and the proven interval of the optimum."""
    certificate = contest.certificate()
    table = score_table(scores, certificate, contest.measure, contest.beside, contest.success)
    print_table(table, width=100 + len(contest.beside))
    if certificate is not None:
        print(
            certificate.line() + "; gaps above are to its pessimistic end. Scripted references "
            "with full view can have gaps below 0"
        )
