"""Validation of the settings of self-play, and construction of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pursuit.simulator.policy import Policy
from pursuit.tasks.task import Task
from pursuit.validation import check, shortened
from scripted_agents.environments import (
    AGENTS,
    SEARCHERS,
    check_agent,
    custom_policy,
    custom_roles,
    plays,
    scripted_policy,
)
from scripted_agents.games.agents import AGENTS as GAME_AGENTS
from scripted_agents.games.agents import EQUILIBRIUM
from train.algorithms.registry import entry
from train.evaluation.games import order_of, other_role
from train.families import family_of
from train.families.maze import check_one_maze
from train.families.small_game import reward_scale
from train.files import Plain
from train.networks.policy import MazeSeat
from train.networks.small_game_policy import SmallGameSeat
from train.runs.forms import RESTORE
from train.runs.opponents import policy_of
from train.runs.parts import build_of, check_sizes
from train.runs.saved import player_of, team_seat
from train.self_play.learners import given_sides, sides_of, unchecked_self_play
from train.self_play.side import SideParts, usual_least
from train.settings.algorithms import Hyperparameters, PPOSettings
from train.settings.common import RunSettings, check_min_probability
from train.settings.reading import complete_settings, read_from
from train.settings.run import AgentSettings, TrainSettings
from train.settings.self_play import (
    NASH_SAMPLING,
    ROLES,
    GameSelfPlay,
    LearningSide,
    SelfPlayBase,
    SelfPlaySettings,
    self_play_form,
    self_play_ppo,
    sides_in,
)
from train.settings.task_form import task_form

SHORT = 20
"""Default number of steps of training episodes without goals. Where the evader can escape, episodes
of full length would hardly visit the states in which it is caught."""

RESPONSE_FRAMES = 100_000
"""Frames for each of the `best_response_seconds`, where the run has a budget in frames; at
most those of the run."""


@dataclass(frozen=True)
class SelfPlayParts:
    """The parts of self-play.

    Attributes:
        settings: of the run.
        task: the game.
        sides: the parts of each role that learns.
        frozen: the policy of each role that does not.
        scripted: scripted agents by name and role, for pools and for comparison.
        discount: of the exact game.
    """

    settings: SelfPlayBase
    task: Any
    sides: dict[str, SideParts]
    frozen: dict[str, Any]
    scripted: dict[tuple[str, str], Any]
    discount: float

    @property
    def roles(self) -> tuple[str, ...]:
        """The roles, whether they learn or not."""
        return tuple(self.settings.sides)


def self_play_parts(settings: SelfPlayBase) -> SelfPlayParts:
    """The parts of self-play.

    Raises:
        ValueError: settings without two sides, or that an algorithm does not support.
    """
    if isinstance(settings, GameSelfPlay):
        return small_game_parts(settings)
    assert isinstance(settings, SelfPlaySettings)
    task = settings.task.build()
    check_one_maze(task, "self-play")
    check_sides(settings, task)
    discount, played = settings.discount, settings.task
    scripted, order = dict[tuple[str, str], Policy](), order_of(task)
    for name in AGENTS:
        epsilon = played.opponent_epsilon if name == "astar" else 0.0  # it is a setting
        for role in ROLES:
            if plays(name, task, role):
                scripted[name, role] = scripted_policy(name, role, epsilon, order, discount)
    for name in settings.members:
        if name not in AGENTS:
            for role in custom_roles(name, task):
                scripted[name, role] = custom_policy(name, task, role)
    frozen: dict[str, Policy] = {}
    for role in [role for role in ROLES if role not in settings.learning]:
        name, seen = str(getattr(settings, role)), played.opponent_observation
        frozen[role] = (
            scripted[name, role]
            if (name, role) in scripted
            else policy_of(played, name, task, role, 0.0, played.opponent_policy, seen)
        )
    steps = settings.episode_steps or (task.max_steps if task.num_goals else SHORT)
    training = replace(task, max_steps=steps) if steps < task.max_steps else task
    sides: dict[str, SideParts] = {}
    for role in settings.learning:
        own = side_settings(settings, role)
        seat = MazeSeat(
            task, role, own.observation, played.mask_bumps, own.frame_stack, own.network
        )
        seat = team_seat(seat, own)
        # Returns of up to 1 / (1 - gamma) steps would make the value loss dominate.
        scale = 1.0 - discount if played.rewards == "zero_sum" else 1.0
        sides[role] = side_parts(own, seat, discount, scale, training, settings.average)
    return SelfPlayParts(settings, task, sides, frozen, scripted, discount)


def side_parts(
    own: AgentSettings,
    seat: MazeSeat | SmallGameSeat,
    discount: float,
    scale: float,
    training: Any,
    average: bool,
) -> SideParts:
    """The parts of the side with these settings; ValueError if they do not fit."""
    check_sizes(own.hyper, seat)
    algorithm = entry(own.algorithm)
    algorithm.check_team(seat)
    algorithm.check_memory(own.hyper, seat)
    how = (discount, scale, training, own.min_probability or 0.0, average)
    return SideParts(seat, algorithm, own.hyper, build_of(own), *how)


def small_game_parts(settings: GameSelfPlay) -> SelfPlayParts:
    """The parts of self-play in a small game; ValueError as `self_play_parts`."""
    task, discount = settings.task.build(), settings.discount
    game, sides = task.game, settings.sides
    roles = task.agent_names
    check(
        settings.sampling not in NASH_SAMPLING or game.zero_sum,
        f"sampling={settings.sampling!r} needs two players with opposite rewards; use latest, "
        "window, uniform or pfsp",
    )
    names = [name for name in GAME_AGENTS if game.zero_sum or name != EQUILIBRIUM]
    scripted = {
        (name, role): policy_of(settings.task, name, task, role)
        for role in roles
        for name in dict.fromkeys((*names, *settings.members))
    }
    how = (settings.task.opponent_epsilon, settings.task.opponent_policy)
    fixed = {role: side for role, side in sides.items() if isinstance(side, str)}
    frozen = {
        role: policy_of(settings.task, name, task, role, *how) for role, name in fixed.items()
    }
    steps = min(settings.episode_steps or task.max_steps, task.max_steps)
    training = replace(task, max_steps=steps)
    found: dict[str, SideParts] = {}
    for role in settings.learning:
        own = side_settings(settings, role)
        entry(own.algorithm).check_self_play(role, 1)
        seat: Any = player_of(own)
        seat = replace(seat, min_probability=0.0)
        scale = reward_scale(task, role, discount)
        found[role] = side_parts(own, seat, discount, scale, training, settings.average)
    return SelfPlayParts(settings, task, found, frozen, scripted, discount)


def check_sides(settings: SelfPlaySettings, task: Task) -> None:
    """ValueError unless the task has chasers and evaders only, and the algorithms support it."""
    check(
        bool(task.num_chasers and task.num_evaders),
        f"task {task.name!r} has no chasers or no evaders; use chase or heist",
    )
    check(
        not task.num_goals or settings.task.rewards == "zero_sum",
        f"rewards={settings.task.rewards!r} with goals; use zero_sum: opponents are scored by "
        "steps, so chasers must be rewarded for short episodes",
    )
    check(
        not task.most_exits or (settings.task.rewards != "zero_sum" and not task.num_goals),
        f"rewards={settings.task.rewards!r}, num_goals={task.num_goals} with exits; use win_loss "
        "without goals: opponents are scored by captures and escapes, and zero_sum pays steps",
    )
    check(not task.num_runners, f"task {task.name!r} has runners; use chase or heist")
    for role in ROLES:
        members = [name for name in settings.members if role in SEARCHERS.get(name, ROLES)]
        for name in (getattr(settings, role), *members):
            if name in AGENTS:
                check_agent(name, task, role)
    for role in settings.learning:
        entry(settings.side(role).algorithm).check_self_play(role, task.count(role))


def side_settings(settings: SelfPlayBase, role: str) -> AgentSettings:
    """The settings of the learner of one role, as those of a single-agent run."""
    task = settings.task.with_agent(role)
    alone: AgentSettings = TrainSettings(task, observation=settings.observation, frames=1)
    seat = family_of(task).seat(alone)
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


def response_settings(settings: SelfPlaySettings, role: str, folder: Path) -> SelfPlaySettings:
    """Of a run in which PPO learns against the policy of a role, which is fixed.

    Args:
        settings: of the run of that policy.
        role, folder: of the policy.
    """
    of_ppo: Hyperparameters = replace(self_play_ppo(), gamma=settings.discount)
    learning = [side_settings(settings, each) for each in settings.learning]
    of_ppo = next((side.hyper for side in learning if side.algorithm == "ppo"), of_ppo)
    sides: Plain = {role: str(folder), other_role(role): LearningSide(hyper=of_ppo)}
    seconds, frames = settings.best_response_seconds or None, settings.frames
    if frames is not None:  # equal settings have equal results
        frames = min(max(round(RESPONSE_FRAMES * (seconds or 0.0)), 1), frames)
        seconds = None
    return replace(
        settings,
        # The fixed side samples as in training; the response may use all actions.
        task=replace(settings.task, opponent_policy="sampled", mask_bumps=False),
        **sides,
        sampling="latest",
        members=(),
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
    self_play_parts(settings)
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
        if isinstance(settings, SelfPlaySettings):
            check_sides(settings, settings.task.build())
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
