"""Validation of the settings of self-play, and construction of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from pursuit.validation import Missing, check, need, shortened
from train.algorithms.registry import entry
from train.evaluation.sides import Sides
from train.families import family_of
from train.files import Plain
from train.runs.folder import CONFIG
from train.runs.forms import RESTORE
from train.runs.imitation import OPTIMAL, expert_of
from train.runs.logs import logs_of
from train.runs.opponents import is_self_play, policy_of
from train.runs.parts import build_of, check_sizes
from train.runs.saved import agent_seat, check_source, learning_seat, load_settings
from train.runs.worlds import task_world_of
from train.self_play.learners import given_sides, sides_of, unchecked_self_play
from train.self_play.side import SideParts, usual_least
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.common import RunSettings, check_min_probability
from train.settings.reading import complete_settings, read_from
from train.settings.run import AgentSettings, TrainSettings
from train.settings.self_play import (
    NASH_SAMPLING,
    LearningSide,
    SelfPlayBase,
    self_play_form,
    self_play_ppo,
    sides_in,
)
from train.settings.task_form import task_form

RESPONSE_FRAMES = 100_000
"""Frames for each of the `best_response_seconds`, where the run has a budget in frames; at
most those of the run."""


@dataclass(frozen=True)
class SelfPlayParts:
    """The parts of self-play.

    Attributes:
        settings: of the run.
        game: of all sides.
        sides: the parts of each role that learns.
        frozen: the policy of each role that does not.
        scripted: other policies by name and role, for pools and for comparison.
    """

    settings: SelfPlayBase
    game: Sides
    sides: dict[str, SideParts]
    frozen: dict[str, Any]
    scripted: dict[tuple[str, str], Any]


def game_of_all(given: Any, discount: float = 1.0) -> Sides:
    """The game of all sides of a task; ValueError where it has none."""
    form: Any = need(family_of(given).sides)
    world = task_world_of(given)
    game: Sides = form(world, world.task, discount)
    return game


def self_play_parts(settings: SelfPlayBase) -> SelfPlayParts:
    """The parts of self-play.

    Raises:
        ValueError: settings without two sides, or that an algorithm does not support.
    """
    given = settings.task
    check_learners(settings)
    logs_of(settings.log)
    check(
        settings.imitate != OPTIMAL,
        f"imitate={OPTIMAL!r} is the best response to fixed agents, which self-play does not have; "
        "use equilibrium",
    )
    game = game_of_all(given, settings.discount)
    if settings.sampling in NASH_SAMPLING and isinstance(game.mixtures, Missing):
        why = game.mixtures.reason
        raise ValueError(
            f"sampling={settings.sampling!r} {why}; use latest, window, uniform or pfsp"
        )
    task, scripted, frozen = game.task, game.scripted(settings.members), dict[str, Any]()
    for role, name in settings.sides.items():
        if isinstance(name, str):
            how = given.how_fixed
            is_ready = (name, role) in scripted and not how[0]
            frozen[role] = (
                scripted[name, role] if is_ready else policy_of(given, name, task, role, *how)
            )
    steps = min(game.episode_steps(settings.episode_steps), task.max_steps)
    training = replace(task, max_steps=steps) if steps < task.max_steps else task
    sides: dict[str, SideParts] = {}
    sources = sources_of(settings)
    for role in settings.learning:
        own = side_settings(settings, role)
        seat: Any = learning_seat(own)
        seat = replace(seat, min_probability=0.0)
        check_sizes(own.hyper, seat)
        algorithm = entry(own.algorithm)
        algorithm.check_team(seat)
        algorithm.check_memory(own.hyper, seat)
        more = (build_of(own), game, training, own.min_probability or 0.0, settings.average)
        expert = partial(expert_of, settings, game.world, seat, algorithm)
        sides[role] = SideParts(seat, algorithm, own.hyper, *more, sources.get(role), expert)
    return SelfPlayParts(settings, game, sides, frozen, scripted)


def sources_of(settings: SelfPlayBase) -> dict[str, str]:
    """By role the folder of the policy whose weights a side starts from; ValueError if `init_from`
    has none of a side that learns."""
    source = settings.init_from
    if source is None or not (Path(source) / CONFIG).exists():  # a resumed run does not need it
        return {}
    if is_self_play(Path(source)):
        found = {role: f"{source}/{role}" for role in settings.learning}
        found = {role: path for role, path in found.items() if Path(path).is_dir()}
    else:
        found = {agent_seat(load_settings(source)).role: source}
    check(
        bool({*found} & {*settings.learning}),
        f"init_from={source!r} has no policy of {' or '.join(settings.learning)}; give a run of "
        "self-play, or of one of them",
    )
    return found


def check_learners(settings: SelfPlayBase) -> None:
    """ValueError unless the task has these sides, and the algorithms support them."""
    settings.task.check_self_play(settings.sides, settings.members)
    for role in settings.learning:
        seat = family_of(settings.task).seat(alone(settings, role))
        entry(settings.side(role).algorithm).check_self_play(role, seat.team_size)


def alone(settings: SelfPlayBase, role: str) -> AgentSettings:
    """The settings of a run of one agent of this role, for its seat."""
    task = settings.task.with_agent(role)
    return TrainSettings(task, observation=settings.observation, frames=1)


def side_settings(settings: SelfPlayBase, role: str) -> AgentSettings:
    """The settings of the learner of one role, as those of a single-agent run."""
    task = settings.task.with_agent(role)
    seat = family_of(task).seat(alone(settings, role))
    members, actions = seat.team_size, seat.num_actions
    algorithm, hyper = settings.side(role).algorithm, settings.side(role).hyper
    games = max(hyper.num_games // members, 1) * members
    if isinstance(hyper, PPOSettings):
        batch = min(hyper.minibatch_size, games * hyper.rollout_steps)
        hyper = replace(hyper, num_games=games, minibatch_size=batch)
    else:
        hyper = replace(hyper, num_games=games)
    names = {"observation", "network", "threads", *(f.name for f in fields(RunSettings))}
    whole = {name: getattr(settings, name) for name in names}
    least = settings.min_probability
    if least is None:
        least = usual_least(actions)
    whole["min_probability"] = check_min_probability(least, actions)
    return TrainSettings(task, hyper, algorithm=algorithm, **whole)


def response_settings(settings: SelfPlayBase, role: str, folder: Path) -> SelfPlayBase:
    """Of a run in which PPO learns against the policy of a role, which is fixed.

    Args:
        settings: of the run of that policy, in a game of two roles.
        role, folder: of the policy.
    """
    of_ppo: Hyperparameters = replace(self_play_ppo(), gamma=settings.discount)
    learning = [side_settings(settings, each) for each in settings.learning]
    of_ppo = next((side.hyper for side in learning if side.algorithm == "ppo"), of_ppo)
    sides: Plain = {
        each: str(folder) if each == role else LearningSide(hyper=of_ppo) for each in settings.sides
    }
    seconds, frames = settings.best_response_seconds or None, settings.frames
    if frames is not None:  # equal settings have equal results
        frames = min(max(round(RESPONSE_FRAMES * (seconds or 0.0)), 1), frames)
        seconds = None
    # The fixed side samples as in training; the response may use all actions.
    free = {"opponent_policy": "sampled", "mask_bumps": False}
    own: Any = {name: value for name, value in free.items() if name in vars(settings.task)}
    return replace(
        settings,
        task=replace(settings.task, **own),
        **given_sides(type(settings), sides),
        sampling="latest",
        members=(),
        checkpoints=0,
        init_from=None,
        imitate=None,
        imitate_frames=0,
        log="none",
        best_response_seconds=0.0,
        seconds=seconds,
        frames=frames,
    )


# -- settings from mappings ------------------------------------------------------------------------


def self_play_settings_of(**flat: Any) -> SelfPlayBase:
    """Settings of self-play by their names on the command line, checked.

    Algorithm and hyperparameters are those of both sides. A table of a side takes precedence:
    `self_play_settings_of(frames=1000, entropy_coef=0.02, evader={"algorithm": "dqn"})`; a name is
    a fixed policy: `chaser="astar"`.

    Raises:
        ValueError: an unknown name, a value of the wrong type, or one that is not allowed.
    """
    settings = unchecked_self_play(**flat)
    check_source(settings)
    for side in self_play_parts(settings).sides.values():
        side.expert(0)  # refuses what cannot be imitated
    return settings


def self_play_from_plain(plain: Plain, where: str) -> SelfPlayBase:
    """Settings from the plain values of `config.json`; ValueError if these are invalid."""
    with read_from(where, RESTORE):
        form = task_form(plain.get("task", {}))
        whole: Any = self_play_form(form)
        own = complete_settings(whole, plain)
        task = form(**complete_settings(form, plain.get("task"), "task"))
        given, names = sides_in(plain), sides_of(task)
        check(
            tuple(given) == names,
            f"players={shortened(plain.get('players'))}; give a table of {', '.join(names)}",
        )
        sides = {role: _side_from_plain(role, given[role]) for role in names}
        settings: SelfPlayBase = whole(task=task, **given_sides(whole, sides), **own)
        settings.task.check_self_play(settings.sides, settings.members)
    return settings


def _side_from_plain(role: str, plain: object) -> str | LearningSide:
    if isinstance(plain, str):
        return plain
    if not isinstance(plain, Mapping) or set(plain) != {"algorithm", "hyper"}:
        raise ValueError(
            f"{role}={shortened(plain)}; give a name, or a table of algorithm and hyper"
        )
    form = entry(plain["algorithm"]).settings
    return LearningSide(
        plain["algorithm"], form(**complete_settings(form, plain["hyper"], f"{role}.hyper"))
    )
