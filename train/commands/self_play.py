"""`pursuit self-play`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_type_hints

import tyro

from pursuit.validation import check
from train.commands.parse import default_budget, options_in, parse, parse_known
from train.commands.progress import (
    RunCommand,
    check_resumed,
    finish_run,
    start_or_resume,
)
from train.evaluation.scores import OUTCOMES, UNTIL_CAPTURE
from train.files import Plain
from train.reports.tables import print_table
from train.runs.folder import CURVE, REPORT, SELF_PLAY
from train.self_play.learners import checked_names, learning_side, players_of, unchecked_self_play
from train.settings.algorithms import Hyperparameters
from train.settings.self_play import (
    LEARN,
    ROLES,
    LearningSide,
    PlayedTask,
    SelfPlayBase,
    SelfPlaySettings,
    SmallGameSelfPlay,
    default_rewards,
)
from train.settings.task import SmallGameSettings, TaskSettings, task_form


@dataclass(frozen=True)
class Game(TaskSettings):
    """A game in mazes, and the opponents in it."""

    role: tyro.conf.Suppress[str] = "auto"
    opponent: tyro.conf.Suppress[str | None] = None


@dataclass(frozen=True)
class SmallGame(SmallGameSettings):
    """A small game, whose states are all enumerated."""

    player: tyro.conf.Suppress[str] = "auto"
    opponent: tyro.conf.Suppress[str] = "uniform"


@dataclass(frozen=True)
class Options(SelfPlaySettings):
    """The settings of a run of self-play."""

    task: TaskSettings = field(default_factory=lambda: Game(rewards="zero_sum"))
    chaser: str = LEARN
    """learn, or the fixed policy of the chasers: astar, random, uniform, equilibrium,
    searching (or sweeping, belief), the folder of a run, or package.module:Name of a
    user-defined policy."""
    evader: str = LEARN
    """learn, or the fixed policy of the evaders."""
    algorithm: str = "ppo"
    """Algorithm of both sides, one that supports self-play: ppo, a2c, dqn, mmd, rnad, nfsp, or
    package.module:Name."""

    def __post_init__(self) -> None:
        pass


@dataclass(frozen=True, kw_only=True)
class SmallGameOptions(SmallGameSelfPlay):
    """The settings of a run of self-play in a small game; the sides of the players are added."""

    task: SmallGame
    algorithm: str = "ppo"
    """Algorithm of all players, one that supports self-play: ppo, a2c, dqn, mmd, rnad, nfsp, or
    package.module:Name."""

    players: tyro.conf.Suppress[Any] = None
    """Not used: the players are options of their own."""

    def __post_init__(self) -> None:
        pass


def small_game_options(game: str, roles: Sequence[str], budget: Plain) -> Any:
    """The options of self-play in a small game, with one for each player."""
    text = (
        "learn, or the fixed policy of {}: uniform, equilibrium, the folder of a run, or "
        "package.module:Name of a function of a state that returns probabilities."
    )
    sides = [
        (role, Annotated[str, tyro.conf.arg(help=text.format(role))], field(default=LEARN))
        for role in roles
    ]
    make: Any = make_dataclass
    form = make("Options", sides, bases=(SmallGameOptions,), frozen=True, kw_only=True)
    form.__doc__ = SmallGameOptions.__doc__
    return form(task=SmallGame(game=game), **budget)


if TYPE_CHECKING:
    from train.runs.loop import Run
    from train.self_play.trainee import SelfPlay


@dataclass(frozen=True)
class SelfPlayCommand(RunCommand):
    """Train chasers and evaders against each other, with exact exploitability at every evaluation.

    Each role plays against the latest policy of the other role, or with another --sampling against
    its snapshots. To compare settings over several seeds: `pursuit sweep self_play_sampling`.

    Algorithm and hyperparameters (--algorithm, and all under "hyper options") apply to both sides.
    With "chaser." or "evader." before the name, they apply to one side only:
    --chaser.entropy-coef 0.05 --evader.algorithm dqn --evader.batch-size 64.

    With --game NAME the players of a small game learn, and their names take the place of chaser and
    evader: `pursuit self-play --game soccer --help`.
    """

    settings: Any
    hyper: Any
    other_algorithm: Any


def self_play(arguments: Sequence[str]) -> None:
    """`pursuit self-play`."""
    check_resumed(arguments)
    given, settings = parsed(arguments)
    played = settings.task
    where = Path(played.maze).stem if isinstance(played, TaskSettings) else played.label
    started, final = start_or_resume(SELF_PLAY, settings, given, f"self-play-{where}")
    from train.self_play.mixing import describe_mixing, known_mixed_share  # torch is slow to import

    run = cast("Run[SelfPlay]", started)
    print(f"self-play: {run.trainee.line()}; opponents: {run.trainee.settings.sampling}")
    for line in describe_mixing(known_mixed_share(run.trainee.task, run.trainee.parts.discount)):
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
    task: PlayedTask
    if task_form(options) is SmallGameSettings:
        task = parse_known(SmallGame(game=options.get("game", "")), arguments)
        roles, unused = players_of(task), ("player", "opponent")
        settings = small_game_options(task.game, roles, budget)
    else:
        checked_names(options)
        roles, unused = ROLES, ("role", "opponent")
        rewards = default_rewards(options)
        task = parse_known(Game(rewards=rewards), arguments)
        settings = Options(task=Game(rewards=rewards), **budget)
    for name in unused:
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
    default = SelfPlayCommand(settings, unchecked(hyper), others)
    given = parse(SelfPlayCommand, arguments, "self-play", default)
    for part in (given.other_algorithm, given.hyper, given.settings, given.settings.task):
        flat |= given_in(arguments, part)
    if not {"seconds", "frames"} & set(flat):
        flat["seconds"] = settings.seconds
    return given, unchecked_self_play(**flat)


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
    names = {name.removeprefix("no_") for name in options_in(arguments)} | {*options_in(arguments)}
    return {name: value for name, value in vars(options).items() if name in names}


def other_options(side: LearningSide, hyper: Hyperparameters) -> object:
    """A dataclass with the options of a side's algorithm that `hyper` does not have."""
    hints = get_type_hints(type(side.hyper))
    help_text = f"See --algorithm {side.algorithm} --help."
    options = [
        (f.name, Annotated[hints[f.name], tyro.conf.arg(help=help_text)],
         field(default=getattr(side.hyper, f.name)))
        for f in fields(side.hyper)
        if f.name not in vars(hyper)
    ]  # fmt: skip
    return make_dataclass("Others", options, frozen=True)()


def present(run: Run[SelfPlay], content: Plain) -> None:
    """Write the figures, the tables and the report; as `Run.present`."""
    from train.self_play.payoffs import matches_table  # torch is slow to import
    from train.self_play.report import draw_self_play, title_of, write_self_play_report
    from train.self_play.small_game_report import draw_curve, write_small_game_report
    from train.self_play.small_games import SmallGamePlay

    trainee, folder, unit = run.trainee, run.folder, run.trainee.settings.budget_unit
    if isinstance(trainee, SmallGamePlay):
        draw_curve(folder / CURVE, run.rows, content, unit)
        write_small_game_report(folder, trainee, content)
        return
    draw_self_play(folder / CURVE, run.rows, title_of(content), unit)
    write_self_play_report(folder, trainee, content)
    matches_table(content["matches"]).write(folder)


def show(run: Run[SelfPlay], content: Plain) -> None:
    """Print the results."""
    from train.self_play.payoffs import legend_of, matches_table
    from train.self_play.report import describe_exploitability
    from train.self_play.small_game_report import describe_small_game, returns_table
    from train.self_play.small_games import SmallGamePlay

    if isinstance(run.trainee, SmallGamePlay):
        print()
        print_table(returns_table(content), 100)
        print("", *describe_small_game(content), sep="\n")
        print(f"results{'' if run.present is None else f', curve and {REPORT}'}: {run.folder}")
        return
    matches = content["matches"]
    exact = not any(row["games"] for row in matches)
    exits = any("outcome" in row for row in matches)
    print(
        f"\n{(OUTCOMES if exits else UNTIL_CAPTURE).unit}, at most {run.trainee.task.max_steps} "
        f"({'exact' if exact else 'sampled' if exits else '± is the 95 % interval'}); "
        "rows: chasers, columns: evaders"
    )
    print_table(matches_table(matches), 100)
    players = {row[role] for row in matches for role in ROLES}
    print(legend_of(players, run.trainee.settings.task.opponent_epsilon))
    print("", *describe_exploitability(content), sep="\n")
    drawn = "" if run.present is None else f", curve, table and {REPORT}"
    print(f"results{drawn}, pool: {run.folder}")
