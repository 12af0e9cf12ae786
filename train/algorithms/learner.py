"""The interface between learners, runs and environments."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch

from curricula import linear
from pursuit.observations.masks import ACTION_MASK
from pursuit.simulator.policy import Policy
from pursuit.validation import raised
from train.environments.hooks import EpisodeHook
from train.networks.layers import Hidden
from train.networks.policy import Network, Player
from train.settings.algorithms import NetworkSettings


class VecEnv(Protocol):
    """A batched TorchRL environment (an `EnvBase`), with the additional attributes of learners.

    Attributes:
        player: the learning agent.
        hook: configures the next episodes.
        num_games: number of parallel games.
        resume: if set, the next full reset continues the current episodes.
    """

    hook: EpisodeHook
    num_games: int
    resume: bool

    @property
    def player(self) -> Player:
        """The learning agent."""

    @property
    def observation_spec(self) -> Any:
        """TorchRL's spec of the observations."""

    @property
    def action_spec(self) -> Any:
        """TorchRL's spec of the actions."""

    def reset(self) -> Any:
        """Reset all games; a TensorDict of observations."""

    def step_and_maybe_reset(self, tensordict: Any) -> Any:
        """A step with "action", which writes "next"; also returns the input of the next step."""

    def step_episodes(self, actions: torch.Tensor, running: torch.Tensor) -> Any:
        """A step without restarts, for learning from whole episodes."""


def has_masks(env: Any) -> bool:
    """Whether a TorchRL environment provides an "action_mask"."""
    return ACTION_MASK in env.observation_spec.keys()  # noqa: SIM118 (its `in` wants .keys())


class Learner(Protocol):
    """A learning algorithm for one agent of a batch of games, or for all agents of a role.

    Attributes:
        frames: environment steps taken, summed over games.
    """

    frames: int

    def iterate(self, progress: float) -> dict[str, float]:
        """Collect and learn for one iteration; `progress` in [0, 1] of the budget.

        Returns:
            Values for the log, such as losses.
        """

    def policy(self, greedy: bool = True) -> Policy:
        """The current policy; it changes as the learner continues.

        Raises:
            ValueError: not greedy, and the algorithm learns no distribution.
        """

    def state_dict(self) -> dict[str, Any]:
        """Tensors and plain values from which a learner resumes exactly.

        All tensors must be finite; otherwise the run stops as diverged.
        The run saves the state of the games and torch's random state.
        """

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore a `state_dict`; raises one of `MISFITS` where it does not match."""

    def close(self) -> None:
        """Release resources."""


@dataclass(frozen=True)
class Build:
    """Options of building a learner on this machine.

    Attributes:
        device: of the network.
        bfloat16: matrix products in bfloat16.
        first_layer: "bag", "dense", or "auto" for the faster one.
        seed: of the learner's own random numbers (networks use torch's generator).
        fused: whether fused kernels are used where possible.
    """

    device: str = "cpu"
    bfloat16: bool = False
    first_layer: str = "auto"
    seed: int = 0
    fused: bool = True

    @property
    def precision(self) -> str:
        """Of the training: "bfloat16" or "float32"."""
        return "bfloat16" if self.bfloat16 else "float32"

    def hidden(self, settings: NetworkSettings) -> Hidden:
        """The configuration of the hidden layers."""
        form: Any = None if self.first_layer == "auto" else self.first_layer
        rest = (settings.activation, settings.first_std, form, self.bfloat16, settings.recurrent)
        return Hidden(settings.width, *rest)


def network_loader(
    network_of: Callable[[Any, Player, Build], Network],
) -> Callable[[Any, Player, dict[str, Any], bool], Policy]:
    """A function that makes a policy, on the CPU, from the state of a learner.

    It raises one of `MISFITS` for the state of other settings.
    """

    def load(settings: Any, player: Player, state: dict[str, Any], greedy: bool = True) -> Policy:
        network = network_of(settings, player, Build())
        network.load_state_dict(state["network"])
        return player.policy(network.eval(), greedy)

    return load


def backward(loss: torch.Tensor) -> None:
    """The gradients of a loss, in `grad`; ValueError if a network raises an exception."""
    try:
        torch.autograd.backward(loss)
    except Exception as error:  # of a user-defined network, such as changes in place
        raise ValueError(f"the gradients of the network raised {raised(error)}; mend it") from error


def clip_gradients(parameters: list[torch.nn.Parameter], most: float) -> None:
    """Clip gradients to the norm `most`: torch's `clip_grad_norm_`, in three operations.

    Args:
        parameters: with gradients.
        most: the largest norm.
    """
    gradients: Any = [weight.grad for weight in parameters if weight.grad is not None]
    norm = torch.linalg.vector_norm(torch.stack(torch._foreach_norm(gradients)))
    scale = (most / (norm + 1e-6)).clamp(max=1.0)
    if not scale.is_cpu or float(scale) != 1.0:  # no synchronisation with a GPU
        torch._foreach_mul_(gradients, scale)


def step_adam(optimizer: torch.optim.Adam) -> None:
    """`optimizer.step()` of a fused Adam on the CPU, without its repeated lookups.

    These take several times as long as the step itself for a network of 128 units.
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


def averaged_buffers(network: Network) -> list[torch.Tensor]:
    """The buffers of a network with real numbers, such as statistics of batches."""
    return [each for each in network.buffers() if each.is_floating_point()]


class NetworkLearner:
    """The base class of learners with a network and Adam.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: the trained network.
        device: of the network.

    Attributes:
        average: replaces tensors by their means over data parallel processes; None for one process.
    """

    average: Callable[[list[torch.Tensor]], None] | None = None

    def __init__(
        self, settings: NetworkSettings, env: VecEnv, network: Network, device: str
    ) -> None:
        self.env, self.network, self.device = env, network, device
        self._descent = settings
        self.frames = 0
        self.optimizer = torch.optim.Adam(
            network.parameters(),
            lr=settings.learning_rate,
            betas=(settings.adam_beta1, 0.999),
            eps=settings.adam_epsilon,
            fused=True,
        )

    @property
    def update_form(self) -> str:
        """The form of the gradient steps: "torch", or "fused" kernels."""
        return "torch"

    def annealed(self, value: float, progress: float, end: float = 0.0) -> float:
        """`value` annealed linearly to `end` if the settings say so."""
        return linear(value, end, progress) if self._descent.anneal else value

    def descend(self, loss: torch.Tensor) -> None:
        """One step of Adam, with the gradient clipped to the norm `max_grad_norm`."""
        # Listing a network's parameters takes longer than the norm of a gradient.
        weights = self.optimizer.param_groups[0]["params"]
        for weight in weights:
            weight.grad = None
        backward(loss)
        self.descend_by_gradients()

    def descend_by_gradients(self) -> None:
        """One step of Adam with the gradients in `grad`, clipped likewise."""
        weights = self.optimizer.param_groups[0]["params"]
        if self.average is not None:
            gradients = [weight.grad for weight in weights if weight.grad is not None]
            self.average(gradients + averaged_buffers(self.network))
        clip_gradients(weights, self._descent.max_grad_norm)
        step_adam(self.optimizer)
        # Cached tables of a policy compare the versions of the weights, which a fused step does not
        # increment.
        torch.autograd.graph.increment_version(weights)

    def set_schedules(self, progress: float) -> None:
        """Set learning rates and, for rollout learners, the discount; `progress` in [0, 1] of the
        budget."""
        self.optimizer.param_groups[0]["lr"] = self.annealed(self._descent.learning_rate, progress)

    def policy(self, greedy: bool = True) -> Policy:
        """The policy of the player with this network."""
        return self.env.player.policy(self.network, greedy)

    def state_dict(self) -> dict[str, Any]:
        """Weights, Adam's moments and the frames."""
        return {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "frames": self.frames,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.frames = state["frames"]

    def close(self) -> None:
        """Nothing to release."""


def means(logged: list[dict[str, torch.Tensor]]) -> dict[str, float]:
    """The mean of every logged value over the gradient steps."""
    return {
        name: float(torch.stack([figures[name] for figures in logged]).mean())
        for name in (logged[0] if logged else ())
    }
