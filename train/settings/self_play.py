"""The settings of self-play, as saved in `config.json`."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from pursuit.plugins import Registry, accepts
from pursuit.validation import Rule, at_least, check, passes, shortened
from scripted_agents.names import agent_name, is_custom_policy
from train.files import Plain
from train.settings.algorithms import Hyperparameters, PPOSettings, hyperparameter_form
from train.settings.checks import NotNegative, threads_from
from train.settings.common import RunSettings
from train.settings.curricula import CurriculumSettings
from train.settings.presets import TUNED_RULES
from train.settings.run import AgentSettings
from train.settings.task import AGENT, TaskSettings
from train.settings.task import OPPOSING_ROLES as OPPOSING_ROLES
from train.settings.task_form import AnyTask, TaskForm

LEARN = "learn"
"""The name of a side that learns, on the command line and in files."""
MEMBERS = Rule(lambda _, names: tuple(agent_name(name) for name in names))
"""Agents by name; former names are replaced."""
SAMPLING = ("latest", "window", "uniform", "pfsp", "nash-mixture", "psro")
NASH_SAMPLING = ("nash-mixture", "psro")
"""Sampling rules that draw opponents from a Nash mixture of the payoff matrix."""


SAMPLING_PARTS: Registry[Any] = Registry(
    "sampling",
    "a function (pool, payoffs, progress) -> probabilities of the members of the pool",
    lambda part: accepts(part, None, None, 0.0),
    "sampling",
    SAMPLING,
    {"double-oracle": "nash-mixture"},
)
"""User-defined rules for sampling opponents."""


def self_play_ppo() -> PPOSettings:
    """The hyperparameters of PPO in self-play; the discount is also that of the exact game."""
    return PPOSettings(**TUNED_RULES["self_play_ppo"])


@dataclass(frozen=True)
class LearningSide:
    """The algorithm and the hyperparameters of one side; ValueError if they do not fit."""

    algorithm: str = "ppo"
    hyper: Hyperparameters = field(default_factory=self_play_ppo)

    def __post_init__(self) -> None:
        form = hyperparameter_form(self.algorithm)
        check(
            type(self.hyper) is form,
            f"algorithm={self.algorithm!r} with {type(self.hyper).__name__}; give {form.__name__}",
        )


def unnested_sides(given: Mapping[str, object], roles: Sequence[str] = OPPOSING_ROLES) -> Plain:
    """Settings by name, with a table chaser = {entropy_coef = 0.05} as chaser.entropy_coef."""
    flat: Plain = {}
    for name, value in given.items():
        if name in roles and isinstance(value, Mapping):
            flat |= {f"{name}.{own}": setting for own, setting in value.items()}
        else:
            flat[name] = value
    return flat


def sides_in(plain: Mapping[str, Any]) -> Mapping[str, Any]:
    """By role how it learns or its fixed policy, in the plain settings of a run of self-play."""
    players = plain.get("players")
    if isinstance(players, Mapping):
        return players
    return {role: plain.get(role) for role in OPPOSING_ROLES}


@dataclass(frozen=True, kw_only=True)
class SelfPlayBase(RunSettings):
    """The settings of self-play in any game, but for the game and its sides.

    Attributes:
        task: the game.
        ADDED: settings that older versions did not write.
        UNDISCOUNTED: whether a discount of 1 is allowed.
        curriculum_settings: there is no curriculum.
    """

    ADDED: ClassVar[tuple[str, ...]] = ("average", *RunSettings.ADDED)
    UNDISCOUNTED: ClassVar[bool] = False
    curriculum_settings: ClassVar[CurriculumSettings] = CurriculumSettings()

    task: AnyTask
    sampling: Annotated[str, passes(SAMPLING_PARTS.check)] = "latest"
    """Distribution over opponents: latest, window (the latest policy and snapshots, and the
    members), uniform (the whole pool: fictitious self-play), pfsp (prioritised by difficulty),
    nash-mixture (a Nash mixture of snapshots and members; learners continue from their weights),
    psro (likewise, but learners start from new weights after every snapshot), or
    package.module:Name of a user-defined rule."""
    window: Annotated[int, at_least(1)] = 5
    """Number of latest snapshots that the rule window draws from."""
    pfsp_power: NotNegative = 2.0
    """Exponent of pfsp: how strongly difficult opponents are preferred."""
    episode_steps: Annotated[int | None, at_least(1)] = None
    """Steps after which training episodes are truncated, at most max_steps, which evaluations use.
    Short episodes visit more starts. None: 20, or max_steps with goals."""
    snapshots: Annotated[int, at_least(1)] = 40
    """Snapshots taken during the run, at equal intervals, at most one per iteration."""
    pool_size: Annotated[int, at_least(1)] = 50
    """Snapshots kept for each role: a uniform sample of all (window: the latest; nash-mixture and
    psro: all)."""
    members: Annotated[tuple[str, ...], MEMBERS] = ()
    """Scripted agents in the pools from the start: astar, random, uniform, equilibrium,
    searching (or sweeping, belief, gathering), or package.module:Name of a user-defined policy."""
    average: bool = True
    """Evaluate, save and pool the average of the weights of about the last tenth of training.
    --no-average: the last weights."""
    observation: str = "index"
    """Observation of the networks: index, one_hot, positions, cells, walls, planes, or
    package.module:Name of a user-defined one; in small games index, one_hot or observe."""
    threads: Annotated[int, threads_from(1)] = 1
    """Threads of torch."""
    best_response_seconds: NotNegative = 20.0
    """Seconds of training of an approximate best response to each side after the run, where no
    exact one is known (teams, goals, large mazes). 0: none. For a run with a budget in frames each
    second is 100,000 frames, at most the frames of the run."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.task.check_observation(self.observation)
        for role, side in self.sides.items():
            fits = isinstance(side, str | LearningSide)
            check(fits, f"{role}={shortened(side)}; give a name, or a LearningSide")
        check(
            self.sampling != "window" or self.window <= self.pool_size,
            f"window={self.window} is more than pool_size={self.pool_size}; raise pool_size",
        )
        check(
            self.sampling not in NASH_SAMPLING or self.snapshots <= self.pool_size,
            f"snapshots={self.snapshots} is more than pool_size={self.pool_size}, but "
            f"{self.sampling} keeps all; raise pool_size, or take fewer snapshots",
        )
        fixed = "both fixed" if len(self.sides) == 2 else "all fixed"
        check(bool(self.learning), f"{' and '.join(self.sides)} are {fixed}; set one to learn")
        for name, none in (("sampling", "latest"), ("members", ())):
            check(
                len(self.learning) > 1 or getattr(self, name) == none,
                f"{name}={getattr(self, name)!r}, but the fixed role is the only opponent; leave "
                f"{name} out, or let both roles learn (members may hold the fixed policy)",
            )
        for name in self.members:
            check(
                name in self.task.AGENTS or is_custom_policy(name),
                f"unknown member {name!r}; one of {', '.join(self.task.AGENTS)}, or "
                "package.module:Name",
            )
            check(self.members.count(name) == 1, f"member {name!r} is given twice; give it once")
        discounts = {}
        for role in self.learning:
            hyper = self.side(role).hyper
            last = "gamma" if hyper.last_gamma == hyper.gamma else "gamma_end"
            discounts[f"{role}.{last}"] = hyper.last_gamma
        for name, discount in discounts.items():
            check(
                0.0 < discount < 1.0 or (self.UNDISCOUNTED and discount == 1.0),
                f"{name}={discount} is outside (0, 1); give one inside, as it is also the discount "
                "of the exact game",
            )
        check(
            len(set(discounts.values())) == 1,
            f"{', '.join(f'{name}={value}' for name, value in discounts.items())}; give both roles "
            "the same discount, as they learn in the same game",
        )

    @property
    def fixed_threads(self) -> int:
        """As of `TrainSettings`."""
        return self.threads

    @property
    @abstractmethod
    def sides(self) -> dict[str, str | LearningSide]:
        """By role how it learns, or its fixed policy."""

    @property
    def learning(self) -> tuple[str, ...]:
        """The roles that learn."""
        return tuple(role for role, side in self.sides.items() if not isinstance(side, str))

    @property
    def learners(self) -> tuple[Hyperparameters, ...]:
        """The hyperparameters of all that learn."""
        return tuple(self.side(role).hyper for role in self.learning)

    @property
    def discount(self) -> float:
        """The discount of the exact game: the final discount of the learners."""
        return self.side(self.learning[0]).hyper.last_gamma

    def side(self, role: str) -> LearningSide:
        """The algorithm and the hyperparameters of a role that learns."""
        side = self.sides[role]
        assert not isinstance(side, str)
        return side


@dataclass(frozen=True)
class SelfPlaySettings(SelfPlayBase):
    """All settings of a run of self-play in mazes."""

    task: TaskSettings = field(default_factory=lambda: TaskSettings(rewards="zero_sum"))
    chaser: Annotated[str | LearningSide, AGENT] = field(default_factory=LearningSide)
    """The chasers: how they learn, or a fixed policy: astar, random, uniform, equilibrium,
    searching (or sweeping, belief, gathering), the folder of a run, or package.module:Name of a
    user-defined policy."""
    evader: Annotated[str | LearningSide, AGENT] = field(default_factory=LearningSide)
    """The evaders, as `chaser`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check(
            self.task.role == "auto",
            f"role={self.task.role!r}, but both roles learn in self-play; leave role out, and give "
            "the fixed policy of one as chaser or evader",
        )
        check(self.task.opponent is None, "opponent is for `pursuit train`; use chaser or evader")

    @property
    def sides(self) -> dict[str, str | LearningSide]:
        """As of the base."""
        return {"chaser": self.chaser, "evader": self.evader}


@dataclass(frozen=True)
class GameSelfPlay(SelfPlayBase):
    """All settings of a run of self-play in any other game, as small games are."""

    UNDISCOUNTED: ClassVar[bool] = True

    task: AnyTask
    players: dict[str, str | LearningSide]
    """By player how it learns, or its fixed policy: uniform, equilibrium, the folder of a run, or
    package.module:Name of a function of a state that returns probabilities."""

    @property
    def sides(self) -> dict[str, str | LearningSide]:
        """As of the base."""
        return self.players


SELF_PLAY_FORMS: dict[type[TaskForm], type[SelfPlayBase]] = {TaskSettings: SelfPlaySettings}
"""The settings of self-play by the form of the task; of all others `GameSelfPlay`."""


def self_play_form(form: type[TaskForm]) -> type[SelfPlayBase]:
    """The settings of self-play in tasks of this form."""
    return SELF_PLAY_FORMS.get(form, GameSelfPlay)


WholeSettings = AgentSettings | SelfPlayBase
"""The settings of a run of any kind."""
