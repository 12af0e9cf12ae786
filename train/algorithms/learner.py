"""What every learner is to a run, and what the games are to a learner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from pursuit.simulator.policy import Policy
from train.environments.hooks import EpisodeHook
from train.networks.layers import Hidden
from train.networks.policy import Network, Player
from train.settings.algorithms import NetworkSettings


class VecEnv(Protocol):
    """A batched TorchRL environment (an `EnvBase`), with what learners ask beside its specs.

    Attributes:
        player: who learns.
        hook: whoever changes the next episodes.
        num_games: in lockstep.
        resume: set it to have the next full reset go on with the games as they stand.
    """

    hook: EpisodeHook
    num_games: int
    resume: bool

    @property
    def player(self) -> Player:
        """Who learns."""

    @property
    def observation_spec(self) -> Any:
        """TorchRL's spec of what is observed."""

    @property
    def action_spec(self) -> Any:
        """TorchRL's spec of actions."""

    def reset(self) -> Any:
        """Begin all games anew; a TensorDict of what is observed."""

    def step_and_maybe_reset(self, tensordict: Any) -> Any:
        """A step with "action", which writes "next", and what the step after it begins with."""

    def step_episodes(self, actions: torch.Tensor, running: torch.Tensor) -> Any:
        """A step without restarts, for learners from whole episodes."""


def has_masks(env: Any) -> bool:
    """Whether a TorchRL environment says in "action_mask" what may be done."""
    return ACTION_MASK in env.observation_spec.keys()  # noqa: SIM118 (its `in` wants .keys())


class Learner(Protocol):
    """One algorithm in one seat of a batch of games, or in all seats of a role.

    Attributes:
        frames: environment steps taken, all games counted.
    """

    frames: int

    def iterate(self, progress: float) -> dict[str, float]:
        """Play and learn for a moment; `progress` in [0, 1] through the budget.

        Returns:
            Figures for the log: losses and the like.
        """

    def policy(self, greedy: bool = True) -> Policy:
        """What was learned so far; it follows the learner as it goes on.

        Raises:
            ValueError: not greedy, of a learner of no distribution.
        """

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values: what a resumed learner needs to go on exactly.

        All tensors are finite: anything else is taken for the end of learning.
        The games and torch's random state are kept by the run.
        """

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` gave; any of `MISFITS` where it does not fit."""

    def close(self) -> None:
        """Let go of whatever is held open."""


@dataclass(frozen=True)
class Build:
    """How a learner is to be built on this machine.

    Attributes:
        device: where the network lives.
        bfloat16: matrix products in bfloat16.
        first_layer: "bag", "dense", or "auto" for the faster.
        seed: of what the learner itself draws (networks draw from torch's generator).
        fused: whether kernels of ours may compute updates where they can; False takes torch.
    """

    device: str = "cpu"
    bfloat16: bool = False
    first_layer: str = "auto"
    seed: int = 0
    fused: bool = True

    def hidden(self, settings: NetworkSettings) -> Hidden:
        """The hidden layers that the settings ask for."""
        form: Any = None if self.first_layer == "auto" else self.first_layer
        rest = (settings.activation, settings.first_std, form, self.bfloat16, settings.recurrent)
        return Hidden(settings.width, *rest)


def network_loader(
    network_of: Callable[[Any, Player, Build], Network],
) -> Callable[[Any, Player, dict[str, Any], bool], Policy]:
    """What makes a policy, on the CPU, of the state of a learner whose networks `network_of` makes.

    It raises one of `MISFITS` for the state of other settings.
    """

    def load(settings: Any, player: Player, state: dict[str, Any], greedy: bool = True) -> Policy:
        network = network_of(settings, player, Build())
        network.load_state_dict(state["network"])
        return player.policy(network, greedy)

    return load


def clip_gradients(parameters: list[torch.nn.Parameter], most: float) -> None:
    """Scale gradients down to the norm `most`: torch's `clip_grad_norm_`, in three operations.

    Args:
        parameters: whose gradients.
        most: the norm.
    """
    gradients: Any = [weight.grad for weight in parameters if weight.grad is not None]
    norm = torch.linalg.vector_norm(torch.stack(torch._foreach_norm(gradients)))
    scale = (most / (norm + 1e-6)).clamp(max=1.0)
    if not scale.is_cpu or float(scale) != 1.0:  # a GPU is not waited for
        torch._foreach_mul_(gradients, scale)


def step_adam(optimizer: torch.optim.Adam) -> None:
    """`optimizer.step()` of a fused Adam, without all that it looks up every time on the CPU.

    That takes several times as long as the step itself of a network of 128 units.
    """
    group, state = optimizer.param_groups[0], optimizer.state
    weights = group["params"]
    gradients = [weight.grad for weight in weights]
    plain = not (group["amsgrad"] or group["maximize"] or group["weight_decay"])
    known = all(g is not None and w in state for w, g in zip(weights, gradients, strict=True))
    if not (plain and known and group["fused"] and weights[0].is_cpu):
        optimizer.step()
        return
    moments = [state[weight] for weight in weights]
    first, second, steps = (
        [moment[name] for moment in moments] for name in ("exp_avg", "exp_avg_sq", "step")
    )
    beta1, beta2 = group["betas"]
    with torch.no_grad():
        torch._foreach_add_(steps, 1)
        torch._fused_adam_(
            weights, gradients, first, second, [], steps,
            lr=group["lr"], beta1=beta1, beta2=beta2, weight_decay=0.0,
            eps=group["eps"], amsgrad=False, maximize=False, grad_scale=None, found_inf=None,
        )  # fmt: skip


class NetworkLearner:
    """What the learners with a network and Adam share.

    Args:
        settings: the hyperparameters.
        env: the games.
        network: what learns.
        device: where it lives.
    """

    def __init__(
        self, settings: NetworkSettings, env: VecEnv, network: Network, device: str
    ) -> None:
        self.env, self.network, self.device = env, network, device
        self._descent = settings
        self.frames = 0
        self.optimizer = torch.optim.Adam(
            network.parameters(), lr=settings.learning_rate, eps=settings.adam_epsilon, fused=True
        )

    @property
    def update_form(self) -> str:
        """What computes a gradient step: "torch", or "fused" kernels of ours."""
        return "torch"

    def annealed(self, value: float, progress: float) -> float:
        """`value` on its way to 0, where the settings want that."""
        return linear(value, 0.0, progress) if self._descent.anneal else value

    def descend(self, loss: torch.Tensor) -> None:
        """One step of Adam, with the gradient scaled down to `max_grad_norm`."""
        # To list a network's parameters takes longer than the norm of a gradient.
        weights = self.optimizer.param_groups[0]["params"]
        for weight in weights:
            weight.grad = None
        torch.autograd.backward(loss)
        self.descend_by_gradients()

    def descend_by_gradients(self) -> None:
        """One step of Adam with the gradients that all weights have, scaled down likewise."""
        weights = self.optimizer.param_groups[0]["params"]
        clip_gradients(weights, self._descent.max_grad_norm)
        step_adam(self.optimizer)
        # A fused step does not count as a change of the weights, which cached tables of a policy
        # are compared by.
        torch.autograd.graph.increment_version(weights)

    def set_schedules(self, progress: float) -> None:
        """Set learning rates, and of who learns from rollouts the discount, to those of now:
        `progress` in [0, 1] through the budget."""
        self.optimizer.param_groups[0]["lr"] = self.annealed(self._descent.learning_rate, progress)

    def policy(self, greedy: bool = True) -> Policy:
        """The network as the player."""
        return self.env.player.policy(self.network, greedy)

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
