"""`pursuit train`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from train.commands.config import print_config, with_config
from train.commands.help import asks_help, print_help
from train.commands.parse import default_budget, options_in, parse, parse_known
from train.commands.run_options import RunCommand, check_resumed
from train.files import Plain
from train.runs.unused_settings import unused_settings
from train.settings.algorithms import Hyperparameters
from train.settings.defaults import default_settings
from train.settings.presets import TUNED, preset_task
from train.settings.run import AgentSettings, TrainSettings
from train.settings.task_form import AnyTask, default_task

if TYPE_CHECKING:
    from train.runs.loop import Run
    from train.runs.single import SingleAgent

H = TypeVar("H", bound=Hyperparameters, covariant=True)


@dataclass(frozen=True)
class TrainCommand(RunCommand, Generic[H]):
    """Train one agent, or all of a role (--algorithm ippo, mappo, iql, vdn or qmix), against fixed
    opponents, or an arm, and compare the result with the exact optimum.

    Options depend on --task (default: chase), --algorithm (default: ppo) and --curriculum (default:
    none). For example `pursuit train --task reacher --algorithm td3 --help-all` lists those of an
    arm and of TD3.
    """

    settings: TrainSettings[H]
    preset: str = TUNED
    """Hyperparameters: tuned, thesis-ppo, thesis-a2c or thesis-dqn; for the arm thesis-ddpg,
    thesis-td3 or thesis-reacher-ppo. Or sisl-pursuit: the default game of PettingZoo's pursuit_v5
    (maze, agents, rules, rewards, observation) with hyperparameters for it, of ippo (the default)
    or mappo."""


@dataclass(frozen=True)
class _First:
    """Options that are parsed first, as they determine the other options."""

    task: AnyTask = field(default_factory=lambda: default_task({}))
    algorithm: str | None = None
    preset: str = TUNED
    curriculum: str | None = None
    recurrent: str | None = None
    gamma: float | None = None
    frames: int | None = None
    num_games: int | None = None
    rollout_steps: int | None = None
    minibatch_size: int | None = None


def train(arguments: Sequence[str]) -> None:
    """`pursuit train`."""
    check_resumed(arguments)
    given = with_config(arguments, parsed)
    from train.commands.progress import quietly

    with quietly(given.quiet):
        carry_out(given, arguments)


def carry_out(given: TrainCommand[Hyperparameters], arguments: Sequence[str]) -> None:
    """Train, and print the progress and the results."""
    from train.commands.progress import finish_run, start_or_resume
    from train.runs.folder import RUN

    settings = given.settings
    started, final = start_or_resume(RUN, settings, given, arguments, settings.task.label)
    run = cast("Run[SingleAgent]", started)
    trainee = run.trainee
    print(trainee.contest.line())
    if not trainee.parts.algorithm.whole_role and (hint := trainee.parts.settings.task.hint()):
        print(hint)
    if trainee.update_form is not None:
        print(f"update: {trainee.update_form}")
    if trainee.teacher is not None:
        print(f"curriculum: {trainee.teacher.name}, over {trainee.teacher.describes}")
    content = finish_run(run, final, "pursuit train", present if given.report else None)
    show(run, content)


def parsed(arguments: Sequence[str]) -> TrainCommand[Hyperparameters]:
    """The command in `arguments`; ValueError for unknown options or invalid values."""
    default = _defaults(arguments)
    if asks_help(arguments):
        task = parse_known(default.settings.task, arguments)
        unused = unused_settings(replace(default.settings, task=task))
        print_help("train", default, options_in(arguments), unused)
    form: Any = TrainCommand[type(default.settings.hyper)]  # type: ignore[misc]
    given: TrainCommand[Hyperparameters] = parse(form, arguments, "train", default)
    if given.print_config:
        print_config(given.settings, given, default)
    return given


def _defaults(arguments: Sequence[str]) -> TrainCommand[Hyperparameters]:
    """The command with the preset for the algorithm and task in the arguments, also for --help.

    Raises:
        ValueError: an unknown algorithm or preset, or a preset of another algorithm.
    """
    options = options_in(arguments)
    task = default_task(options)
    of_preset = preset_task(options.get("preset", TUNED), type(task), options.get("task"))
    task = replace(task, **of_preset)
    first = parse_known(_First(task), arguments)
    found = {**default_settings(**vars(first)), "task": task}
    settings: AgentSettings = TrainSettings(**found, **default_budget(options, 60.0))
    return TrainCommand(settings, first.preset)


def present(run: Run[SingleAgent], content: Plain) -> None:
    """Write the figures, the report and the replay of a run; as `Run.present`."""
    from pursuit.rendering.animation import save_animation
    from train.runs.folder import CURVE, REPLAY
    from train.runs.pictures import draw_learning_curve
    from train.runs.report import write_report
    from train.runs.saved import load_settings

    trainee, folder, settings = run.trainee, run.folder, load_settings(run.folder)
    contest, teacher = trainee.contest, trainee.teacher
    title = f"{contest.line().split(', at most')[0]}; {content['algorithm'].upper()}"
    if teacher is not None:
        title += f"; {teacher.name}"
    draw_learning_curve(
        folder / CURVE,
        run.rows,
        content["scores"],
        title,
        teacher.rows if teacher is not None else None,
        teacher.describes if teacher is not None else "",
        trainee.objective,
        settings.budget_unit,
    )
    save_animation(folder / REPLAY, contest.scenes(trainee.policy))
    final = trainee.final_contest(content["evaluation"]["episodes"])
    write_report(folder, settings, final, trainee.policy, content)


def show(run: Run[SingleAgent], content: Plain) -> None:
    """Print the results of a run."""
    from train.commands.progress import print_end
    from train.commands.scores import print_objective_gap, print_reference, print_scores, print_team
    from train.evaluation.scores import Score
    from train.runs.folder import REPORT
    from train.runs.report import describe_loops, headline, of_solved

    trainee = run.trainee
    print()
    scores = [Score(**score) for score in content["scores"]]
    print_scores(scores, trainee.contest)
    for line in trainee.contest.notes:
        print(line)
    evaluation, settings = content["evaluation"], trainee.parts.settings
    column = content["objective"]["column"]
    if evaluation["optimality_gap"] is not None and column == "mean_steps":
        how = "exactly" if evaluation["exact"] else "on the same starts"
        print(
            f"\nlearned{trainee.contest.beside} {evaluation['mean_steps']:.3f} steps, optimum "
            f"{evaluation['optimal_steps']:.3f} ({how}): gap "
            f"{100 * evaluation['optimality_gap']:+.2f} %{of_solved(evaluation)}"
        )
    has_memory = settings.frame_stack > 1 or settings.hyper.recurrent is not None
    if settings.evaluate == "greedy" and not has_memory and (advice := describe_loops(content)):
        print(advice)
    if column != "mean_steps":
        print(f"\n{headline(content)}")
    print_reference(content.get("reference", {}), trainee.final_contest(evaluation["episodes"]))
    print_team(content)
    print_objective_gap(evaluation, trainee.parts.hyper.last_gamma)
    files = "results" if run.present is None else f"results, curve, replay and {REPORT}"
    print_end(files, run.folder, content)
