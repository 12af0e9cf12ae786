"""The settings of self-play, as saved in `config.json`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from pursuit.observations.custom import check_observation
from pursuit.plugins import Registry
from scripted_agents.environments import AGENTS, is_custom_policy
from train.settings.algorithms import PPOSettings
from train.settings.checks import NotNegative, at_least, check, passes, threads_from
from train.settings.common import RunSettings
from train.settings.task import TaskSettings

ROLES = ("chaser", "evader")
LEARN = "learn"
SAMPLING = ("latest", "window", "uniform", "pfsp", "double-oracle")
SAMPLING_PARTS: Registry[Any] = Registry(
    "sampling", "a function (pool) -> weights of its members", callable, "sampling", SAMPLING
)
"""User-defined rules for sampling opponents."""
FORMER = {"psro": "double-oracle"}
"""Former names of sampling rules, which are still accepted."""


def self_play_ppo() -> PPOSettings:
    """The hyperparameters of PPO in self-play; the discount is also that of the exact game.

    The entropy bonus is annealed to 0. It was tuned together with `sampling` on generated mazes.
    """
    return PPOSettings(num_games=512, learning_rate=3e-3, entropy_coef=0.3, minibatch_size=2048)


@dataclass(frozen=True)
class SelfPlaySettings(RunSettings):
    """All settings of a run of self-play."""

    task: TaskSettings = field(default_factory=lambda: TaskSettings(rewards="zero_sum"))
    hyper: PPOSettings | None = field(default_factory=self_play_ppo)
    """Hyperparameters of PPO, for the roles that learn with it; None where no role does."""
    chaser: str = LEARN
    """learn, or the fixed policy of the chasers: astar, random, optimal, searching (or sweeping,
    belief), the folder of a run, or package.module:Name of a user-defined policy."""
    evader: str = LEARN
    """learn, or the fixed policy of the evaders."""
    chaser_algorithm: str = "ppo"
    """Algorithm of the chasers: ppo, a2c, dqn, mmd, rnad or nfsp."""
    evader_algorithm: str = "ppo"
    """Algorithm of the evaders: ppo, a2c, dqn, mmd, rnad or nfsp."""
    chaser_hyper: Any = None
    """Hyperparameters of the chasers' algorithm if that is not PPO; None for the tuned ones."""
    evader_hyper: Any = None
    """Hyperparameters of the evaders' algorithm if that is not PPO; None for the tuned ones."""
    sampling: Annotated[str, passes(SAMPLING_PARTS.check)] = "latest"
    """Distribution over opponents: latest, window (the latest snapshots), uniform (all snapshots:
    fictitious self-play), pfsp (prioritised by difficulty), double-oracle (a Nash mixture of all
    snapshots; learners continue from their weights, unlike PSRO), or package.module:Name of a
    user-defined rule."""
    window: Annotated[int, at_least(1)] = 5
    """Number of latest snapshots that the rule window draws from."""
    pfsp_power: NotNegative = 2.0
    """Exponent of pfsp: how strongly difficult opponents are preferred."""
    snapshots: Annotated[int, at_least(1)] = 40
    """Snapshots taken during the run, at equal intervals."""
    pool_size: Annotated[int, at_least(1)] = 50
    """Snapshots kept for each role: a uniform sample of all (window: the latest; double-oracle:
    all)."""
    members: tuple[str, ...] = ()
    """Scripted agents in the pools from the start: astar, random, optimal, searching (or sweeping,
    belief), or package.module:Name of a user-defined policy."""
    observation: Annotated[str, passes(check_observation)] = "index"
    """Observation of the networks: index, one_hot, positions, cells, walls, planes, or
    package.module:Name of a user-defined one."""
    threads: Annotated[int, threads_from(1)] = 1
    """Threads of torch."""
    best_response_seconds: NotNegative = 20.0
    """Seconds of training of an approximate best response to each side after the run, where no
    exact one is known (teams, goals, large mazes). 0: none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "sampling", FORMER.get(self.sampling, self.sampling))
        super().__post_init__()
        check(
            self.task.role == "auto",
            f"role={self.task.role!r}, but both roles learn in self-play; leave role out, and give "
            "the fixed policy of one as chaser or evader",
        )
        check(self.task.opponent is None, "opponent is for `pursuit train`; use chaser or evader")
        check(
            self.sampling != "window" or self.window <= self.pool_size,
            f"window={self.window} is more than pool_size={self.pool_size}; raise pool_size",
        )
        check(
            self.sampling != "double-oracle" or self.snapshots <= self.pool_size,
            f"snapshots={self.snapshots} is more than pool_size={self.pool_size}, but "
            "double-oracle keeps all; raise pool_size, or take fewer snapshots",
        )
        check(bool(self.learning), "chaser and evader are both fixed; set one of them to learn")
        for name in self.members:
            check(
                name in AGENTS or is_custom_policy(name),
                f"unknown member {name!r}; one of {', '.join(AGENTS)}, or package.module:Name",
            )
            check(self.members.count(name) == 1, f"member {name!r} is given twice; give it once")
        for role in ROLES:
            check(
                getattr(self, f"{role}_hyper") is None or role in self.other_learners,
                f"{role}_hyper is for algorithms other than ppo; leave it out, or set "
                f"{role}_algorithm to one that the {role}s learn with",
            )
        discounts = {}
        for prefix, hyper in self._hypers().items():
            check(hyper is not None, "hyper=None, but a role learns with ppo; leave hyper out")
            last = "gamma" if getattr(hyper, "gamma_end", None) is None else "gamma_end"
            discounts[f"{prefix}{last}"] = hyper.last_gamma
        for name, discount in discounts.items():
            check(
                0.0 < discount < 1.0,
                f"{name}={discount} is outside (0, 1); give one inside, as it is also the discount "
                "of the exact game",
            )
        check(
            len(set(discounts.values())) == 1,
            f"{', '.join(f'{name}={value}' for name, value in discounts.items())}; give both roles "
            "the same discount, as they learn in the same game",
        )

    @property
    def learning(self) -> tuple[str, ...]:
        """The roles that learn."""
        return tuple(role for role in ROLES if getattr(self, role) == LEARN)

    @property
    def other_learners(self) -> tuple[str, ...]:
        """The roles that learn with an algorithm other than PPO."""
        return tuple(role for role in self.learning if self.algorithm(role) != "ppo")

    @property
    def discount(self) -> float:
        """The discount of the exact game: the final discount of the learners."""
        return float(next(iter(self._hypers().values())).last_gamma)

    def _hypers(self) -> dict[str, Any]:
        """The hyperparameters that give the discount of each learning role, by their name prefix.

        It is `hyper` where those of another algorithm are not filled in yet.
        """
        found = {}
        for role in self.learning:
            own = getattr(self, f"{role}_hyper")
            found["" if own is None else f"{role}_"] = self.hyper if own is None else own
        return found

    def algorithm(self, role: str) -> str:
        """The algorithm of a role."""
        return str(getattr(self, f"{role}_algorithm"))
