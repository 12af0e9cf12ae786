"""`pursuit train`, `pursuit evaluate` and `pursuit render`."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import strftime
from typing import Annotated, Any, Generic, TypeVar

import tyro

from train.algorithms.registry import entry
from train.commands.main import parse
from train.commands.progress import ProgressLines
from train.commands.world import contest_line, print_scores
from train.evaluation.contest import Contest, Score
from train.runs.folder import load_checkpoint, load_settings, new_folder, write_json
from train.runs.pictures import draw_learning_curve, save_replay
from train.runs.run import (
    Run,
    contest_of,
    describe,
    load_policy,
    plan_of,
    resume_run,
    start_run,
)
from train.settings.algorithms import Hyperparameters
from train.settings.checks import check
from train.settings.presets import TUNED, hyperparameters, lessons_for, preset_algorithm
from train.settings.run import TaskSettings, TrainSettings

H = TypeVar("H", bound=Hyperparameters, covariant=True)


@dataclass(frozen=True)
class TrainCommand(Generic[H]):
    """Train one agent against scripted ones, and say how far it is from the exact optimum.

    The options of the algorithm's settings are those of --algorithm (ppo if left out), those of the
    curriculum's are those of --curriculum: `pursuit train --algorithm dqn --help` shows DQN's.
    """

    settings: TrainSettings[H]
    preset: str = TUNED
    """Where the algorithm's settings come from: tuned, or thesis-ppo, thesis-a2c, thesis-dqn."""
    out: Path | None = None
    """A new folder for the run; runs/TASK-ROLE-MAZE-TIME if left out."""
    resume: Path | None = None
    """Go on with the run in this folder instead; all other options are taken from there."""
    episodes: int = 1000
    """Episodes of the final evaluation."""


@dataclass(frozen=True)
class _First:
    """What is looked for first among the arguments: it decides what the other options are."""

    task: TaskSettings = field(default_factory=TaskSettings)
    algorithm: str | None = None
    preset: str = TUNED
    curriculum: str | None = None


def train(arguments: Sequence[str]) -> None:
    """`pursuit train`."""
    default = _defaults(arguments)
    form: Any = TrainCommand[type(default.settings.hyper)]  # type: ignore[misc]
    given: TrainCommand[Any] = parse(form, arguments, "train", default)
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    if given.resume is not None:
        check(given.resume.is_dir(), f"{given.resume}: no such folder")
        run = resume_run(given.resume)
    else:
        settings = given.settings
        task = settings.task
        name = f"{task.task}-{task.agent}-{Path(task.maze).stem}-{strftime('%Y%m%d-%H%M%S')}"
        run = start_run(settings, new_folder(given.out or Path("runs") / name))
    print(contest_line(run.contest))
    if run.teacher is not None:
        print(f"curriculum: {run.settings.curriculum}, over {run.teacher.describes}")
    print(f"folder: {run.folder}")
    with Watch() as watch:
        run.train(watch)
    finish(run, given.episodes)


def _defaults(arguments: Sequence[str]) -> TrainCommand[Any]:
    """The preset of the algorithm and task in the arguments, so that --help shows it as well.

    Raises:
        ValueError: an unknown algorithm or preset, or two that do not go together.
    """
    if any(argument in ("-h", "--help") for argument in arguments):
        arguments = [a for a in arguments if a not in ("-h", "--help")]
    first = _First()
    with (
        contextlib.suppress(SystemExit, ValueError),
        contextlib.redirect_stderr(io.StringIO()),  # errors are told when all is parsed
    ):
        first, _ = tyro.cli(
            _First,
            args=list(arguments),
            return_unknown_args=True,
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
        )
    algorithm = first.algorithm or preset_algorithm(first.preset) or "ppo"
    hyper = hyperparameters(algorithm, first.task.setting, first.preset)
    budget: dict[str, Any] = {"seconds": 60.0}
    if any(a == "--frames" or a.startswith("--frames=") for a in arguments):
        budget = {"frames": 1}
    curriculum, lessons = lessons_for(algorithm, first.task.setting, first.preset, first.curriculum)
    settings = TrainSettings(first.task, hyper, algorithm=algorithm, **budget)
    # Set behind the checks of the form: these are defaults, which the options may yet change.
    object.__setattr__(settings, "curriculum", curriculum)
    object.__setattr__(settings, "lessons", lessons)
    return TrainCommand(settings, first.preset)


class Watch(ProgressLines):
    """Shows a run as it learns."""

    def __call__(self, run: Run, row: dict[str, float]) -> None:
        """Report a rollout (an empty row) or an evaluation."""
        self.advance(run.progress)
        if not row:
            return
        parts = [
            f"{100 * run.progress:3.0f} %",
            f"{run.seconds:6.1f} s",
            f"{run.learner.frames / 1e6:7.2f} M frames",
            f"{row['frames_per_second'] / 1e3:5.1f} k/s",
        ]
        if "episode_return" in row:
            parts.append(f"return {row['episode_return']:7.2f}")
            parts.append(f"length {row['episode_length']:6.2f}")
        if "lesson" in row:
            parts.append(f"lesson {row['lesson']:5.2f}")
        parts.append(f"{run.settings.evaluate} {row['mean_steps']:6.2f} steps")
        if "optimality_gap" in row:
            parts.append(f"gap {100 * row['optimality_gap']:+7.2f} %")
        self.say(parts)


def finish(run: Run, episodes: int) -> None:
    """Evaluate, report, draw: what stands at the end of every run, interrupted or not."""
    if run.stopped:
        print(f"interrupted; go on with: pursuit train --resume {run.folder}", file=sys.stderr)
    content = run.results(episodes)
    print()
    print_scores([Score(**score) for score in content["scores"]])
    contest = contest_of(run.settings, episodes)
    title = f"{contest_line(contest).split(', at most')[0]}; {run.settings.algorithm.upper()}"
    teacher = run.teacher
    if teacher is not None:
        title += f"; {run.settings.curriculum}"
    draw_learning_curve(
        run.folder / "learning_curve.png",
        run.metrics.rows,
        content["scores"],
        title,
        teacher.rows if teacher is not None else None,
        teacher.describes if teacher is not None else "",
    )
    save_replay(run.folder / "replay.gif", contest, run.policy)
    evaluation = content["evaluation"]
    if evaluation["optimality_gap"] is not None:
        how = "exactly" if evaluation["exact"] else "on the same starts"
        print(
            f"\nlearned {evaluation['mean_steps']:.3f} steps, optimum "
            f"{evaluation['optimal_steps']:.3f} ({how}): gap "
            f"{100 * evaluation['optimality_gap']:+.2f} %"
        )
    print(f"results, curve and replay: {run.folder}")


@dataclass(frozen=True)
class EvaluateCommand:
    """Evaluate the policy of a run: exactly where the game allows it, by episodes elsewhere."""

    run: Annotated[Path, tyro.conf.Positional]
    """The folder of the run."""
    episodes: int = 1000
    """Episodes to play."""
    opponent_epsilon: float | None = None
    """Share of random moves of the opponents; that of the training if left out."""
    out: Path | None = None
    """Write the figures to this new .json file as well."""


def evaluate(arguments: Sequence[str]) -> None:
    """`pursuit evaluate`."""
    given = parse(EvaluateCommand, arguments, "evaluate")
    check(given.episodes >= 2, f"episodes={given.episodes}; at least 2")
    check(given.out is None or not given.out.exists(), f"{given.out}: exists already")
    settings, policy, contest = _load(given.run, given.opponent_epsilon, given.episodes)
    scores = [*contest.baselines(), contest.score("learned", policy)]
    if entry(settings.algorithm).learns_distribution:
        drawn = load_policy(given.run, greedy=False)
        scores.append(contest.score("learned, sampled", drawn))
    print(contest_line(contest))
    print_scores(scores)
    if given.out is not None:
        write_json(given.out, describe(settings, contest, scores))


def _load(
    folder: Path, epsilon: float | None, episodes: int
) -> tuple[TrainSettings[Any], Any, Contest]:
    check(folder.is_dir(), f"{folder}: no such folder")
    settings = load_settings(folder)
    if epsilon is not None:
        settings = replace(settings, task=replace(settings.task, opponent_epsilon=epsilon))
    return settings, load_policy(folder), contest_of(settings, episodes)


@dataclass(frozen=True)
class LevelsCommand:
    """The levels that a run with --curriculum level-replay or learnability kept, best first."""

    run: Annotated[Path, tyro.conf.Positional]
    """The folder of the run."""
    count: int = 3
    """How many."""


def levels(arguments: Sequence[str]) -> None:
    """`pursuit levels`."""
    from curricula import LevelReplay
    from pursuit.parallel_env import scene_of
    from pursuit.rendering import scene_to_text
    from pursuit.simulator import Simulator

    given = parse(LevelsCommand, arguments, "levels")
    check(given.run.is_dir(), f"{given.run}: no such folder")
    check(given.count >= 1, f"count={given.count}; at least 1")
    settings = load_settings(given.run)
    plan = plan_of(settings)
    curriculum = None if plan is None else plan.curriculum()
    if not isinstance(curriculum, LevelReplay):
        raise ValueError(
            f"{given.run}: curriculum {settings.curriculum!r} keeps no levels; level-replay and "
            "learnability do"
        )
    state = load_checkpoint(given.run)["teacher"]["curriculum"]
    curriculum.load_state_dict({k: getattr(v, "numpy", lambda v=v: v)() for k, v in state.items()})
    task = settings.task.build()
    for seed, score, wins, plays in curriculum.best(given.count):
        simulator = Simulator(task, 1, auto_restart=False)
        simulator.seed_starts(None, seed)
        simulator.reset()
        print(f"level {seed}: {curriculum.score} {score:.4g}, {wins} of {plays} episodes solved")
        print(scene_to_text(scene_of(simulator)))


@dataclass(frozen=True)
class RenderCommand:
    """A replay as GIF or MP4: of a run, or of the scripted agents on a task."""

    run: Annotated[Path | None, tyro.conf.Positional] = None
    """The folder of the run; the scripted agents play if left out."""
    task: TaskSettings = field(default_factory=TaskSettings)
    out: Path = Path("replay.gif")
    """A new .gif or .mp4 file."""
    episodes: int = 3
    """Episodes to show."""
    optimal: bool = False
    """Show the exactly optimal agent instead of the learned or scripted one."""


def render(arguments: Sequence[str]) -> None:
    """`pursuit render`."""
    from scripted_agents import TablePolicy, TourRunner
    from scripted_agents.environments import DEFAULTS

    given = parse(RenderCommand, arguments, "render")
    check(given.episodes >= 1, f"episodes={given.episodes}; at least 1")
    check(not given.out.exists(), f"{given.out}: exists already; give a new file")
    policy: Any
    if given.run is not None:
        _, policy, contest = _load(given.run, None, 2)
    else:
        task = given.task.build()
        contest = Contest(task, given.task.agent, given.task.opponents(), 2)
        policy = DEFAULTS[contest.role](0.0)
    if given.optimal:
        best = contest.best_response()
        check(
            best is not None or contest.role == "runner",
            "the optimum of this task is not known; leave out --optimal",
        )
        maze = contest.task.mazes[0]
        policy = TourRunner() if best is None else TablePolicy(maze, best.policy)
    save_replay(given.out, contest, policy, given.episodes)
    print(f"{given.out}: {given.episodes} episode(s)")
