"""The learning agent of an arm, and policies that move the arm by a trained network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from pursuit.reacher.observations import space_of
from pursuit.reacher.policy import ArmView
from pursuit.reacher.simulator import ReacherSimulator
from pursuit.reacher.task import ReacherTask
from pursuit.rules.arrays import Array
from train.networks.features import Features, features_for
from train.networks.layers import float32_inference
from train.networks.policy import ActionNetwork, PolicyNetwork, logits_of
from train.networks.recurrent_policy import chosen_from, probabilities_of
from train.networks.seat import Seat


@dataclass(frozen=True)
class ArmSeat(Seat):
    """The agent that moves an arm.

    Attributes:
        task: the rules and settings.
        encoding: its observation.
        network: its network, by the name in the settings.
    """

    task: ReacherTask
    encoding: str = "positions"
    network: str = "auto"
    agent: ClassVar[str] = "arm"  # type: ignore[misc]
    NO_MEMORY: ClassVar[str] = "an arm, which is fully observable"

    @property
    def continuous(self) -> bool:  # type: ignore[override]
        """Whether the task has continuous actions."""
        return not self.task.discrete_actions

    @property
    def num_actions(self) -> int:
        """One number for each joint; with discrete actions, the number of combinations."""
        return self.task.joints if self.continuous else self.task.num_choices

    @cached_property
    def features(self) -> Features:
        """The features of its encoding, unscaled, in link lengths and radians.

        Scaled to [-1, 1], differences near the target are too small to learn from: in 40 s of PPO
        (one core) an arm of 8 joints reached 87 % of its targets; scaled, in 60 s, 57 %.
        """
        shape = space_of(self.task, self.encoding).shape
        return features_for(Features("flat", shape, np.ones(shape)), self.network)

    def bounds(self, batch: ReacherSimulator) -> tuple[Array, Array]:
        """As of `Seat`."""
        space = space_of(batch.task, self.encoding)
        return space.low, space.high

    def observe(self, batch: ReacherSimulator, agents: slice) -> Array:
        """As of `Seat`."""
        return batch.observe(self.encoding)[:, None]

    def moves(self, actions: NDArray[Any]) -> Array:
        """As of `Seat`: the turns of the joints."""
        return actions if self.continuous else self.task.actions_of(actions)

    def policy(self, network: Any, greedy: bool = True) -> ArmNetworkPolicy:
        """A policy from an `ActionNetwork`, or with discrete actions from a `PolicyNetwork`."""
        return ArmNetworkPolicy(network, self, greedy)


class ArmNetworkPolicy:
    """A policy that moves an arm by a network.

    Args:
        network: gives actions, or logits if the task's actions are discrete.
        seat: the one that it was trained in.
        greedy: deterministic actions; False draws them.
    """

    def __init__(
        self, network: ActionNetwork | PolicyNetwork, seat: ArmSeat, greedy: bool = True
    ) -> None:
        self.network: Any = network
        self.seat, self.greedy, self.task = seat, greedy, seat.task

    def act(self, view: ArmView) -> NDArray[np.float64]:
        """[num_games, joints] float64 in [-1, 1]; random numbers from the view.

        Raises:
            ValueError: the arm is not that of the training.
        """
        own, task = self.task, view.task
        if (task.joints, task.discrete_actions) != (own.joints, own.discrete_actions):
            raise ValueError(
                f"this policy is for an arm of {own.joints} joint(s), discrete_actions="
                f"{own.discrete_actions}; the arm has {task.joints} joint(s), discrete_actions="
                f"{task.discrete_actions}; use the arm of the training"
            )
        observed = view.observe(self.seat.encoding)
        if not self.seat.continuous:
            chances = probabilities_of(logits_of(self.network, observed), None, self.greedy)
            draws = None if self.greedy else view.uniform()
            return task.actions_of(chosen_from(chances, draws))
        device, noise = next(self.network.parameters()).device, None
        if not self.greedy:
            noise = torch.from_numpy(view.normal()).float().to(device)
        with float32_inference(self.network):
            acted: torch.Tensor = self.network.act(torch.from_numpy(observed).to(device), noise)
        return acted.double().clamp(-1.0, 1.0).cpu().numpy()
