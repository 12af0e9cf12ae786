"""`pursuit baseline`: random, scripted and optimal agents on a task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

from pursuit.validation import at_least
from scripted_agents import why_not_team_chase
from scripted_agents.limits import MAX_EVALUATED_WORK, is_single_runner, why_no_tour
from scripted_agents.tours.tour import expected_tour_length, num_states
from train.commands.parse import options_in, parse
from train.commands.scores import print_bounds, print_scores, print_whole_game
from train.evaluation.arm_contest import ArmContest
from train.evaluation.contest import GameContest
from train.evaluation.suite_contest import SuiteContest
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
    from train.runs.parts import contest_of  # torch is slow to import

    contest = contest_of(given.task, given.episodes, given.seed)
    if isinstance(contest, SuiteContest):
        contest = replace(contest, exact=True)
    contest = contest.solved_up_to(MAX_EVALUATED_WORK)
    print(contest.line())
    scores = contest.baselines()
    print_scores(scores, contest)
    if isinstance(contest, ArmContest):
        print_bounds(contest)
    if not isinstance(contest, GameContest):
        return
    task = contest.task
    maze = task.mazes[0]
    if is_single_runner(task):
        if why_no_tour(task.num_goals) is None:
            mean = expected_tour_length(maze, task.num_goals)
            how = "exact" if mean.exact else f"±{mean.ci95:.2f}, sampled"
            print(f"mean optimal tour over all placements: {mean:.4f} ({how})")
        print(f"distinct states: {num_states(maze.num_cells, task.num_goals):,}")
    elif why_not_team_chase(task) is None:
        cells, chasers = maze.num_cells, task.num_chasers
        print(f"distinct states: {(cells - 1) ** chasers * cells:,}")
    elif len(task.mazes) == 1:
        print_whole_game(contest)
