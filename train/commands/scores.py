"""Printing of scores, references and bounds."""

from __future__ import annotations

from collections.abc import Sequence

from scripted_agents import count_joint_states
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.contests import AnyContest
from train.evaluation.score_table import score_table
from train.evaluation.scores import BY_GOALS, BY_RETURN, BY_STEPS, OUTCOME, Reference, Score
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
    if isinstance(contest, GameContest) and held["kind"] == "best known":
        why = contest.with_full_view.exact_reference.reason
        if why:
            print(f"no exact optimum: {why}")


def print_team(results: Plain) -> None:
    """Print the "team" of results, if there is one."""
    if "team" in results:
        print(*describe_team(results["team"]), sep="\n")


def print_bounds(contest: ArmContest) -> None:
    """Print the bounds of the minimum steps of an arm."""
    bounds = contest.bounds()
    if contest.task.discrete_actions:
        print("optimal: minimum steps with continuous actions, a lower bound for discrete actions")
    elif bounds.share_exact == 1.0:
        print("optimal: minimum steps, exact from every start")
    else:
        print(
            f"optimal: at least {bounds.lower.mean():.3f} steps and at most "
            f"{bounds.upper.mean():.3f}, exact from {100 * bounds.share_exact:.1f} % of the "
            "starts; gaps are to the lower bound"
        )


def print_whole_game(contest: GameContest) -> None:
    """Print the number of states of a game of several agents, and its optima over all starts or
    the reason why they are not computed."""
    states = count_joint_states(contest.task)
    print(f"distinct states: {states:,}")
    if contest.exact_reference.reason:
        print(f"no exact optimum: {contest.exact_reference.reason}")
        return
    agent = contest.agent
    found = (
        ("mean optimum over all starts", " steps", BY_STEPS),
        (f"highest return of {agent}, over all starts", "", BY_RETURN),
        (f"most goals of {agent}, over all starts", "", BY_GOALS),
    )
    outcome = contest.best_in(contest.measure)
    if outcome is not None and contest.measure.name == "outcome":
        mean = outcome.mean_over_starts * (-1.0 if contest.role == "evader" else 1.0)
        print(f"{OUTCOME} with the best {agent}, over all starts: {mean:.4f} (exact)")
    for text, unit, measure in found:
        if (best := contest.best_in(measure)) is not None:
            print(f"{text}: {best.mean_over_starts:.4f}{unit} (exact)")


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
