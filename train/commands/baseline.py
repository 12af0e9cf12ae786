"""`pursuit baseline`: random, scripted and optimal agents on a task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Annotated

from pursuit.validation import at_least
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from train.commands.parse import options_in, parse
from train.settings.checks import Settings
from train.settings.task import TaskSettings
from train.settings.task_form import AnyTask, default_task


@dataclass(frozen=True)
class BaselineCommand(Settings):
    """Evaluate random, scripted and optimal agents on a task, exactly if possible; for the arm
    (--task reacher) inverse kinematics and the minimum steps."""

    task: AnyTask = field(default_factory=TaskSettings)
    episodes: Annotated[int, at_least(2)] = 10_000
    """Number of sampled episodes, if there is no exact solution."""
    seed: int = 0
    """Seed of these episodes; 0 as in all evaluations. Training never uses their starts."""


def baseline(arguments: Sequence[str]) -> None:
    """`pursuit baseline`."""
    default = BaselineCommand(default_task(options_in(arguments)))
    given = parse(BaselineCommand, arguments, "baseline", default)
    given.task.check_used()
    from train.commands.scores import print_scores
    from train.runs.parts import contest_of  # torch is slow to import

    contest = contest_of(given.task, given.episodes, given.seed)
    contest = contest.exactly().solved_up_to(MAX_EVALUATED_WORK)
    print(contest.line())
    print_scores(contest.baselines(), contest)
    for line in chain(contest.notes, contest.facts()):
        print(line)
