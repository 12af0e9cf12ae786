"""MAPPO: PPO of all agents of a role with a central critic."""

from __future__ import annotations

from typing import Any

from train.algorithms.ippo import IPPO
from train.algorithms.learner import Build
from train.algorithms.rollouts import actor_critic_of
from train.networks.actor_critic import ActorCritic
from train.networks.separate import network_of_team


class MAPPO(IPPO):
    """Yu et al. (2022), "The surprising effectiveness of PPO in cooperative multi-agent games".

    Different from `IPPO`: the value is one of the state (`MAPPOSettings.critic_observation`), which
    policies need not see. It is needed in training only.
    """

    @staticmethod
    def network_of(settings: Any, seat: Any, build: Build) -> ActorCritic:
        """As of IPPO, with a trunk of the central critic's observation for the value."""
        critic = seat.critic_features
        return network_of_team(actor_critic_of, settings, seat, build, critic)
