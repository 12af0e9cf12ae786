"""The settings of self-play: what `config.json` of a run of two sides holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from pursuit.observations.own import check_observation
from pursuit.plugins import Registry
from scripted_agents.environments import AGENTS, is_own_policy
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
"""Rules of users' own that say how often each opponent is drawn."""
FORMER = {"psro": "double-oracle"}
"""What schemes were called before; the old name is still taken."""


def self_play_ppo() -> PPOSettings:
    """The settings of PPO in self-play: the discount is that of the exact game.

    The entropy bonus is annealed to 0. It was chosen with `sampling` on generated mazes; see
    docs/results/self_play.md.
    """
    return PPOSettings(num_games=512, learning_rate=3e-3, entropy_coef=0.3, minibatch_size=2048)


@dataclass(frozen=True)
class SelfPlaySettings(RunSettings):
    """Self-play, complete."""

    task: TaskSettings = field(default_factory=lambda: TaskSettings(rewards="zero_sum"))
    hyper: PPOSettings | None = field(default_factory=self_play_ppo)
    """The settings of PPO, for every role that learns by it; None in the settings of a run in which
    no role does."""
    chaser: str = LEARN
    """learn, or who plays the chasers instead: astar, random, optimal, searching (or sweeping,
    belief), the folder of a run, or package.module:Name of your own."""
    evader: str = LEARN
    """learn, or who plays the evaders instead."""
    chaser_algorithm: str = "ppo"
    """What the chasers learn by: ppo, a2c or dqn."""
    evader_algorithm: str = "ppo"
    """What the evaders learn by."""
    chaser_hyper: Any = None
    """The settings of the chasers' algorithm where that is not PPO (`Hyperparameters`); None for
    its tuned ones, which a run fills in."""
    evader_hyper: Any = None
    """The settings of the evaders' algorithm; likewise."""
    sampling: Annotated[str, passes(SAMPLING_PARTS.check)] = "latest"
    """Who is drawn as the opponent: latest, window (the last snapshots), uniform (over all:
    fictitious self-play), pfsp (those that are hard), double-oracle (a Nash mixture of all
    snapshots by their discounted payoffs; the learners go on from where they are, while those of
    PSRO begin afresh against every mixture), or package.module:Name of your own."""
    window: Annotated[int, at_least(1)] = 5
    """Snapshots of window."""
    pfsp_power: NotNegative = 2.0
    """How strongly pfsp prefers opponents that are hard."""
    snapshots: Annotated[int, at_least(1)] = 40
    """Snapshots taken over the budget, evenly."""
    pool_size: Annotated[int, at_least(1)] = 50
    """Snapshots kept for each role: a sample of all so far, each as likely as any other (of window
    the newest; of double-oracle all)."""
    members: tuple[str, ...] = ()
    """Scripted agents in the pools from the start: astar, random, optimal, searching (or sweeping,
    belief), or package.module:Name of your own."""
    observation: Annotated[str, passes(check_observation)] = "index"
    """What the networks are given: index, one_hot, positions, cells, walls, planes, or
    package.module:Name of your own."""
    threads: Annotated[int, threads_from(1)] = 1
    """Threads of torch."""
    best_response_seconds: NotNegative = 20.0
    """Where no exact best response is known (teams, goals, huge mazes): how long an approximate one
    is trained against each side at the end; 0 for none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "sampling", FORMER.get(self.sampling, self.sampling))
        super().__post_init__()
        check(
            self.task.role == "auto",
            f"role={self.task.role!r}; both sides learn here: freeze one by chaser or evader",
        )
        check(self.task.opponent is None, "opponent is of `pursuit train`; use chaser or evader")
        check(
            self.sampling != "window" or self.window <= self.pool_size,
            f"window={self.window} snapshots, and pool_size={self.pool_size} are kept; raise it",
        )
        check(
            self.sampling != "double-oracle" or self.snapshots <= self.pool_size,
            f"snapshots={self.snapshots} with pool_size={self.pool_size}; double-oracle forgets "
            "none: raise pool_size, or take fewer snapshots",
        )
        check(bool(self.learning), "chaser and evader are both frozen; let one of them learn")
        for name in self.members:
            check(
                name in AGENTS or is_own_policy(name),
                f"unknown member {name!r}; of {', '.join(AGENTS)}, or package.module:Name",
            )
            check(self.members.count(name) == 1, f"member {name!r} is given twice")
        for role in ROLES:
            check(
                getattr(self, f"{role}_hyper") is None or role in self.other_learners,
                f"{role}_hyper is given, and the {role}s learn by ppo or not at all; leave it out, "
                f"or give another {role}_algorithm",
            )
        discounts = {}
        for prefix, hyper in self._hypers().items():
            check(hyper is not None, "hyper=None, and not every side has settings; leave it out")
            last = "gamma" if getattr(hyper, "gamma_end", None) is None else "gamma_end"
            discounts[f"{prefix}{last}"] = hyper.last_gamma
        for name, discount in discounts.items():
            check(
                0.0 < discount < 1.0,
                f"{name}={discount}; in (0, 1): it is the discount of the exact game",
            )
        check(
            len(set(discounts.values())) == 1,
            f"{', '.join(f'{name}={value}' for name, value in discounts.items())}; both sides "
            "learn the same exact game: give them one discount",
        )

    @property
    def learning(self) -> tuple[str, ...]:
        """The roles that learn."""
        return tuple(role for role in ROLES if getattr(self, role) == LEARN)

    @property
    def other_learners(self) -> tuple[str, ...]:
        """The roles that learn by something else than PPO."""
        return tuple(role for role in self.learning if self.algorithm(role) != "ppo")

    @property
    def discount(self) -> float:
        """The discount of the exact game: the last one that the sides learn with."""
        return float(next(iter(self._hypers().values())).last_gamma)

    def _hypers(self) -> dict[str, Any]:
        """The settings that give the discount of each learning role, by the prefix of their names.

        Where those of another algorithm are left to be filled in, that is `hyper`.
        """
        found = {}
        for role in self.learning:
            own = getattr(self, f"{role}_hyper")
            found["" if own is None else f"{role}_"] = self.hyper if own is None else own
        return found

    def algorithm(self, role: str) -> str:
        """What a role learns by."""
        return str(getattr(self, f"{role}_algorithm"))
