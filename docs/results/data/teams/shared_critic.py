"""A central critic that shares the hidden layers of the policy: the fourth cell of the study.

With full view the observation `index+id` and the state of MAPPO's critic list the cells of the same
agents in another order, so that the same layers can read both.
"""

from __future__ import annotations

from typing import Any

from train.algorithms.learner import Build, network_loader
from train.algorithms.mappo import MAPPO
from train.algorithms.registry import Algorithm
from train.networks.actor_critic import ActorCritic
from train.settings.algorithms import MAPPOSettings


class SharedLayers(ActorCritic):
    """Different from `ActorCritic`: one trunk reads the own observation for the policy, and the
    state for the value."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.value_trunk = self.policy_trunk

    @property
    def shared(self) -> bool:
        """False: the value is not one of the hidden units of the policy's observation."""
        return False


class SharedMAPPO(MAPPO):
    """Different from `MAPPO`: the hidden layers of the policy are those of the critic."""

    @staticmethod
    def network_of(settings: Any, seat: Any, build: Build) -> ActorCritic:
        """As of `MAPPO`, with `SharedLayers`."""
        sizes = (seat.features, seat.num_actions, build.hidden(settings))
        return SharedLayers(*sizes, critic=seat.critic_features).to(build.device)


SHARED_MAPPO = Algorithm(
    "shared_mappo",
    MAPPOSettings,
    SharedMAPPO.build,
    network_loader(SharedMAPPO.network_of),
    has_advantages=True,
)
