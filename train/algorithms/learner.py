"""The interface between learners, runs and environments."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import torch
from torch import nn

from curricula import linear
from pursuit.simulator.policy import Policy
from pursuit.validation import raised
from train.algorithms.adam import Adam
from train.environments.hooks import EpisodeHook
from train.networks.layers import Hidden
from train.networks.seat import Seat
from train.settings.algorithms import NetworkSettings
from train.tensors import StateDict


class VecEnv(Protocol):
    """A batch of games as learners step it: a `BatchEnv`, or any environment of TorchRL (an
    `EnvBase`) with these attributes.

    Attributes:
        hook: configures the next episodes.
        num_games: number of parallel games.
        rows: of its tensors: games, times the members of a team.
        resume: if set, the next full reset continues the current episodes.
    """

    hook: EpisodeHook
    num_games: int
    rows: int
    resume: bool

    @property
    def player(self) -> Seat:
        """The learning agent."""

    def reset(self) -> Any:
        """Reset all games; returns the observations by name."""

    def step_episodes(
        self, actions: torch.Tensor, running: torch.Tensor
    ) -> dict[str, torch.Tensor]:
        """A step without restarts, for learning from whole episodes."""


class HasState(Protocol):
    """A part of a learner with a state of its own: a network, an optimiser, noise."""

    def state_dict(self) -> StateDict:
        """Tensors and plain values."""

    def load_state_dict(self, state_dict: StateDict) -> object:
        """Restore the state."""


def steps_tensors(env: VecEnv) -> bool:
    """Whether an environment is a `BatchEnv`, which steps without TensorDicts."""
    return hasattr(env, "step_tensors")


def has_masks(env: VecEnv) -> bool:
    """Whether an environment provides an "action_mask"."""
    return bool(env.player.has_masks)


def expert_in(env: Any) -> Any:
    """The `Expert` that the learner in a `BatchEnv` imitates; None for none, and elsewhere."""
    return getattr(env, "expert", None)


def no_actions(env: VecEnv) -> torch.Tensor:
    """[rows, ...]: actions of 0, of the type of the environment's."""
    if env.player.continuous:
        return torch.zeros(env.rows, env.player.num_actions)
    return torch.zeros(env.rows, dtype=torch.int64)


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

    def state_dict(self) -> StateDict:
        """Tensors and plain values from which a learner resumes exactly.

        All tensors must be finite; otherwise the run stops as diverged.
        The run saves the state of the games and torch's random state.
        """

    def load_state_dict(self, state: StateDict) -> None:
        """Restore a `state_dict`; raises one of `MISFITS` where it does not match."""

    def start_from(self, state: StateDict) -> None:
        """Start from the weights in the state of another learner, which may be of other games and
        hyperparameters; raises one of `MISFITS` where they do not fit."""

    def close(self) -> None:
        """Release resources."""


@dataclass(frozen=True)
class Build:
    """Options of building a learner on this machine.

    Attributes:
        device: of the network.
        bfloat16: matrix products in bfloat16.
        seed: of the learner's own random numbers (networks use torch's generator).
        fused: whether fused kernels are used where possible.
    """

    device: str = "cpu"
    bfloat16: bool = False
    seed: int = 0
    fused: bool = True

    @property
    def precision(self) -> str:
        """Of the training: "bfloat16" or "float32"."""
        return "bfloat16" if self.bfloat16 else "float32"

    def hidden(self, settings: NetworkSettings) -> Hidden:
        """The configuration of the hidden layers."""
        return Hidden(
            settings.width,
            settings.activation,
            settings.first_std,
            bfloat16=self.bfloat16,
            recurrent=settings.recurrent,
        )


def network_loader(
    network_of: Callable[[Any, Seat, Build], nn.Module],
) -> Callable[[Any, Seat, StateDict, bool], Policy]:
    """A function that makes a policy, on the CPU, from the state of a learner.

    It raises one of `MISFITS` for the state of other settings.
    """

    def load(settings: Any, seat: Seat, state: StateDict, greedy: bool = True) -> Policy:
        network = network_of(settings, seat, Build())
        network.load_state_dict(state["network"])
        return seat.policy(network.eval(), greedy)

    return load


def backward(loss: torch.Tensor) -> None:
    """The gradients of a loss, in `grad`; ValueError if a network raises an exception."""
    try:
        torch.autograd.backward(loss)
    except Exception as error:  # of a user-defined network, such as changes in place
        raise ValueError(f"the gradients of the network raised {raised(error)}; mend it") from error


def clip_gradients(parameters: list[torch.Tensor], most: float) -> None:
    """Clip gradients to the norm `most`: torch's `clip_grad_norm_`, in three operations.

    Args:
        parameters: with gradients.
        most: the largest norm.
    """
    gradients = [weight.grad for weight in parameters if weight.grad is not None]
    norm = torch.linalg.vector_norm(torch.stack(list(torch._foreach_norm(gradients))))
    scale = (most / (norm + 1e-6)).clamp(max=1.0)
    if not scale.is_cpu or float(scale) != 1.0:  # no synchronisation with a GPU
        torch._foreach_mul_(gradients, scale)


def averaged_buffers(network: nn.Module) -> list[torch.Tensor]:
    """The buffers of a network with real numbers, such as statistics of batches."""
    return [each for each in network.buffers() if each.is_floating_point()]


class LearnedNetwork:
    """The base class of learners with one network: its policy, and what is saved of it.

    Args:
        env: the training environment, a `VecEnv` or a `LearnerVectorEnv`.
        network: the trained network.

    Attributes:
        env, network: the arguments.
        optimizer: of the network.
        COUNTERS: the numbers in checkpoints, by the names of attributes.
        COPIES: the parts that begin as copies of the network.
        NO_DISTRIBUTION: why `policy` must be greedy; "" if it need not be.
    """

    COUNTERS: ClassVar[tuple[str, ...]] = ("frames",)
    COPIES: ClassVar[tuple[str, ...]] = ()
    NO_DISTRIBUTION: ClassVar[str] = ""
    optimizer: Any

    def __init__(self, env: Any, network: nn.Module) -> None:
        self.env, self.network, self.frames = env, network, 0

    def policy(self, greedy: bool = True) -> Policy:
        """The policy of the seat with this network."""
        if not greedy and self.NO_DISTRIBUTION:
            raise ValueError(f"{self.NO_DISTRIBUTION}; use the greedy policy")
        return self.env.player.policy(self.network, greedy)

    def parts(self) -> dict[str, HasState]:
        """What has a state of its own, by the names in checkpoints."""
        return {"network": self.network, "optimizer": self.optimizer}

    def state_dict(self) -> StateDict:
        """The states of the parts, such as weights and Adam's moments, and the counters."""
        counters = {name: getattr(self, name) for name in self.COUNTERS}
        return {name: part.state_dict() for name, part in self.parts().items()} | counters

    def load_state_dict(self, state: StateDict) -> None:
        """Restore the state."""
        for name, part in self.parts().items():
            part.load_state_dict(state[name])
        for name in self.COUNTERS:
            setattr(self, name, state[name])

    def start_from(self, state: StateDict) -> None:
        """As `Learner`."""
        own = self.parts()
        for name in ("network", *self.COPIES):
            own[name].load_state_dict(state["network"])

    def close(self) -> None:
        """Nothing to release."""


class NetworkLearner(LearnedNetwork):
    """The base class of learners with networks and Adam, which step games themselves.

    Args:
        settings: the hyperparameters.
        env: the training environment.
        network: the trained network.
        device: of the network.

    Attributes:
        settings, env, network, device: the arguments.
        optimizer: of the network.
        rates: every optimiser, with its initial learning rate.
        average: replaces tensors by their means over data parallel processes; None for one process.
    """

    average: Callable[[list[torch.Tensor]], None] | None = None
    env: VecEnv
    optimizer: Adam

    def __init__(
        self, settings: NetworkSettings, env: VecEnv, network: nn.Module, device: str
    ) -> None:
        super().__init__(env, network)
        self.settings, self.device = settings, device
        self.rates: list[tuple[Adam, float]] = []
        self.optimizer = self.new_optimizer(network.parameters(), settings.learning_rate)

    def new_optimizer(self, weights: Iterable[torch.Tensor], learning_rate: float) -> Adam:
        """Adam for these weights; `set_schedules` anneals its learning rate."""
        betas, epsilon = (self.settings.adam_beta1, 0.999), self.settings.adam_epsilon
        optimizer = Adam(weights, learning_rate, betas, epsilon)
        self.rates.append((optimizer, learning_rate))
        return optimizer

    @property
    def update_form(self) -> str:
        """The form of the gradient steps: "torch", or "fused" kernels."""
        return "torch"

    def annealed(self, value: float, progress: float, end: float = 0.0) -> float:
        """`value` annealed linearly to `end` if the settings say so."""
        return linear(value, end, progress) if self.settings.anneal else value

    def set_schedules(self, progress: float) -> None:
        """Set learning rates and, for PPO, the discount; `progress` in [0, 1] of the budget."""
        for optimizer, learning_rate in self.rates:
            for group in optimizer.param_groups:
                group["lr"] = self.annealed(learning_rate, progress)

    def descend(self, loss: torch.Tensor, optimizer: Adam | None = None) -> None:
        """One step of Adam (None: of `optimizer`), with the gradient clipped to the norm
        `max_grad_norm`."""
        optimizer = optimizer or self.optimizer
        optimizer.zero_grad()
        backward(loss)
        self.descend_by_gradients(optimizer)

    def descend_by_gradients(self, optimizer: Adam | None = None) -> None:
        """One step of Adam with the gradients in `grad`, clipped likewise."""
        optimizer = optimizer or self.optimizer
        # Listing the weights of a network takes longer than their norm.
        weights = [weight for group in optimizer.param_groups for weight in group["params"]]
        if self.average is not None:
            gradients = [weight.grad for weight in weights if weight.grad is not None]
            self.average(gradients + averaged_buffers(self.network))
        clip_gradients(weights, self.settings.max_grad_norm)
        optimizer.step()
        # Cached tables of a policy compare the versions of the weights, which a fused step does not
        # increment.
        torch.autograd.graph.increment_version(weights)


def means(logged: list[dict[str, torch.Tensor]]) -> dict[str, float]:
    """The mean of every logged value over the gradient steps."""
    return {
        name: float(torch.stack([figures[name] for figures in logged]).mean())
        for name in (logged[0] if logged else ())
    }
