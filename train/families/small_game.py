"""Small games, whose states are all enumerated."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from typing import Any, ClassVar

from pursuit.validation import check
from scripted_agents.games.agents import TableAgent, named_agent
from scripted_agents.games.simulator import GameSimulator, GameTask
from scripted_agents.names import GAME_AGENTS as AGENTS
from scripted_agents.names import is_custom_policy
from train.evaluation.return_sides import SmallGameSides, reward_scale
from train.evaluation.small_game_contest import SmallGameContest
from train.families.family import Family
from train.families.game_world import GameWorld
from train.families.policies import NamedPolicies
from train.networks.small_game_policy import SmallGameSeat
from train.settings.checks import EVALUATION_SEED
from train.settings.run import AgentSettings
from train.settings.task import SmallGameSettings
from train.teaching.context import SmallGameContext


def seat_of(settings: AgentSettings) -> SmallGameSeat:
    """The learning player of a run."""
    given = settings.task
    task = given.build()
    how = (settings.observation, settings.network, settings.min_probability or 0.0)
    return SmallGameSeat(task, given.agent_in(task), *how)


@dataclass(frozen=True)
class SmallGameWorld(GameWorld):
    """A small game with the policies of the other players."""

    BATCH: ClassVar[Any] = GameSimulator

    @property
    def context(self) -> SmallGameContext:
        """As of `World`."""
        epsilon = self.settings.opponent_epsilon
        return SmallGameContext(self.task, self.agent, self.opponents, epsilon)

    @property
    def scale(self) -> float:  # type: ignore[override]
        """As of `World`."""
        return reward_scale(self.task, self.agent, self.settings.discount)

    def contest(self, episodes: int, seed: int = EVALUATION_SEED) -> SmallGameContest:
        """As of `World`."""
        return SmallGameContest(self.task, self.agent, self.opponents, episodes, seed)


def is_named(name: str) -> bool:
    """Whether a name is that of a policy of players, built-in or user-defined."""
    return name in AGENTS or is_custom_policy(name)


def players_of(name: str, task: GameTask) -> tuple[str, ...]:
    """The players that the policy of this name can play; ValueError for none."""
    found, refused = list[str](), ValueError()
    for player in task.agent_names:
        try:
            named_agent(name, task, player)
            found.append(player)
        except ValueError as error:
            refused = error
    if not found:
        raise refused
    return tuple(found)


def placed(policy: Any, task: GameTask, player: str, name: str, epsilon: float) -> TableAgent:
    """A learned policy as a table, with random actions; ValueError if it is of another player."""
    check(
        policy.agent == player,
        f"{name}: is a policy of {policy.agent}, not of {player}; give another",
    )
    return TableAgent(task, player, policy.table(task), epsilon, policy.name)


PLAYER_OF, MODELS = attrgetter("agent"), {".onnx": SmallGameSeat}
SMALL_GAME_POLICIES = NamedPolicies(
    SmallGameSettings, AGENTS, is_named, named_agent, players_of, placed, PLAYER_OF, MODELS
)
SmallGameWorld.POLICIES = SMALL_GAME_POLICIES
FAMILY = Family(SmallGameSettings, seat_of, SmallGameWorld, SMALL_GAME_POLICIES, SmallGameSides)
