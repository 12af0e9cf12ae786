"""IPPO: independent PPO of all agents of a role."""

from __future__ import annotations

from typing import Any

from train.algorithms.learner import Build
from train.algorithms.ppo import PPO
from train.networks.actor_critic import ActorCritic
from train.networks.seat import Seat
from train.networks.separate import network_of_team


class IPPO(PPO):
    """De Witt et al. (2020), "Is independent learning all you need in the StarCraft multi-agent
    challenge?"

    Every agent of a role learns by PPO from its own observations and rewards, with a value of its
    own observation, as if the others were part of the environment. A frame of an agent is a row of
    a rollout; agents that have left their game have none. Different from `PPO`: the agents may have
    a network each (`TeamSettings.sharing`).
    """

    @staticmethod
    def network_of(settings: Any, seat: Seat, build: Build) -> ActorCritic:
        """As of PPO; with separate networks one for each agent, as `SeparateNetworks`."""
        return network_of_team(PPO.network_of, settings, seat, build)
