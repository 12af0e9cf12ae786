"""`pursuit evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from pursuit.replay import with_suffix
from train.commands.parse import heard, parse, warn
from train.commands.scores import (
    certificate_of,
    pays_of,
    print_bounds,
    print_floor,
    print_reference,
    print_scores,
)
from train.commands.suites import compared, exact_where_known, judged
from train.evaluation.arm_contest import ArmContest
from train.evaluation.closeups import recorded
from train.evaluation.contest import GameContest
from train.evaluation.floor import objective_floor
from train.evaluation.joint_contest import MAX_EVALUATED_WORK
from train.evaluation.suite_contest import SuiteContest
from train.evaluation.suite_report import summary_of
from train.files import reserved, write_json
from train.settings.checks import check
from train.settings.task import ReacherSettings, in_maze


@dataclass(frozen=True)
class EvaluateCommand:
    """Evaluate the policy of a run: exactly where the game allows it, by episodes elsewhere."""

    run: Annotated[Path, tyro.conf.Positional]
    """The folder of the run."""
    episodes: int = 1000
    """Episodes to play."""
    seed: int = 0
    """Of those episodes: 0 for those of every evaluation, or others; none is ever trained on."""
    opponent_epsilon: float | None = None
    """Share of random moves of the opponents; that of the training if left out."""
    maze: str | None = None
    """Another maze than that of the training, or a suite of mazes: suite:7x7-test. In a suite every
    score stands beside the exact optimum of that maze, and what is lost from the mazes of the
    training beside both."""
    table: Path | None = None
    """Of a suite: write the figures of every maze to this new .csv file."""
    picture: Path | None = None
    """Of a suite: draw the gap of every maze over its difficulty into this new .png file."""
    out: Path | None = None
    """Write the figures to this new .json file as well."""
    replays: Path | None = None
    """Write the first episodes, as the policy of the run plays them, to this new replay (.json)."""
    replay_episodes: int = 10
    """How many of them."""


def evaluate(arguments: Sequence[str]) -> None:
    """`pursuit evaluate`."""
    given = parse(EvaluateCommand, arguments, "evaluate")
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    check(given.run.is_dir(), f"{given.run}: no such folder")
    replays = None if given.replays is None else with_suffix(given.replays)
    check(given.replay_episodes >= 1, f"replay_episodes={given.replay_episodes}; at least 1")
    with reserved(*filter(None, (given.out, replays, given.table, given.picture))):
        carry_out(given, replays)


def carry_out(given: EvaluateCommand, replays: Path | None) -> None:
    """Evaluate as the options say, and write the files that they name."""
    from train.algorithms.registry import entry  # torch is slow to import
    from train.networks.policy import NO_WALLS
    from train.runs.loop import machine, versions
    from train.runs.opponents import load_policy
    from train.runs.parts import contest_of, suite_contest_of
    from train.runs.saved import load_settings
    from train.runs.single import evaluation_of

    with heard():
        settings, policy = load_settings(given.run), load_policy(given.run)
    if given.opponent_epsilon is not None:
        if isinstance(settings.task, ReacherSettings):
            raise ValueError(f"--opponent-epsilon, and {given.run} moves an arm; leave it out")
        task = replace(settings.task, opponent_epsilon=given.opponent_epsilon)
        settings = replace(settings, task=task)
    policies = {"learned": policy}
    if entry(settings.algorithm).learns_distribution:
        policies["learned, sampled"] = load_policy(given.run, greedy=False)
    training = settings.task
    if given.maze is not None:
        task = in_maze(training, f"--maze {given.maze}")
        settings = replace(settings, task=replace(task, maze=given.maze))
        if settings.observation in NO_WALLS:
            warn(f"{given.run} observes {settings.observation!r}, which shows no walls")
    contest = contest_of(settings.task, given.episodes, given.seed)
    if isinstance(contest, GameContest):
        contest = replace(contest, most_work=MAX_EVALUATED_WORK)
    more: dict[str, Any] = {}
    print(contest.line())
    if isinstance(contest, SuiteContest):
        contest = exact_where_known(contest, list(policies.values()))
        found = judged(contest, policies, given.table, given.picture)
        scores = [each.score(given.episodes) for each in found]
        more["suite"] = {each.name: summary_of(contest, each) for each in found}
        if given.maze is not None:
            own = suite_contest_of(training, given.episodes, given.seed, contest.exact)
            evaluated = "learned" if settings.evaluate == "greedy" else "learned, sampled"
            shown = next(each for each in found if each.name == evaluated)
            more["generalisation"] = compared(contest, shown, own, policies[evaluated])
    else:
        check(
            given.table is None and given.picture is None,
            "--table and --picture are of a suite of mazes; give --maze suite:7x7-test",
        )
        scores = [*contest.baselines(), *(contest.score(*each) for each in policies.items())]
        print_scores(scores, certificate_of(contest), pays_of(contest))
    if isinstance(contest, ArmContest):
        print_bounds(contest)
    floor = objective_floor(contest, settings.hyper.last_gamma)
    held = evaluation_of(scores, settings.evaluate, floor, certificate_of(contest), contest)
    print_reference(held["reference"], contest)
    print_floor(held["evaluation"], settings.hyper.last_gamma)
    if replays is not None:
        shown = load_policy(given.run, greedy=settings.evaluate == "greedy")
        games = {f"episode {number + 1}": number for number in range(given.replay_episodes)}
        path = recorded(contest, shown, games, settings.algorithm).save(replays)
        print(f"replays: {path}; watch them with: pursuit view {path}")
    if given.out is not None:
        same = ("algorithm", "curriculum", "seed")
        content = {
            **contest.describe(),
            **{name: getattr(settings, name) for name in same},
            **held,
            **more,
            "versions": versions(),
            "machine": machine(),
        }
        write_json(given.out, content)
