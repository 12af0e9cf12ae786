"""Small games, whose states are all enumerated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np

from pursuit.validation import Missing, check
from scripted_agents.environments import is_custom_policy
from scripted_agents.games.agents import AGENTS, TableAgent, named_agent
from scripted_agents.games.episodes import return_range
from scripted_agents.games.simulator import GameSimulator, GameTask, StatePolicy
from scripted_agents.games.small_game import KEPT
from train.evaluation.small_game_contest import SmallGameContest
from train.families.family import Family, NamedPolicies, World
from train.families.policies import policy_named
from train.networks.seat import Seat
from train.networks.small_game_policy import SmallGameSeat
from train.settings.checks import EVALUATION_SEED
from train.settings.run import AgentSettings
from train.settings.task import SmallGameSettings
from train.teaching.context import SmallGameContext
from train.teaching.teacher import EpisodeMetrics


def seat_of(settings: AgentSettings) -> SmallGameSeat:
    """The learning player of a run."""
    given = settings.task
    task = given.build()
    how = (settings.observation, settings.network, settings.min_probability or 0.0)
    return SmallGameSeat(task, given.agent_in(task), *how)


@lru_cache(maxsize=2 * KEPT)
def reward_scale(task: GameTask, player: str, discount: float) -> float:
    """The factor of a player's rewards in training with which all its returns lie in [-1, 1].

    They are the units of the coefficients of losses; large returns would make the value loss
    dominate. Without discount (1) returns are those within `max_steps`.
    """
    horizon = task.horizon(discount)
    largest = float(np.abs(return_range(task.game, player, discount, horizon)).max())
    return 1.0 / largest if largest > 0.0 else 1.0


@dataclass(frozen=True)
class SmallGameWorld(World):
    """A small game with the policies of the other players."""

    BATCH: ClassVar[Any] = GameSimulator

    @cached_property
    def opponents(self) -> dict[str, StatePolicy]:
        """As of `World`."""
        given = self.settings
        how = (given.opponent_epsilon, given.opponent_policy)
        return {
            name: policy_named(POLICIES, self.saved, given.opponent, self.task, name, *how)
            for name in self.task.agent_names
            if name != self.agent
        }

    @property
    def context(self) -> SmallGameContext:
        """As of `World`."""
        epsilon = self.settings.opponent_epsilon
        return SmallGameContext(self.task, self.agent, self.opponents, epsilon)

    def policies(self, seat: Seat) -> list[StatePolicy | None]:
        """As of `World`."""
        return [self.opponents.get(name) for name in self.task.agent_names]

    def metrics(self, seat: Seat) -> EpisodeMetrics:
        """As of `World`."""
        number = seat.number
        return EpisodeMetrics(
            lambda games: games.returns[:, number] > games.returns.mean(axis=1),
            lambda games: games.returns[:, number],
        )

    @property
    def scale(self) -> float:  # type: ignore[override]
        """As of `World`."""
        return reward_scale(self.task, self.agent, self.settings.discount)

    def bounded(self, discount: float) -> bool:
        """As of `World`: without discount returns are those within the time limit."""
        return discount == 1.0

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> SmallGameContest:
        """As of `World`."""
        return SmallGameContest(self.task, self.agent, self.opponents, episodes, seed)


def is_named(name: str) -> bool:
    """Whether a name is that of a policy of players, built-in or user-defined."""
    return name in AGENTS or is_custom_policy(name)


def placed(policy: Any, task: GameTask, player: str, name: str, epsilon: float) -> TableAgent:
    """A learned policy as a table, with random actions; ValueError if it is of another player."""
    check(
        policy.agent == player,
        f"{name}: is a policy of {policy.agent}, not of {player}; give another",
    )
    return TableAgent(task, player, policy.table(task), epsilon, policy.name)


NO_MODELS = Missing("a saved model plays in mazes; give the folder of a run of this game")
POLICIES = NamedPolicies(SmallGameSettings, AGENTS, is_named, named_agent, placed, NO_MODELS)
FAMILY = Family(SmallGameSettings, seat_of, SmallGameWorld, POLICIES)
