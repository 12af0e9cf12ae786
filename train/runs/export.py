"""Trained networks for other programs: ONNX, and PyTorch's exported programs."""

from __future__ import annotations

import io
import json
import logging
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pursuit.validation import as_path, check
from pursuit.version import __version__
from train.files import write_bytes
from train.networks.joint_policy import JointPolicy
from train.networks.layers import float32_inference
from train.networks.policy import NetworkPolicy
from train.networks.recurrent_policy import RecurrentPolicy
from train.networks.separate import SeparateNetworks
from train.tensors import own_defaults

SUFFIXES = (".onnx", ".pt2")


class ActionProbabilities(nn.Module):
    """The network of a policy as one function: observations to action probabilities."""

    def __init__(self, policy: NetworkPolicy) -> None:
        super().__init__()
        self.network: Any = policy.network

    def forward(self, observation: Tensor) -> Tensor:
        """[batch, actions] float32; the greedy action is the most probable one."""
        return torch.softmax(self.network.logits(observation).float(), dim=-1)


@own_defaults()
def export_policy(policy: Any, path: Path | str) -> Path:
    """Write the network of a policy as `.onnx` (ONNX) or `.pt2` (`torch.export`).

    Its input `observation` is [batch, *shape] in the dtype of the observation space, its output
    `probabilities` [batch, actions] float32, a softmax of logits or action values. Action masks,
    `min_probability` and draws are not part of it. The file holds the texts of `metadata_of`: ONNX
    as metadata "pursuit.task" and so on, `.pt2` as JSON in the extra file "pursuit.json".

    Args:
        policy: from `train.load_policy`, of a network without memory in a maze or a small game.
        path: of the new file; the suffix decides.

    Raises:
        ValueError: another suffix or policy; a network that cannot be exported.
        ImportError: `.onnx` without the packages of `pip install '.[export]'`.
    """
    check(
        not isinstance(policy, (str, Path)),
        f"policy={str(policy)!r}; give a policy, such as train.load_policy({str(policy)!r})",
    )
    path = as_path("path", path)
    check(path.suffix in SUFFIXES, f"{path}: give a file that ends in .onnx or .pt2")
    if isinstance(policy, RecurrentPolicy):
        stacked = policy.seat.frame_stack
        what = f"frame_stack={stacked}" if stacked > 1 else "a recurrent network"
        raise ValueError(
            f"a policy with {what} remembers earlier observations, which an exported network does "
            f"not; export a run without {'--frame-stack' if stacked > 1 else '--recurrent'}"
        )
    network = getattr(policy, "network", None)
    team = "joint" if isinstance(policy, JointPolicy) else "separate"
    check(
        team != "joint" and not isinstance(network, SeparateNetworks),
        f"the networks of a team with sharing={team!r} are not exported; export a run with "
        "sharing=shared",
    )
    check(
        isinstance(policy, NetworkPolicy),
        f"a {type(policy).__name__} has no network without memory in a maze or small game; export "
        "a run of PPO, A2C, DQN, REINFORCE or the cross-entropy method",
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
        metadata = metadata_of(policy)
        if path.suffix == ".pt2":
            # In memory: where the disk is full, torch's own writer aborts the process.
            content = io.BytesIO()
            extra = {"pursuit.json": json.dumps(metadata, indent=2)}
            torch.export.save(program, content, extra_files=extra)
            write_bytes(path, content.getvalue())
            return path
        names: Any = {"input_names": ["observation"], "output_names": ["probabilities"]}
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # packages that are not needed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of torch's own calls
            onnx: Any = torch.onnx.export(program, dynamo=True, verbose=False, **names)
        for name, text in metadata.items():
            onnx.model.metadata_props[f"pursuit.{name}"] = text
        write_bytes(path, onnx.model_proto.SerializeToString())
    return path


def metadata_of(policy: NetworkPolicy) -> dict[str, str]:
    """What another program needs to use an exported network.

    Returns:
        "version" of Pursuit; "task", the settings as JSON, as in replays, or of a small game its
        name, max_steps, players and number of states; "agent", its name or role; "observation", the
        encoding; "actions", a JSON list of their names in the order of the output; "normalisation"
        and "output", sentences.
    """
    return {
        "version": __version__,
        "task": json.dumps(policy.seat.described),
        "agent": policy.seat.agent,
        "observation": policy.encoding,
        "actions": json.dumps(policy.seat.action_names),
        "normalisation": "none is needed: the network scales the values of the encoding itself",
        "output": "probabilities, a softmax of logits or of action values",
    }
