"""What every learner is to a run."""

from __future__ import annotations

from typing import Any, Protocol

import torch
from torch import nn

from curricula import linear
from pursuit.policy import Policy
from train.environments.simulator_env import SimulatorEnv
from train.networks.policy import LearnedPolicy, PolicyNetwork
from train.settings.algorithms import NetworkSettings


class Learner(Protocol):
    """One algorithm in one seat of a batch of games.

    Attributes:
        frames: environment steps taken, all games counted.
        stochastic: whether `policy(greedy=False)` exists.
    """

    frames: int
    stochastic: bool

    def iterate(self, progress: float) -> dict[str, float]:
        """Play and learn for a moment; `progress` in [0, 1] through the budget.

        Returns:
            Figures for the log: losses and the like.
        """

    def policy(self, greedy: bool = True) -> Policy:
        """What was learned so far; it follows the learner as it goes on."""

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values: what a resumed learner needs to go on exactly.

        The games and torch's random state are kept by the run.
        """

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` gave; KeyError or RuntimeError where it does not fit."""

    def close(self) -> None:
        """Let go of whatever is held open."""


class NetworkLearner:
    """What the learners with a network and Adam share.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: what learns.
        device: where it lives.
    """

    stochastic = True

    def __init__(
        self, settings: NetworkSettings, env: SimulatorEnv, network: PolicyNetwork, device: str
    ) -> None:
        self.env, self.network, self.device = env, network, device
        self._descent = settings
        self.frames = 0
        self.renew_optimizer()

    def renew_optimizer(self) -> None:
        """Adam on the parameters that the network has now, without moments."""
        settings = self._descent
        self.optimizer = torch.optim.Adam(
            self.network.parameters(),
            lr=settings.learning_rate,
            eps=settings.adam_epsilon,
            fused=True,
        )

    def annealed(self, value: float, progress: float) -> float:
        """`value` on its way to 0, where the settings want that."""
        return linear(value, 0.0, progress) if self._descent.anneal else value

    def descend(self, loss: torch.Tensor) -> None:
        """One step of Adam, with the gradient scaled down to `max_grad_norm`."""
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), self._descent.max_grad_norm)
        self.optimizer.step()

    def set_learning_rate(self, progress: float) -> None:
        """Anneal it."""
        self.optimizer.param_groups[0]["lr"] = self.annealed(self._descent.learning_rate, progress)

    def policy(self, greedy: bool = True) -> LearnedPolicy:
        """The network in the learner's seat."""
        task, seat = self.env.simulator.task, self.env.seat
        return LearnedPolicy(self.network, task, task.agent_names[seat], self.env.encoding, greedy)

    def state_dict(self) -> dict[str, Any]:
        """Weights, Adam's moments and the frames."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "frames": self.frames,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take them back."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.frames = state["frames"]

    def close(self) -> None:
        """Nothing is held open."""


def means(logged: list[dict[str, torch.Tensor]]) -> dict[str, float]:
    """The mean of every figure over the gradient steps."""
    return {
        name: float(torch.stack([figures[name] for figures in logged]).mean())
        for name in (logged[0] if logged else ())
    }
