"""Whoever else plays in games on a GPU: by kernels, or as a network that is asked there."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from copy import deepcopy
from typing import Any, Protocol

import numpy as np
import torch

from pursuit.device.calls import Call, call_of
from pursuit.maze_arrays import lay_out
from pursuit.observations import Encoder
from pursuit.own_observations import is_ours
from pursuit.rules import layout
from pursuit.rules.randomness import draw_uniform
from pursuit.task import Task
from train.networks.policy import NetworkPolicy
from train.networks.remembering import numbers_fit


def tensors_at(simulator: Any) -> str:
    """The device of tensors over the arrays of a `DeviceSimulator`.

    Numba's simulator of a GPU has its arrays on the CPU.
    """
    return "cpu" if simulator.simulated else str(simulator.device)


def shared(simulator: Any, array: Any) -> torch.Tensor:
    """A tensor over the same memory as an array of a `DeviceSimulator`."""
    if simulator.simulated:
        return torch.from_numpy(array._ary)
    return torch.as_tensor(array, device=tensors_at(simulator))


class DevicePolicy(Protocol):
    """Whoever fills a seat of games on a GPU otherwise than by one kernel."""

    def begin_rollout(self) -> None:
        """Called before a rollout: here it may wait, and take in what has changed."""

    def play(self) -> None:
        """Write its actions into its column of `DeviceSimulator.actions`; wait for nothing."""

    def depends(self) -> Hashable:
        """What its launches depend on, beside what lies in memory that stays where it is."""


def check_network(policy: Any, task: Task, seat: int) -> None:
    """ValueError for a network that cannot be asked on a GPU, in a seat of a task."""
    name = f"the policy in the seat of {task.agent_names[seat]}"
    if not isinstance(policy, NetworkPolicy):
        raise ValueError(f"{name} does not play on a GPU; take device='cpu'")
    if policy.seat.mask_bumps:
        raise ValueError(f"{name} keeps to masks of moves, which are made on the CPU")
    if not is_ours(policy.encoding):
        raise ValueError(f"{name} observes {policy.encoding!r}, which is made on the CPU")
    encoder, own = Encoder(task, policy.encoding), policy.seat
    if (
        tuple(encoder.shape) != tuple(own.features.shape)
        or own.num_actions != task.num_actions
        or not numbers_fit(policy.encoding, own.task, task)
    ):
        raise ValueError(
            f"{name} is for observations of shape {own.features.shape} in mazes of "
            f"{own.task.max_cells} cells; these games give {encoder.shape} in {task.max_cells}"
        )


class DeviceNetwork:
    """A `NetworkPolicy` in a seat of games on a GPU; a `DevicePolicy`.

    It does what that does on the CPU, with the same draws; of one network the last bits of its
    probabilities are those of the GPU's matrix products.

    Args:
        policy: how it plays. Its network is used where it is if it lies on the GPU, as one that
            learns does; of any other a copy.
        simulator: the games.
        seat: its number.

    Raises:
        ValueError: a network that cannot be asked there.
    """

    def __init__(self, policy: Any, simulator: Any, seat: int) -> None:
        check_network(policy, simulator.task, seat)
        self.greedy, self._encoding, self._seat = policy.greedy, policy.encoding, seat
        self._simulator = simulator
        self._network = network_at(policy.network, tensors_at(simulator))
        self._column = shared(simulator, simulator.actions)[:, seat]
        stream = layout.named(layout.stream_of, seat)
        self._draw = simulator.launch(Call(draw_uniform, {"stream": stream}, "numbers"))
        self._numbers = simulator.array(np.zeros(simulator.num_games))
        self._draws = shared(simulator, self._numbers)
        self._shown: torch.Tensor | None = None

    def begin_rollout(self) -> None:
        """Nothing: its weights are always those that it has now."""

    @torch.no_grad()
    def actions(self, draws: torch.Tensor) -> torch.Tensor:
        """[games] int64, by draws [games] in [0, 1), which a greedy one ignores."""
        seen = self._simulator.observe(self._encoding, self._seat)  # always the same array
        if self._shown is None:
            self._shown = shared(self._simulator, seen)
        logits: torch.Tensor = self._network.logits(self._shown)
        if self.greedy:
            return logits.argmax(dim=-1)
        cumulative = logits.double().softmax(dim=-1).cumsum(dim=-1)
        scaled = draws[:, None] * cumulative[:, -1:]
        return (scaled >= cumulative).sum(dim=-1).clamp(max=logits.shape[-1] - 1)

    def play(self) -> None:
        """As `DevicePolicy`."""
        if not self.greedy:
            self._draw(numbers=self._numbers)
        self._column.copy_(self.actions(self._draws))

    def depends(self) -> Hashable:
        """As `DevicePolicy`: where its weights lie."""
        return tuple(weight.data_ptr() for weight in self._network.parameters())


def network_at(network: Any, device: str) -> Any:
    """A network on a device: itself, or a copy."""
    # "cuda" is "cuda:0", or whichever is the current one.
    if next(network.parameters()).device == torch.empty(0, device=device).device:
        return network
    return deepcopy(network).to(device)


def check_plays(policies: Sequence[Any], task: Task) -> None:
    """ValueError unless whoever fills the seats (None: nobody) can do so on a GPU."""
    for seat, policy in enumerate(policies):
        if isinstance(policy, NetworkPolicy):
            check_network(policy, task, seat)
        elif policy is not None:
            call_of(policy, task, seat, lay_out(task.mazes))


def seated(policies: Sequence[Any], simulator: Any) -> list[Any]:
    """The same policies for a `DeviceEnv`: networks as `DeviceNetwork`, the others as they are."""
    return [
        DeviceNetwork(policy, simulator, seat) if isinstance(policy, NetworkPolicy) else policy
        for seat, policy in enumerate(policies)
    ]
