"""The algorithms by name: their settings, how each is built and loaded, and what it can do.

A new learner is a file with its settings, its class and its `build`, and one entry here; command
line, run folders, sweeps and reports follow. A user's own is an `Algorithm` in a module of his, and
is called `package.module:Name`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pursuit.simulator.policy import Policy
from train.algorithms import a2c, continuous, cross_entropy, dqn, ppo, q_learning
from train.algorithms.learner import Build, Learner, network_loader
from train.algorithms.rollouts import actor_critic_of
from train.networks.policy import Player, Seat
from train.settings.algorithms import (
    HYPERPARAMETERS,
    LEARNERS,
    A2CSettings,
    CrossEntropySettings,
    DDPGSettings,
    DQNSettings,
    Hyperparameters,
    PPOSettings,
    QLearningSettings,
    ReinforceSettings,
    SACSettings,
    TD3Settings,
)
from train.settings.checks import check

__all__ = ["ALGORITHMS", "Algorithm", "Build", "algorithm_of", "entry", "register"]


@dataclass(frozen=True)
class Algorithm:
    """What is known of an algorithm before it is built.

    Attributes:
        name: on the command line and in `config.json`.
        settings: the class of its hyperparameters.
        build: (settings, env, Build) -> the learner over its games.
        load: (settings, player, state, greedy) -> the policy in what the learner's `state_dict`
            gave, on the CPU; KeyError or RuntimeError for a state of other settings.
        learns_distribution: whether there is a policy other than the greedy one.
        whole_episodes: it learns from episodes that are played to their end.
        has_advantages: it tells them to the hook of its games.
        self_play: it can learn against an opponent that learns.
        teams: it can learn for several agents of a role at once.
        one_maze: it has a table for one maze.
        cpu_only: it has nothing to put on a GPU.
        recurrent: its network can remember (`recurrent` of its settings).
        observations: the encodings that it can use; None for all.
        actions: the kinds of actions that it can learn: "discrete", "continuous".
        check_player: (settings, player) raises ValueError for a player that it cannot learn to be.
    """

    name: str
    settings: type[Hyperparameters]
    build: Callable[[Any, Any, Build], Learner]
    load: Callable[[Any, Any, dict[str, Any], bool], Policy]
    learns_distribution: bool = True
    whole_episodes: bool = False
    has_advantages: bool = False
    self_play: bool = False
    teams: bool = False
    one_maze: bool = False
    cpu_only: bool = False
    recurrent: bool = False
    observations: tuple[str, ...] | None = None
    actions: frozenset[str] = frozenset({"discrete"})
    check_player: Callable[[Any, Any], object] = lambda settings, player: None

    def check(self, *, observation: str, device: str = "cpu", greedy: bool = True) -> None:
        """Raise ValueError for what it cannot do: an observation, a device, a sampled policy."""
        check(
            greedy or self.learns_distribution,
            f"evaluate='sampled'; {self.name} learns no distribution over actions",
        )
        check(
            device == "cpu" or not self.cpu_only,
            f"device={device!r}; {self.name} runs on the cpu only",
        )
        check(
            self.observations is None or observation in self.observations,
            f"observation={observation!r}; {self.name} has a table over states, not over "
            "observations; leave it out"
            if self.one_maze
            else f"observation={observation!r}; {self.name} can use "
            f"{', '.join(self.observations or ())}",
        )

    def check_actions(self, player: Player) -> None:
        """Raise ValueError where it cannot choose such actions as `player`'s."""
        kind = "continuous" if player.continuous else "discrete"
        in_maze = isinstance(player, Seat)
        able = [
            name
            for name, other in ALGORITHMS.items()
            if kind in other.actions and (in_maze or not other.one_maze)
        ]
        turned = player.continuous and "discrete" in self.actions and not self.one_maze
        check(
            kind in self.actions,
            f"algorithm={self.name!r} cannot choose {kind} actions; take {' or '.join(able)}"
            + (", or discrete_actions=True" if turned else ""),
        )
        check(
            in_maze or not self.one_maze,
            f"algorithm={self.name!r} has a table over the cells of a maze, and there is none "
            f"here; take {' or '.join(able)}",
        )

    def check_memory(self, settings: Hyperparameters, player: Player) -> None:
        """Raise ValueError where `settings` want a memory that it, or the player, cannot have."""
        check(
            not self.one_maze or not isinstance(player, Seat) or not player.features.network,
            f"{self.name} has a table over states, and no network; leave network out",
        )
        check(
            not self.one_maze or not isinstance(player, Seat) or player.frame_stack == 1,
            f"{self.name} has a table over states, which has no place for what was observed before "
            "(frame_stack); leave it out",
        )
        if settings.recurrent is None:
            return
        able = [name for name, other in ALGORITHMS.items() if other.recurrent]
        check(
            self.recurrent,
            f"recurrent={settings.recurrent!r}; {self.name} learns no memory: take "
            f"{', '.join(able[:-1])} or {able[-1]}"
            + ("" if self.one_maze else ", or frame_stack in its place"),
        )
        check(
            isinstance(player, Seat),
            f"recurrent={settings.recurrent!r} on an arm, which sees all that there is; leave it "
            "out",
        )

    def check_self_play(self, role: str, agents: int) -> None:
        """Raise ValueError unless it can learn for so many agents of `role` in self-play."""
        able = [name for name, other in ALGORITHMS.items() if other.self_play]
        check(
            self.self_play,
            f"{role}_algorithm={self.name!r}; of {', '.join(ALGORITHMS)} only "
            f"{', '.join(able[:-1])} and {able[-1]} learn in self-play",
        )
        check(
            self.teams or agents == 1,
            f"{role}_algorithm={self.name!r} with {agents} {role}s; several agents of a role learn "
            f"by {' or '.join(name for name in able if ALGORITHMS[name].teams)}",
        )


ALGORITHMS: dict[str, Algorithm] = {}


def register(algorithm: Algorithm) -> None:
    """Take an algorithm in.

    Raises:
        ValueError: the name stands for other settings already.
    """
    known = HYPERPARAMETERS.setdefault(algorithm.name, algorithm.settings)
    check(
        known is algorithm.settings and algorithm.name not in ALGORITHMS,
        f"an algorithm called {algorithm.name!r} is there already; rename one",
    )
    ALGORITHMS[algorithm.name] = algorithm


def entry(name: str) -> Algorithm:
    """An algorithm by its name, or a user's own; ValueError naming the known ones for another."""
    if name in ALGORITHMS:
        return ALGORITHMS[name]
    found = LEARNERS.get(name)
    check(
        isinstance(found, Algorithm),
        f"algorithm {name!r} is {found!r}; it must be {LEARNERS.needs}",
    )
    return replace(found, name=name)


def algorithm_of(settings: Hyperparameters) -> Algorithm:
    """The algorithm that hyperparameters belong to; ValueError for none."""
    for algorithm in ALGORITHMS.values():
        if type(settings) is algorithm.settings:
            return algorithm
    raise ValueError(f"no algorithm has settings of {type(settings).__name__}")


BOTH = frozenset({"discrete", "continuous"})
_LOAD_ACTOR_CRITIC = network_loader(actor_critic_of)

register(
    Algorithm(
        "ppo",
        PPOSettings,
        ppo.build,
        network_loader(ppo.network_of),
        has_advantages=True,
        self_play=True,
        teams=True,
        actions=BOTH,
        recurrent=True,
    )
)
register(
    Algorithm(
        "a2c",
        A2CSettings,
        a2c.build_a2c,
        _LOAD_ACTOR_CRITIC,
        has_advantages=True,
        self_play=True,
        teams=True,
        actions=BOTH,
        recurrent=True,
    )
)
register(
    Algorithm(
        "reinforce",
        ReinforceSettings,
        a2c.build_reinforce,
        _LOAD_ACTOR_CRITIC,
        whole_episodes=True,
        actions=BOTH,
        recurrent=True,
    )
)
register(
    Algorithm(
        "dqn",
        DQNSettings,
        dqn.build,
        network_loader(dqn.network_of),
        learns_distribution=False,
        self_play=True,
        recurrent=True,
    )
)
register(
    Algorithm(
        "cross_entropy",
        CrossEntropySettings,
        cross_entropy.build,
        network_loader(cross_entropy.network_of),
        whole_episodes=True,
        cpu_only=True,
        actions=BOTH,
    )
)
register(
    Algorithm(
        "q_learning",
        QLearningSettings,
        q_learning.build,
        q_learning.load,
        learns_distribution=False,
        one_maze=True,
        cpu_only=True,
        observations=("index",),
        check_player=q_learning.check_player,
    )
)
register(
    Algorithm(
        "ddpg",
        DDPGSettings,
        continuous.build_ddpg,
        network_loader(continuous.deterministic_of),
        learns_distribution=False,
        actions=frozenset({"continuous"}),
    )
)
register(
    Algorithm(
        "td3",
        TD3Settings,
        continuous.build_td3,
        network_loader(continuous.deterministic_of),
        learns_distribution=False,
        actions=frozenset({"continuous"}),
    )
)
register(
    Algorithm(
        "sac",
        SACSettings,
        continuous.build_sac,
        network_loader(continuous.gaussian_of),
        actions=frozenset({"continuous"}),
    )
)
