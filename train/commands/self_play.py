"""`pursuit self-play`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, cast, get_type_hints

import tyro

from pursuit.validation import check
from train.commands.config import print_config, with_config
from train.commands.help import asks_help, print_help
from train.commands.parse import default_budget, names_in, options_in, parse, parse_known
from train.commands.run_options import RunCommand, check_resumed
from train.files import Plain
from train.runs.unused_settings import unused_settings
from train.self_play.learners import checked_names, learning_side, sides_of, unchecked_self_play
from train.settings.algorithms import Hyperparameters
from train.settings.reading import names_of
from train.settings.self_play import LEARN, LearningSide, SelfPlayBase, self_play_form
from train.settings.task_form import AnyTask, default_task

ALGORITHM = (
    "Algorithm of all sides, one that supports self-play: ppo, a2c, dqn, mmd, rnad, nfsp, or "
    "package.module:Name."
)
Suppressed: Any = Annotated[Any, tyro.conf.Suppress]
SIDE = (
    "learn, or the fixed policy of {}: {}, the folder of a run, or package.module:Name of a "
    "user-defined policy."
)


def with_defaults(task: AnyTask) -> AnyTask:
    """The settings of a task whose default values are these, without those that sides replace."""
    form, make = type(task), cast("Any", make_dataclass)
    own = [
        (name, Suppressed, field(default=getattr(task, name)))
        for name in (form.AGENT, "opponent")
        if name in names_of(form)
    ]
    made = make(form.__name__, own, bases=(form,), namespace={"__doc__": form.__doc__}, frozen=True)
    return made(**vars(task))


def options_of(task: AnyTask, roles: Sequence[str], budget: Plain) -> Any:
    """The options of self-play in a task, with one for each side; not checked."""
    whole, make = self_play_form(type(task)), cast("Any", make_dataclass)
    texts = {"algorithm": ALGORITHM}
    texts |= {role: SIDE.format(role, ", ".join(task.AGENTS)) for role in roles}
    own: list[Any] = [("task", type(task), field(default=task))]
    own += [
        (name, Annotated[str, tyro.conf.arg(help=text)], field(default=default))
        for name, text in texts.items()
        for default in ["ppo" if name == "algorithm" else LEARN]
    ]
    if "players" in {each.name for each in fields(whole)}:
        own.append(("players", Suppressed, field(default=None)))
    free = {"__post_init__": lambda self: None, "__doc__": "The settings of a run of self-play."}
    form = make("Options", own, bases=(whole,), namespace=free, frozen=True, kw_only=True)
    return form(observation=task.OBSERVATION, **budget)


if TYPE_CHECKING:
    from train.runs.loop import Run
    from train.self_play.trainee import SelfPlay


@dataclass(frozen=True)
class SelfPlayCommand(RunCommand):
    """Train chasers and evaders against each other, with exact exploitability at every evaluation.

    Each role plays against the latest policy of the other role, or with another --sampling against
    its snapshots. To compare settings over several seeds: `pursuit sweep self_play_sampling`.

    Algorithm and hyperparameters apply to both sides. With "chaser." or "evader." before the name,
    they apply to one side only: --chaser.entropy-coef 0.05 --evader.algorithm dqn
    --evader.batch-size 64.

    With --game NAME the players of a small game learn, and their names take the place of chaser and
    evader: `pursuit self-play --game soccer --help`.
    """

    settings: Any
    hyper: Any
    other_algorithm: Any


def self_play(arguments: Sequence[str]) -> None:
    """`pursuit self-play`."""
    check_resumed(arguments)
    given, settings = with_config(arguments, parsed)
    if given.resume is None:
        settings.task.build()  # its errors come before the slow imports
    from train.commands.progress import quietly

    with quietly(given.quiet):
        carry_out(given, settings, arguments)


def carry_out(given: SelfPlayCommand, settings: SelfPlayBase, arguments: Sequence[str]) -> None:
    """Train, and print the progress and the results."""
    from train.commands.progress import finish_run, start_or_resume
    from train.evaluation.self_play_text import describe_mixing
    from train.runs.folder import SELF_PLAY

    label = f"self-play-{settings.task.game_label}"
    started, final = start_or_resume(SELF_PLAY, settings, given, arguments, label)
    run = cast("Run[SelfPlay]", started)
    print(f"self-play: {run.trainee.game.line()}; opponents: {run.trainee.settings.sampling}")
    for line in describe_mixing(run.trainee.game.mixed_share()):
        print(line)
    drawn = present if given.report else None
    content = finish_run(run, final, "pursuit self-play", drawn)
    show(run, content)


def parsed(arguments: Sequence[str]) -> tuple[SelfPlayCommand, SelfPlayBase]:
    """The command in `arguments`, and the settings.

    Raises:
        ValueError: unknown options or invalid values.
    """
    options = options_in(arguments)
    budget, flat = default_budget(options, 120.0), Plain()
    default = default_task(options)
    roles = sides_of(default)
    checked_names(options, roles)
    default = with_defaults(replace(default, **default.for_self_play(options)))
    task = parse_known(default, arguments)
    settings = options_of(default, roles, budget)
    for name in (task.AGENT, "opponent"):
        sided = " or ".join(f"--{role}" for role in roles)
        check(name not in options, f"--{name} is for `pursuit train`; use {sided}")
    sides: dict[str, LearningSide] = {}
    for role in roles:
        arguments, own = split_side(role, arguments)
        if options.get(role, LEARN) == LEARN:
            chosen = options.get(f"{role}.algorithm", options.get("algorithm", "ppo"))
            sides[role] = learning_side(role, task, {}, {"algorithm": chosen})
            flat[role] = parsed_side(role, sides[role], own)
        else:
            flat |= {f"{role}.{name}": value for name, value in options_in(own).items()}
    shown = [*sides.values()] or [LearningSide()]
    hyper, others = shown[0].hyper, other_options(shown[-1], shown[0].hyper)
    whole = SelfPlayCommand(settings, unchecked(hyper), others)
    if asks_help(arguments):
        print_help("self-play", whole, options, unused_settings(replace(settings, task=task)))
    given = parse(SelfPlayCommand, arguments, "self-play", whole)
    for part in (given.other_algorithm, given.hyper, given.settings, given.settings.task):
        flat |= given_in(arguments, part)
    if not {"seconds", "frames"} & set(flat):
        flat["seconds"] = settings.seconds
    found = unchecked_self_play(**flat)
    if given.print_config:
        learning = [(role, found.side(role), sides[role]) for role in found.learning]
        print_config(found, given, whole, learning)
    return given, found


def split_side(role: str, arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments without the options of one side, and these without the role."""
    parts: dict[bool, list[str]] = {False: [], True: []}
    prefix, own = f"{role}.", False
    for argument in arguments:
        option = argument.startswith("--")
        own = argument.replace("-", "_")[2:].startswith(prefix) if option else own
        parts[own].append(f"--{argument[2 + len(prefix) :]}" if own and option else argument)
    return parts[False], parts[True]


def parsed_side(role: str, side: LearningSide, arguments: Sequence[str]) -> Plain:
    """The given settings of one side, by name; ValueError naming the role."""
    default = unchecked(side.hyper, ("algorithm", str, field(default=side.algorithm)))
    try:
        return given_in(arguments, parse(type(default), arguments, "self-play", default))
    except ValueError as error:
        raise ValueError(f"{role}: {error}") from None


def unchecked(hyper: Hyperparameters, *more: Any) -> Any:
    """The same settings and more fields as a dataclass without checks, which need all options."""
    form, own = type(hyper), {"__post_init__": lambda self: None, "__doc__": type(hyper).__doc__}
    make: Any = make_dataclass
    made = make(form.__name__, more, bases=(form,), namespace=own, frozen=True)
    return made(**vars(hyper))


def given_in(arguments: Sequence[str], options: object) -> Plain:
    """The values of those options, fields of a dataclass, that are in the arguments."""
    names = names_in(arguments)
    return {name: value for name, value in vars(options).items() if name in names}


def other_options(side: LearningSide, hyper: Hyperparameters) -> object:
    """A dataclass with the options of a side's algorithm that `hyper` does not have."""
    hints = get_type_hints(type(side.hyper))
    help_text = f"See --algorithm {side.algorithm} --help-all."
    options = [
        (f.name, Annotated[hints[f.name], tyro.conf.arg(help=help_text)],
         field(default=getattr(side.hyper, f.name)))
        for f in fields(side.hyper)
        if f.name not in vars(hyper)
    ]  # fmt: skip
    return make_dataclass("Others", options, namespace={"GROUP": "Learner"}, frozen=True)()


def present(run: Run[SelfPlay], content: Plain) -> None:
    """Write the figures, the tables and the report; as `Run.present`."""
    from train.runs.folder import CURVE
    from train.self_play.report import draw_self_play, title_of, write_self_play_report

    trainee, folder = run.trainee, run.folder
    draw_self_play(folder / CURVE, trainee, run.rows, title_of(content))
    write_self_play_report(folder, trainee, content)
    for stem, table in trainee.game.files(content).items():
        table.write(folder, stem)


def show(run: Run[SelfPlay], content: Plain) -> None:
    """Print the results."""
    from train.commands.progress import print_end
    from train.reports.tables import print_table
    from train.runs.folder import REPORT

    game = run.trainee.game
    for each in game.tables(content):
        print(f"\n{each.head}" if each.head else "")
        print_table(each.table, 100)
        if each.legend:
            print(each.legend)
    print("", *game.describe(content), sep="\n")
    files = f"results{'' if run.present is None else f', curve and {REPORT}'}"
    print_end(files, run.folder, content)
