"""The output of commands for an evaluation in a suite of mazes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pursuit.simulator.policy import Policy
from train.commands.scores import print_scores
from train.evaluation.suite_contest import InMazes, SuiteContest
from train.evaluation.suite_report import generalisation, kind_table, maze_rows, summary_of
from train.files import Plain, write_csv
from train.reports.tables import print_table

SEEN_MAZES = 200
"""Maximum number of training mazes that a policy is evaluated in, at equal distances."""


def evaluate_in_mazes(
    contest: SuiteContest, policies: dict[str, Policy], table: Path | None
) -> list[InMazes]:
    """Evaluate policies in every maze, and print and write the results.

    Args:
        contest: of the evaluation.
        policies: by name, "learned" first.
        table: the .csv file with a row per maze; None for none.

    Returns:
        The results of the references, then of the policies.
    """
    own = [contest.in_mazes(name, policy) for name, policy in policies.items()]
    found = [*contest.references(), *own]
    print_scores([each.score(contest.episodes) for each in found], contest)
    text = [each for each in found if each is not contest.best]
    rows = maze_rows(contest, text)
    if rows[0]["kind"]:
        print_table(kind_table(rows))
    print_summary(summary_of(contest, own[0]))
    if table is not None:
        write_csv(table, rows)
        print(f"table: {table}")
    return found


def print_summary(found: Plain) -> None:
    """Print a summary in one line."""
    text = f"{found['mazes']} mazes: {100 * found['success_rate']:.2f} % of the tasks solved, "
    text += f"{100 * found['solved_mazes']:.1f} % of the mazes from all starts"
    if "mean_gap" in found:
        text += (
            f"; gap to the optimum {100 * found['optimality_gap']:+.2f} %, mean of the mazes' gaps "
            f"{100 * found['mean_gap']:+.2f} %, worst {100 * found['worst_gap']:+.1f} %"
        )
    print(text)


def compared(
    contest: SuiteContest, found: InMazes, training: SuiteContest, policy: Policy
) -> Plain:
    """The generalisation gap from the training mazes to those of a contest; it is printed."""
    if len(training.task.mazes) > SEEN_MAZES:
        step = len(training.task.mazes) / SEEN_MAZES
        mazes = tuple(training.task.mazes[int(n * step)] for n in range(SEEN_MAZES))
        training = replace(training, task=replace(training.task, maze=mazes))
    seen = summary_of(training, training.in_mazes(found.name, policy))
    result = generalisation(seen, summary_of(contest, found))
    print(f"in {seen['maze']}, of its training: ", end="")
    print_summary(seen)
    lost = result["lost"]
    text = f"generalisation gap: {100 * lost['success_rate']:+.2f} points of success"
    if "optimality_gap" in lost:
        text += f", {100 * lost['optimality_gap']:+.2f} points of the gap to the optimum"
    print(text)
    return result
