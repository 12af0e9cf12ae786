"""The algorithms by name: settings, construction, loading and abilities.

To add an algorithm, write a file with its settings, its class and its `build`, and one entry here;
command line, run folders, sweeps and reports use the entry. A user-defined algorithm is an
`Algorithm` in any module, named `package.module:Name`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import pursuit
from pursuit.siblings import is_ours
from pursuit.simulator.policy import Policy
from pursuit.validation import check
from train.algorithms import (
    a2c,
    cleanrl,
    continuous,
    cross_entropy,
    dqn,
    ippo,
    iql,
    mappo,
    nfsp,
    ppo,
    q_learning,
    qmix,
    regularized,
    stable_baselines,
    tracked,
    vdn,
)
from train.algorithms.learner import Build, Learner, network_loader
from train.environments.batch_env import BatchEnv
from train.networks.seat import Seat
from train.settings.algorithms import HYPERPARAMETERS, LEARNERS, TUNED_AS, TeamSettings
from train.settings.hyperparameters import Hyperparameters
from train.tensors import StateDict

__all__ = ["ALGORITHMS", "Algorithm", "Build", "entry", "register"]


@dataclass(frozen=True)
class Algorithm:
    """The description of an algorithm.

    Attributes:
        name: on the command line and in `config.json`.
        settings: the class of its hyperparameters.
        build: (settings, env, Build) -> the learner for an environment: a `VecEnv` (`env_form`),
            or with `own_loop` a `LearnerVectorEnv`.
        load: (settings, seat, state, greedy) -> the policy in a learner's `state_dict`, on the
            CPU; KeyError or RuntimeError for a state of other settings.
        learns_distribution: whether it has a stochastic policy.
        has_advantages: whether it reports advantages to the hook of its environment.
        self_play: whether it can learn against a learning opponent.
        teams: whether it can learn for several agents of a role in self-play.
        tabular: whether it has a table over the states of one maze or small game, and no network.
        imitates: whether it can imitate a policy first (`RunSettings.imitate`).
        recurrent: whether its network can be recurrent.
        own_loop: whether it brings its own loop and network, as those of other libraries do.
        package, extra: the package that it needs, and the extra of `pip install 'pursuit[...]'`
            that installs it; "" for none.
        actions: the kinds of actions that it supports: "discrete", "continuous".
        check_player: (settings, seat) raises ValueError for an unsupported seat.
    """

    name: str
    settings: type[Hyperparameters]
    build: Callable[[Any, Any, Build], Learner]
    load: Callable[[Any, Any, StateDict, bool], Policy]
    learns_distribution: bool = True
    has_advantages: bool = False
    self_play: bool = False
    teams: bool = False
    tabular: bool = False
    imitates: bool = False
    recurrent: bool = False
    own_loop: bool = False
    package: str = ""
    extra: str = ""
    actions: frozenset[str] = frozenset({"discrete"})
    check_player: Callable[[Any, Any], object] = lambda settings, player: None

    @property
    def whole_role(self) -> bool:
        """Whether it learns for all agents of the role in `train` too: it has `TeamSettings`."""
        return issubclass(self.settings, TeamSettings)

    def policy_state(self, state: StateDict) -> StateDict:
        """What `load` reads of a learner's state: of our networks the weights alone."""
        ours = is_ours(getattr(self.build, "__module__", "")) and "network" in state
        return {"network": state["network"]} if ours else state

    @property
    def env_form(self) -> type[BatchEnv]:
        """The class of its environment, unless it has its own loop: for a learner of a user
        `SimulatorEnv`, which has the interface of TorchRL and takes a second to import."""
        if is_ours(getattr(self.build, "__module__", "")):
            return BatchEnv
        from train.environments.simulator_env import SimulatorEnv  # slow to import

        return SimulatorEnv

    @property
    def library(self) -> str:
        """The package that it is of, with its version; ImportError if it is not installed."""
        if not self.package:
            return f"pursuit {pursuit.__version__}"
        try:
            return f"{self.package} {version(self.package)}"
        except PackageNotFoundError:
            raise ImportError(
                f"{self.package} is not installed, which algorithm={self.name!r} needs; pip "
                f"install 'pursuit[{self.extra}]'"
            ) from None

    def check(self, settings: Hyperparameters, seat: Seat, device: str, greedy: bool) -> None:
        """ValueError for unsupported settings or players.

        Args:
            settings: its hyperparameters.
            seat: the learning agent.
            device: of the network.
            greedy: whether the greedy policy is evaluated.
        """
        _ = self.library  # it is installed
        check(
            not self.settings.SELF_PLAY_ONLY,
            f"algorithm={self.name!r} is for self-play; use `pursuit self-play --algorithm "
            f"{self.name}`, or another algorithm",
        )
        self.check_team(seat)
        self.check_actions(seat)
        check(
            greedy or self.learns_distribution,
            f"evaluate='sampled', but {self.name} learns no distribution; use evaluate='greedy'",
        )
        if self.tabular:
            plain = (device, seat.encoding, seat.frame_stack, seat.features.network)
            check(
                plain == ("cpu", "index", 1, ""),
                f"{self.name} has a table over states instead of a network, on the cpu: leave out "
                "device, observation, frame_stack and network",
            )
        check(
            not (self.own_loop and seat.has_masks),
            f"algorithm={self.name!r} does not support the action masks of this task (mask_bumps, "
            "turns, illegal actions); use ppo",
        )
        self.check_memory(settings, seat)
        self.check_player(settings, seat)

    def check_actions(self, seat: Seat) -> None:
        """ValueError for actions of an unsupported kind."""
        kind = "continuous" if seat.continuous else "discrete"
        numbered = not seat.NO_NUMBERS
        able = _names_of(
            lambda other: (
                kind in other.actions
                and (numbered or not other.tabular)
                and not other.settings.SELF_PLAY_ONLY
            )
        )
        turned = seat.continuous and "discrete" in self.actions and not self.tabular
        check(
            kind in self.actions,
            f"algorithm={self.name!r} does not support {kind} actions; use {' or '.join(able)}"
            + (", or discrete_actions=True" if turned else ""),
        )
        check(
            numbered or not self.tabular,
            f"algorithm={self.name!r} has a table over the cells of a maze, which this task does "
            f"not have; use {' or '.join(able)}",
        )

    def check_team(self, seat: Seat) -> None:
        """ValueError where it trains all agents of a role, and the seat has no role."""
        check(
            not (seat.NO_TEAM and self.whole_role),
            f"algorithm={self.name!r} trains teams, which this game does not have; use "
            f"{TUNED_AS.get(self.name, 'ppo')}",
        )

    def check_memory(self, settings: Hyperparameters, seat: Seat) -> None:
        """ValueError where a recurrent network is configured but not supported."""
        check(
            settings.recurrent is None or self.recurrent,
            f"recurrent={settings.recurrent!r} is not supported by {self.name}; use "
            f"{' or '.join(_names_of(lambda other: other.recurrent))}",
        )
        check(
            settings.recurrent is None or not seat.NO_MEMORY,
            f"recurrent={settings.recurrent!r} is not supported for {seat.NO_MEMORY}; leave it out",
        )

    def check_imitation(self, name: str, seat: Seat) -> None:
        """ValueError unless it can imitate the policy of this name in the seat."""
        able = ", ".join(
            _names_of(lambda other: other.imitates and not other.settings.SELF_PLAY_ONLY)
        )
        why = {
            f"algorithm={self.name!r}, which does not learn from rollouts; use {able}": (
                not self.imitates
            ),
            "sharing='joint', where actions are of the whole team; use sharing=shared": seat.joint,
        }
        found = next((reason for reason, holds in why.items() if holds), "")
        check(not found, f"imitate={name!r} is not supported with {found}, or leave it out")

    def check_self_play(self, role: str, agents: int) -> None:
        """ValueError unless it can learn for this number of agents in self-play."""
        able = _names_of(lambda other: other.self_play)
        check(
            self.self_play,
            f"{role}.algorithm={self.name!r} does not support self-play; use "
            f"{', '.join(able[:-1])} or {able[-1]}",
        )
        check(
            self.teams or agents == 1,
            f"{role}.algorithm={self.name!r} with {agents} {role}s; for several agents of a role "
            f"use {' or '.join(_names_of(lambda other: other.self_play and other.teams))}",
        )


def build_learner(
    algorithm: Algorithm, settings: Hyperparameters, env: Any, build: Build
) -> Learner:
    """The learner of an algorithm; its discount is that of a step, two of which are a round of
    turns, while the discount of settings is that of a round."""
    each = env.simulator.task.steps_per_round
    return algorithm.build(settings.per_step(each) if each > 1 else settings, env, build)


ALGORITHMS: dict[str, Algorithm] = {}


def _names_of(condition: Callable[[Algorithm], bool]) -> list[str]:
    """The names of the algorithms for which a condition holds."""
    able = {name: each for name, each in ALGORITHMS.items() if name != "tracked"}
    return [name for name, algorithm in able.items() if condition(algorithm)]


def register(algorithm: Algorithm) -> None:
    """Add an algorithm to `ALGORITHMS`.

    Raises:
        ValueError: the name is used by another algorithm.
    """
    known = HYPERPARAMETERS.setdefault(algorithm.name, algorithm.settings)
    check(
        known is algorithm.settings and algorithm.name not in ALGORITHMS,
        f"an algorithm named {algorithm.name!r} exists already; use another name",
    )
    ALGORITHMS[algorithm.name] = algorithm


def entry(name: str) -> Algorithm:
    """An algorithm by name, built-in or user-defined; ValueError for an unknown one."""
    if isinstance(name, str) and name in ALGORITHMS:  # files may hold anything
        return ALGORITHMS[name]
    custom = LEARNERS.get(name)
    check(isinstance(custom, Algorithm), f"algorithm {name!r} is {custom!r}; give {LEARNERS.needs}")
    return replace(custom, name=name)


def _ours(name: str, build: Any, network_of: Any = None, load: Any = None, **able: Any) -> None:
    """Register an algorithm whose policy is the network that `network_of` makes, or its `load`."""
    load = load or network_loader(network_of)
    register(Algorithm(name, HYPERPARAMETERS[name], build, load, **able))


_BOTH: Any = {"actions": frozenset({"discrete", "continuous"})}
_CONTINUOUS: Any = {"actions": frozenset({"continuous"})}
_GREEDY: Any = {"learns_distribution": False}
_ROLLOUTS: Any = {"has_advantages": True, "self_play": True, "teams": True, "imitates": True}

_ours("ppo", ppo.PPO.build, ppo.PPO.network_of, **_ROLLOUTS, **_BOTH, recurrent=True)
_ours("a2c", a2c.A2C.build, a2c.A2C.network_of, **_ROLLOUTS, **_BOTH, recurrent=True)
_ours("reinforce", a2c.Reinforce.build, a2c.Reinforce.network_of, **_BOTH, imitates=True)
_ours("dqn", dqn.DQN, dqn.DQN.network_of, **_GREEDY, self_play=True)
_ours(
    "q_learning",
    q_learning.QLearning,
    load=q_learning.load,
    **_GREEDY,
    tabular=True,
    check_player=q_learning.check_seat,
)
_ours(
    "cross_entropy",
    cross_entropy.CrossEntropy,
    cross_entropy.network_of,
    **_BOTH,
    check_player=cross_entropy.check_seat,
)
_ours("ddpg", continuous.DDPG, continuous.DDPG.network_of, **_GREEDY, **_CONTINUOUS)
_ours("td3", continuous.TD3, continuous.TD3.network_of, **_GREEDY, **_CONTINUOUS)
_ours("sac", continuous.SAC, continuous.SAC.network_of, **_CONTINUOUS)
_ours("mmd", regularized.MMD.build, regularized.MMD.network_of, **_ROLLOUTS)
_ours("rnad", regularized.RNaD.build, regularized.RNaD.network_of, **_ROLLOUTS)
_ours("ippo", ippo.IPPO.build, ippo.IPPO.network_of, **_ROLLOUTS, recurrent=True)
_ours("mappo", mappo.MAPPO.build, mappo.MAPPO.network_of, **_ROLLOUTS, recurrent=True)
_ours("iql", iql.IQL, iql.IQL.network_of, **_GREEDY, self_play=True, teams=True)
_ours("vdn", vdn.VDN, vdn.VDN.network_of, **_GREEDY, self_play=True, teams=True)
_ours("qmix", qmix.QMIX, qmix.QMIX.network_of, **_GREEDY, self_play=True, teams=True)
_ours("nfsp", nfsp.NFSP, nfsp.NFSP.network_of, self_play=True)
_ours("tracked", tracked.TrackedLearner, load=tracked.load, **_GREEDY, **_BOTH)
_ours("cleanrl_ppo", cleanrl.CleanRLPPO, cleanrl.network_of, own_loop=True, package="torch")
_ours(
    "sb3_ppo",
    stable_baselines.StableBaselinesPPO,
    stable_baselines.network_of,
    own_loop=True,
    package="stable_baselines3",
    extra="sb3",
)
