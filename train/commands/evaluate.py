"""`pursuit evaluate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pursuit.observations.custom import without_id
from pursuit.plugins import reading
from pursuit.validation import Missing, at_least, check, choice, need
from scripted_agents.exact.limits import MAX_EVALUATED_WORK
from scripted_agents.exact.long_work import in_time
from train.commands.parse import options_in, parse, warn
from train.commands.progress import ProgressLine
from train.files import Plain, check_folder, reserved, write_json
from train.reports.tables import ResultTable, numeric, print_table, words
from train.settings.checks import Settings, Shown, check_default, evaluation_seed
from train.settings.task import AGENT, TaskSettings
from train.settings.task_form import AnyTask, default_task, with_values

if TYPE_CHECKING:
    from pursuit.simulator.policy import Policy
    from train.evaluation.scores import AnyContest, Score

OPPONENT = ("opponent", "opponent_policy", "opponent_epsilon")
"""Options of the opponents."""
EVERYWHERE = ("run", "at", "episodes", "seed", "out", "overwrite")
"""Options of all evaluations of runs."""


@dataclass(frozen=True)
class Evaluated(Settings):
    """Options of all evaluations."""

    run: Annotated[Path, tyro.conf.Positional]
    """The folder of the run, or an exported policy (.onnx) or a saved Stable-Baselines3 model
    (.zip) with other options: see pursuit evaluate model.zip --help."""
    episodes: Annotated[int, at_least(2)] = 1000
    """Episodes to play."""
    exact_seconds: Annotated[float | None, at_least(0)] = None
    """Seconds that exact solutions of games of several agents in one maze may take; 0 for none.
    Those that take about a second are always made. None: no limit."""
    seed: int | None = None
    """Seed of these episodes. None: 0 as in all evaluations, 1 with --at best, so that starts are
    not those that chose it. Training never uses their starts."""
    table: Path | None = None
    """For a suite of mazes: write the results by maze to this new .csv file."""
    out: Path | None = None
    """Write the results to this new .json file."""
    replays: Path | None = None
    """Write the first episodes of the policy to this new replay (.json)."""
    replay_episodes: Shown = 10
    """Number of episodes in the replay."""
    overwrite: bool = False
    """Replace --out, --replays and --table if they exist."""


@dataclass(frozen=True)
class EvaluateCommand(Evaluated):
    """Evaluate the policy of a run, exactly if possible, otherwise by sampled episodes.

    Of self-play give the folder of one side, such as runs/pair/chaser; the whole run gives the
    policies of all sides against each other, with NashConv where it is known.
    """

    at: str | None = None
    """The policy that was kept at so many frames (--checkpoints, or the snapshots of self-play), or
    best: that with the best evaluation during training, which is scored on other starts."""
    opponent: Annotated[str | None, AGENT] = None
    """Other opponents, as for `pursuit train`. None: those of training; for one side of self-play
    the other sides of the run."""
    teammates: Annotated[str | None, choice("learned", "scripted")] = None
    """The other agents of the same role: learned, so that the whole team is evaluated, or scripted.
    None: learned if the run trained the whole team, as self-play does, otherwise scripted."""
    opponent_policy: Annotated[str | None, choice("sampled", "greedy")] = None
    """Policy of learned opponents: sampled or greedy; by default that of training, or sampled for
    self-play."""
    opponent_epsilon: float | None = None
    """Probability of random moves of the opponents; by default that of the end of training, or 0
    for self-play."""
    maze: str | None = None
    """Another maze than in training, or a suite of mazes such as suite:7x7-test. In a suite results
    are compared with the exact optimum of each maze, and with those in the training mazes."""
    env: Annotated[str | None, choice("pursuit_v5")] = None
    """pursuit_v5: play chasers trained with --preset sisl-pursuit inside PettingZoo's environment
    of this name, with its defaults, from its observations (0.3 to 1.5 s an episode)."""


@dataclass(frozen=True)
class EvaluateModelCommand(Evaluated):
    """Evaluate an exported policy (.onnx) or a saved Stable-Baselines3 model (.zip) in a task,
    exactly if possible, otherwise by sampled episodes."""

    task: AnyTask = field(default_factory=TaskSettings)
    observation: str = "one_hot"
    """The observation of the model. The metadata of an exported policy, and a description file of
    the model, have precedence."""


def evaluate(arguments: Sequence[str]) -> None:
    """`pursuit evaluate`."""
    pairs = zip(["", *arguments], arguments, strict=False)
    names = [own for option, own in pairs if option != "--opponent" and not own.startswith("--")]
    is_model = any(name.endswith((".onnx", ".zip")) for name in names)
    form: Any = EvaluateModelCommand if is_model else EvaluateCommand
    task = default_task(options_in(arguments)) if is_model else None
    default = None if task is None else EvaluateModelCommand(Path(), task=task)
    given: EvaluateCommand | EvaluateModelCommand = parse(form, arguments, "evaluate", default)
    if isinstance(given, EvaluateCommand):
        check_folder(given.run)
    from pursuit.replays.replay import with_suffix
    from train.runs.folder import SELF_PLAY, read_config

    if given.replays is None:
        check_default(given, Evaluated, ["replay_episodes"], "it is an option of --replays")
    replays = None if given.replays is None else with_suffix(given.replays)
    outputs = (given.out, replays, given.table)
    with reserved(*outputs, overwrite=given.overwrite, inputs=[given.run]):
        if isinstance(given, EvaluateCommand) and read_config(given.run)[0] == SELF_PLAY:
            content = evaluate_players(given)
        elif isinstance(given, EvaluateCommand) and given.env is not None:
            content = evaluate_in_pursuit_v5(given)
        else:
            content = evaluate_and_print(given, replays)
        if given.out is not None:
            from train.machine import machine, versions  # torch is slow to import

            write_json(given.out, {**content, "versions": versions(), "machine": machine()})


def seed_of(given: EvaluateCommand | EvaluateModelCommand) -> int:
    """The seed of the episodes."""
    from train.runs.folder import BEST

    is_best = isinstance(given, EvaluateCommand) and given.at == BEST
    return int(is_best) if given.seed is None else given.seed


def check_others(given: EvaluateCommand, why: str, *more: str) -> None:
    """ValueError for an option that is neither in `EVERYWHERE` nor one of `more`."""
    names = [own.name for own in fields(given) if own.name not in {*EVERYWHERE, *more}]
    check_default(given, EvaluateCommand, names, why)


def evaluate_players(given: EvaluateCommand) -> Plain:
    """Print the evaluation of a whole run of self-play, exact if possible; the results."""
    why = f"{given.run} is a whole run of self-play, in which every player plays its own policy"
    check_others(given, why)
    from train.evaluation.sides import Profile, ResultLimits
    from train.runs.folder import CONFIG, read_config
    from train.runs.opponents import policy_of  # torch is slow to import
    from train.runs.provenance import check_parts
    from train.self_play.parts import game_of_all, self_play_from_plain

    config, plain = given.run / CONFIG, read_config(given.run)[1]
    plain["sampling"] = "latest"  # that of the training may be a rule that is not here
    check_parts(config, plain)
    with reading(config):
        settings = self_play_from_plain(plain, str(config))
    game, run = game_of_all(settings.task, settings.discount), str(given.run)
    at = dict.fromkeys(settings.learning, given.at)
    players = {
        name: policy_of(settings.task, run, game.task, name, at=at.get(name))
        for name in settings.sides
    }
    profile = Profile(players, (), seed=evaluation_seed(seed_of(given)))
    found = game.evaluate(profile, given.episodes, ResultLimits().evaluated_work)
    content = {**game.describe_game(), "discount": game.discount, "evaluation": found}
    if isinstance(unknown := game.nash_conv(players), Missing):
        content["not_exact"] = unknown.reason
    print(*game.describe(content), sep="\n")
    return content


def evaluate_in_pursuit_v5(given: EvaluateCommand) -> Plain:
    """Print the scores of a run inside PettingZoo's `pursuit_v5`; the results."""
    check_others(given, "--env plays its own game, with its own evaders", "env")
    from train.evaluation.pursuit_v5 import play_pursuit_v5

    loaded = load_run(given)
    found: list[Plain] = [
        {"policy": name, **play_pursuit_v5(policy, given.episodes, seed_of(given)).summary()}
        for name, policy in loaded.policies.items()
    ]
    print(f"PettingZoo pursuit_v5 with its defaults, {given.episodes} episodes")
    columns = [
        words("policy"),
        numeric("return of an agent", "mean_return", ".2f"),
        numeric("± (95 %)", "ci95", ".2f"),
        numeric("of all agents", "total_return", ".1f"),
        numeric("evaders caught", "mean_caught", ".1f"),
        numeric("steps", "mean_steps", ".1f"),
    ]
    print_table(ResultTable(found, columns))
    return {**loaded.named, "env": given.env, "scores": found}


def evaluate_and_print(
    given: EvaluateCommand | EvaluateModelCommand, replays: Path | None
) -> Plain:
    """Evaluate, print the scores and write the replays; the results."""
    from train.commands.scores import print_objective_gap, print_reference, print_scores, print_team
    from train.commands.suites import compared, evaluate_in_mazes
    from train.evaluation.recordings import recorded
    from train.evaluation.scores import UNKNOWN_GAP
    from train.evaluation.suite_report import summary_of
    from train.runs.parts import contest_of  # torch is slow to import
    from train.runs.single import evaluation_of
    from train.runs.worlds import task_world_of

    loaded = load_run(given) if isinstance(given, EvaluateCommand) else load_model(given)
    task, training, policies = loaded.task, loaded.training, loaded.policies
    evaluated = "learned" if loaded.greedy else "learned, sampled"
    contest = contest_of(task, given.episodes, seed_of(given), loaded.team)
    contest = contest.solved_up_to(MAX_EVALUATED_WORK)
    check(replays is None or not contest.NO_REPLAY, f"--replays takes {contest.NO_REPLAY}")
    more: Plain = {}
    print(contest.line())
    contest = contest.exactly(policies.values())
    if (suite := contest.by_maze) is not None:
        check_default(given, type(given), ["exact_seconds"], "it is for games in one maze")
        played = evaluate_in_mazes(suite, policies, given.table)
        scores = [each.score(given.episodes) for each in played]
        more["suite"] = {each.name: summary_of(suite, each) for each in played}
        if isinstance(given, EvaluateCommand) and given.maze is not None:
            world: Any = task_world_of(training)  # also of a single maze
            own = replace(suite, task=world.task, agent=world.agent, opponents=world.opponents)
            shown = next(each for each in played if each.name == evaluated)
            more["generalisation"] = compared(suite, shown, own, policies[evaluated])
    else:
        check(given.table is None, "--table needs a suite of mazes; give --maze suite:7x7-test")
        scores = []
    chosen = "greedy" if loaded.greedy else "sampled"

    def solve() -> tuple[AnyContest, list[Score], Plain]:
        solved: Any = contest
        own = replace(solved)  # its copy has no solutions yet
        found = scores or [*own.baselines(), *(own.score(*each) for each in policies.items())]
        gap = UNKNOWN_GAP if loaded.gamma is None else own.objective_gap(loaded.gamma)
        return own, found, evaluation_of(found, chosen, own, gap, policies[evaluated])

    with closing(ProgressLine()) as tell:
        (contest, found, results), limit = in_time(solve, given.exact_seconds, tell)
    if not scores:
        print_scores(found, contest)
    if limit:
        more["exact_limit"] = limit
        print(limit)
    for line in contest.notes:
        print(line)
    print_reference(results["reference"], contest)
    print_team(results)
    if loaded.gamma is not None:
        print_objective_gap(results["evaluation"], loaded.gamma)
    if replays is not None:
        games = {f"episode {number + 1}": number for number in range(given.replay_episodes)}
        replay = recorded(contest, policies[evaluated], games, loaded.named["algorithm"])
        path = replay.save(replays)
        print(f"replays: {path}; watch them with: pursuit view {path}")
    return {**contest.describe(), **loaded.named, **results, **more}


@dataclass(frozen=True)
class Loaded:
    """The policies and tasks of an evaluation.

    Attributes:
        task, training: of the evaluation, and of the training.
        policies: by the names of their scores.
        greedy: whether the greedy policy is the evaluated one.
        gamma: the last discount of training; None if it is not known.
        named: further entries of the output file.
        team: whether the policies play all agents of the role.
    """

    task: AnyTask
    training: AnyTask
    policies: dict[str, Any]
    greedy: bool
    gamma: float | None
    named: Plain
    team: bool = False


def load_run(given: EvaluateCommand) -> Loaded:
    """The policies of a run, and its task with the changes of the options."""
    from train.algorithms.registry import entry  # torch is slow to import
    from train.networks.policy import NO_WALLS
    from train.runs.opponents import load_policy
    from train.runs.saved import evaluated_settings, trains_team

    settings = evaluated_settings(given.run, others=given.opponent is not None)
    policy = load_policy(given.run, at=given.at)
    whole_team = trains_team(given.run)
    check(
        whole_team or given.teammates != "learned",
        f"--teammates learned, but {given.run} trained one agent; leave it out",
    )
    changed = {name: own for name in OPPONENT if (own := getattr(given, name)) is not None}
    for name in changed:
        option = f"--{name.replace('_', '-')}"
        check(
            name in settings.task.POLICIES,
            f"{option}, but task {settings.task.task!r} of {given.run} has no other agents; leave "
            "it out",
        )
    if changed:
        task: Any = replace(settings.task, **changed)
        task.check_used()
        settings = replace(settings, task=task)
    policies = {"learned": policy}
    if entry(settings.algorithm).learns_distribution:
        policies["learned, sampled"] = load_policy(given.run, greedy=False, at=given.at)
    training = settings.task
    if given.maze is not None:
        played = with_values(settings.task, f"--maze {given.maze}", maze=given.maze)
        settings = replace(settings, task=played)
        if without_id(settings.observation) in NO_WALLS:
            warn(f"{given.run} observes {settings.observation!r}, which does not contain walls")
    named = {name: getattr(settings, name) for name in ("algorithm", "curriculum", "seed")}
    how = (settings.evaluate == "greedy", settings.hyper.last_gamma)
    team = whole_team and given.teammates != "scripted"
    return Loaded(settings.task, training, policies, *how, named, team)


def load_model(given: EvaluateModelCommand) -> Loaded:
    """The policies of a saved model, in the task of the options."""
    from train.families import family_of  # torch is slow to import
    from train.families.policies import loaded_policy
    from train.runs.opponents import SAVED

    task, known = given.task, need(family_of(given.task).policies)
    built = task.build()
    trained: Plain = {name: own for name, own in vars(task).items() if name == "mask_bumps"}
    trained |= {"task": built, "agent": task.agent_in(built), "observation": given.observation}
    both = ("greedy", "sampled")
    greedy, drawn = (loaded_policy(known, SAVED, given.run, how, **trained) for how in both)
    if vars(task).get(task.AGENT) == "auto":
        task = task.with_agent(greedy.agent)
    where = (built, task.agent_in(built), str(given.run), 0.0)
    policies: dict[str, Policy] = {"learned": known.placed(greedy, *where)}
    if not drawn.greedy:
        policies["learned, sampled"] = known.placed(drawn, *where)
    library = {".onnx": "ONNX"}.get(given.run.suffix, "Stable-Baselines3")
    named: Plain = {"algorithm": library, "model": str(given.run)}
    return Loaded(task, task, policies, True, None, named, getattr(greedy.seat, "team", False))
