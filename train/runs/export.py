"""Trained networks for other programs: ONNX, and PyTorch's exported programs."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from train.files import write_atomically
from train.networks.layers import float32_inference
from train.networks.policy import NetworkPolicy
from train.settings.checks import check

SUFFIXES = (".onnx", ".pt2")


class ActionProbabilities(nn.Module):
    """The network of a policy as one function: observations to action probabilities."""

    def __init__(self, policy: NetworkPolicy) -> None:
        super().__init__()
        self.network: Any = policy.network

    def forward(self, observation: Tensor) -> Tensor:
        """[batch, actions] float32; the greedy action is the most probable one."""
        return torch.softmax(self.network.logits(observation).float(), dim=-1)


def export_policy(policy: Any, path: Path | str) -> Path:
    """Write the network of a policy as `.onnx` (ONNX) or `.pt2` (`torch.export`).

    Its input `observation` is [batch, *shape] in the dtype of the observation space, its output
    `probabilities` [batch, actions] float32, a softmax of logits or action values. Action masks,
    `min_probability` and draws are not part of it.

    Args:
        policy: from `train.load_policy`, of a network without memory in a maze.
        path: of the new file; the suffix decides.

    Raises:
        ValueError: another suffix or policy; a network that cannot be exported.
        ImportError: `.onnx` without the packages of `pip install '.[export]'`.
    """
    path = Path(path)
    check(path.suffix in SUFFIXES, f"{path}: give a file that ends in .onnx or .pt2")
    check(
        isinstance(policy, NetworkPolicy),
        f"a {type(policy).__name__} has no network without memory in a maze; export a run of PPO, "
        "A2C, DQN, REINFORCE or the cross-entropy method without --recurrent",
    )
    features = policy.seat.features
    form = torch.from_numpy(features.high[None]).dtype
    example = torch.zeros(2, *features.shape, dtype=form)
    batch = ({0: torch.export.Dim("batch")},)
    whole = ActionProbabilities(policy)
    with float32_inference(whole):
        try:
            program = torch.export.export(whole, (example,), dynamic_shapes=batch)
        except Exception as error:  # torch.export raises many kinds
            raise ValueError(
                f"the network {type(policy.network).__name__} cannot be exported: {error}"
            ) from None
        if path.suffix == ".pt2":
            write_atomically(path, lambda beside: _save(program, beside))
            return path
        names: Any = {"input_names": ["observation"], "output_names": ["probabilities"]}
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # packages that are not needed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of torch's own calls
            onnx: Any = torch.onnx.export(program, dynamo=True, verbose=False, **names)
        write_atomically(path, lambda beside: onnx.save(str(beside)))
    return path


def _save(program: Any, path: Path) -> None:
    with open(path, "wb") as file:
        torch.export.save(program, file)
