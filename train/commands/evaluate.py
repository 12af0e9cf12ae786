"""`pursuit evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from pursuit.replay import with_suffix
from train.algorithms.registry import entry
from train.commands.parse import heard, parse
from train.commands.scores import print_bounds, print_floor, print_scores
from train.evaluation.arm_contest import ArmContest
from train.evaluation.closeups import recorded
from train.evaluation.floor import objective_floor
from train.files import write_json
from train.runs.loop import machine, versions
from train.runs.opponents import load_policy
from train.runs.parts import contest_of
from train.runs.saved import load_settings
from train.runs.single import evaluation_of
from train.settings.checks import check
from train.settings.task import ReacherSettings


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
    for path in filter(None, (given.out, replays)):
        check(not path.exists(), f"{path}: exists already")
    check(given.replay_episodes >= 1, f"replay_episodes={given.replay_episodes}; at least 1")
    with heard():
        settings, policy = load_settings(given.run), load_policy(given.run)
    if given.opponent_epsilon is not None:
        if isinstance(settings.task, ReacherSettings):
            raise ValueError(f"--opponent-epsilon, and {given.run} moves an arm; leave it out")
        task = replace(settings.task, opponent_epsilon=given.opponent_epsilon)
        settings = replace(settings, task=task)
    contest = contest_of(settings.task, given.episodes, given.seed)
    scores = [*contest.baselines(), contest.score("learned", policy)]
    if entry(settings.algorithm).learns_distribution:
        sampled = load_policy(given.run, greedy=False)
        scores.append(contest.score("learned, sampled", sampled))
    print(contest.line())
    print_scores(scores)
    if isinstance(contest, ArmContest):
        print_bounds(contest)
    floor = objective_floor(contest, settings.hyper.gamma)
    print_floor(floor, settings.hyper.gamma)
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
            **evaluation_of(scores, settings.evaluate, floor),
            "versions": versions(),
            "machine": machine(),
        }
        write_json(given.out, content)
