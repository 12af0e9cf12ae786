"""Adam on torch's fused kernel."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch

from pursuit.validation import check
from train.tensors import StateDict

MOMENTS = ("step", "exp_avg", "exp_avg_sq")
"""The state of a weight: the number of steps, and the means of gradients and their squares."""
OPTIONS = ("lr", "betas", "eps")
CONSTANT = {
    "weight_decay": 0,
    "amsgrad": False,
    "maximize": False,
    "foreach": None,
    "capturable": False,
    "differentiable": False,
    "fused": True,
    "decoupled_weight_decay": False,
}
"""Options of torch's class in checkpoints, which do not change."""


class Adam:
    """`torch.optim.Adam(..., fused=True)`: equal steps bit for bit, and equal checkpoints.

    The first object of that class imports torch's compiler, which takes a second, and each of its
    steps spends several times as long on lookups as on a network of 128 units.

    Args:
        weights: to learn.
        lr: the learning rate.
        betas: the decay of the means of gradients and of their squares.
        eps: is added to the root of the latter.

    Attributes:
        param_groups: as of torch's optimisers, one group with the arguments; "lr", "betas" and
            "eps" may be changed.
        state: the `MOMENTS` by the index of each weight that has had a gradient.
    """

    def __init__(
        self,
        weights: Iterable[torch.Tensor],
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
    ) -> None:
        group = {"params": list(weights), "lr": lr, "betas": betas, "eps": eps}
        self.param_groups: list[dict[str, Any]] = [group]
        self.state: dict[int, dict[str, torch.Tensor]] = {}

    @property
    def weights(self) -> list[torch.Tensor]:
        """The weights that it learns."""
        weights: list[torch.Tensor] = self.param_groups[0]["params"]
        return weights

    def zero_grad(self) -> None:
        """Remove all gradients."""
        for weight in self.weights:
            weight.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """One step of the weights that have a gradient."""
        groups: dict[Any, list[tuple[torch.Tensor, ...]]] = {}
        options = self.param_groups[0]
        for index, weight in enumerate(self.weights):
            if weight.grad is None:
                continue
            if index not in self.state:
                zeros = (torch.zeros_like(weight) for _ in range(2))
                none = torch.zeros((), dtype=torch.float32, device=weight.device)
                self.state[index] = dict(zip(MOMENTS, (none, *zeros), strict=True))
            row = (weight, weight.grad, *self.state[index].values())
            groups.setdefault((weight.device, weight.dtype), []).append(row)
        for group in groups.values():
            weights, gradients, steps, first, second = zip(*group, strict=True)
            torch._foreach_add_(steps, 1)
            torch._fused_adam_(
                weights, gradients, first, second, [], steps,
                lr=options["lr"], beta1=options["betas"][0], beta2=options["betas"][1],
                weight_decay=0.0, eps=options["eps"], amsgrad=False, maximize=False,
                grad_scale=None, found_inf=None,
            )  # fmt: skip

    def state_dict(self) -> StateDict:
        """As of torch's class."""
        options = {name: self.param_groups[0][name] for name in OPTIONS}
        group = {**options, **CONSTANT, "params": [*range(len(self.weights))]}
        return {"state": {index: {**own} for index, own in self.state.items()},
                "param_groups": [group]}  # fmt: skip

    def load_state_dict(self, state_dict: StateDict) -> None:
        """Restore a state; ValueError or KeyError if it is not of such weights."""
        (group,) = state_dict["param_groups"]
        check(
            len(group["params"]) == len(self.weights),
            f"a state of {len(group['params'])} weights for {len(self.weights)}",
        )
        for name in OPTIONS:
            self.param_groups[0][name] = group[name]
        numbers = {saved: index for index, saved in enumerate(group["params"])}
        self.state = {}
        for saved, moments in state_dict["state"].items():
            weight = self.weights[numbers[saved]]
            own = {name: moments[name].to(weight.device, copy=True) for name in MOMENTS}
            shapes = {own[name].shape for name in MOMENTS[1:]}
            check(shapes == {weight.shape}, f"moments of {shapes} for a weight of {weight.shape}")
            self.state[numbers[saved]] = own
