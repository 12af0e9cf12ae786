"""Trained policies for other programs: ONNX, and PyTorch's exported programs."""

from __future__ import annotations

import io
import json
import logging
import math
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from pursuit.validation import as_path, check, need
from pursuit.version import __version__
from train.algorithms.tracked import TrackedNetwork
from train.files import write_bytes
from train.networks.frames import FrameStack
from train.networks.joint_policy import JointPolicy
from train.networks.layers import float32_inference
from train.networks.numbering import QTablePolicy
from train.networks.policy import NetworkPolicy
from train.networks.recurrent_policy import RecurrentPolicy
from train.networks.separate import SeparateNetworks
from train.networks.small_game_policy import SmallGameTable
from train.tensors import own_defaults

SUFFIXES = (".onnx", ".pt2")
RESET = "before the first step of every episode"


class NetworkFunction(nn.Module):
    """The network of a policy as one function: observations to action probabilities."""

    def __init__(self, policy: NetworkPolicy) -> None:
        super().__init__()
        self.network: Any = policy.network

    def forward(self, observation: Tensor) -> Tensor:
        """[batch, actions] float32; the greedy action is the most probable one."""
        return torch.softmax(self.network.logits(observation).float(), dim=-1)


class MemoryFunction(nn.Module):
    """A policy with memory as one function: observations and memory to action probabilities and
    the next memory.

    The memory of a game is one row of numbers: the recurrent state, and the earlier observations of
    a stack, as differences from empty ones. So it is 0 before the first step of an episode.

    Attributes:
        size: numbers of the memory.
    """

    def __init__(self, policy: RecurrentPolicy) -> None:
        super().__init__()
        seat, self.network = policy.seat, policy.network
        self.stack = FrameStack(seat.seen, seat.frame_stack)
        self.recurrent = getattr(self.network, "policy_memory", None) is not None
        self.state = self.network.sizes[0] if self.recurrent else 0
        self.size = self.state + math.prod(seat.seen.shape) * (seat.frame_stack - 1)

    def forward(self, observation: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """[batch, actions] and [batch, size] float32."""
        stack, state = self.stack, memory[:, : self.state]
        newest = (observation.float() - stack.empty).flatten(1)
        frames = torch.cat([newest, memory[:, self.state :]], 1)
        numbers = torch.from_numpy(stack.empty + stack.offsets)[:, None]
        stacked = frames.reshape(frames.shape[0], stack.count, -1) + numbers
        seen = stacked.to(observation.dtype).reshape(-1, *stack.shape)
        if self.recurrent:
            logits, state = self.network.remember(seen, state)
        else:
            logits = self.network.logits(seen)
        following = torch.cat([state, frames[:, : self.size - self.state]], 1)
        return torch.softmax(logits.float(), dim=-1), following


class TableFunction(nn.Module):
    """The best actions of a table of action values as one function of "index" observations."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.numbers: Any = need(policy.seat.numbering)
        self.values = torch.from_numpy(policy.q_values)
        self.allowed = torch.from_numpy(self.numbers.allowed)

    def forward(self, observation: Tensor) -> Tensor:
        """[batch, actions] float32: 1 for the best action."""
        own = observation[:, 0].long().clamp(max=len(self.allowed) - 1)  # cell, or state
        values = self.values[self.numbers.of_index(observation)]
        best = values.masked_fill(~self.allowed[own], -torch.inf).argmax(dim=1)
        return nn.functional.one_hot(best, values.shape[1]).float()


def function_of(policy: Any) -> nn.Module:
    """A policy as one function of tensors; ValueError for one that cannot be exported."""
    network = getattr(policy, "network", None)
    team = "joint" if isinstance(policy, JointPolicy) else "separate"
    check(
        team != "joint" and not isinstance(network, SeparateNetworks),
        f"the networks of a team with sharing={team!r} are not exported; export a run with "
        "sharing=shared",
    )
    forms: dict[type[Any], Any] = {NetworkPolicy: NetworkFunction, RecurrentPolicy: MemoryFunction}
    forms |= {QTablePolicy: TableFunction, SmallGameTable: TableFunction}
    found = next((forms[form] for form in forms if isinstance(policy, form)), None)
    if found is None:
        raise ValueError(
            f"a {type(policy).__name__} has no network or table of a maze or small game; export a "
            "run of PPO, A2C, DQN, REINFORCE, the cross-entropy method or Q-learning in one"
        )
    return found(policy)


@own_defaults()
def export_policy(policy: Any, path: Path | str) -> Path:
    """Write a policy as `.onnx` (ONNX) or `.pt2` (`torch.export`).

    Its input `observation` is [batch, *shape] in the dtype of the observation space, its output
    `probabilities` [batch, actions] float32, a softmax of logits or action values, or of a table 1
    for the best action. A policy with memory (recurrent, stacked observations) also has the input
    `memory` [batch, numbers] float32, 0 before the first step of an episode, and the output
    `next_memory`. Action masks, `min_probability` and draws are not part of it. The file holds the
    texts of `metadata_of`: ONNX as metadata "pursuit.task" and so on, `.pt2` as JSON in the extra
    file "pursuit.json".

    Args:
        policy: from `train.load_policy`, in a maze or a small game.
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
    check(
        not isinstance(getattr(policy, "network", None), TrackedNetwork),
        "a tracked policy is a function of another program; export it there",
    )
    whole = function_of(policy)
    seen = getattr(policy.seat, "seen", policy.seat.features)  # one observation of a stack
    form, size = torch.from_numpy(seen.high[:0]).dtype, getattr(whole, "size", 0)
    inputs = {"observation": torch.zeros(2, *seen.shape, dtype=form)}
    inputs |= {"memory": torch.zeros(2, size)} if size else {}
    batch = ({0: torch.export.Dim("batch")},) * len(inputs)
    with float32_inference(whole):
        try:
            program = torch.export.export(whole, tuple(inputs.values()), dynamic_shapes=batch)
        except Exception as error:  # torch.export raises many kinds
            raise ValueError(
                f"a network of {type(policy).__name__} cannot be exported: {error}"
            ) from None
        metadata = metadata_of(policy, size)
        if path.suffix == ".pt2":
            # In memory: where the disk is full, torch's own writer aborts the process.
            content = io.BytesIO()
            extra = {"pursuit.json": json.dumps(metadata, indent=2)}
            torch.export.save(program, content, extra_files=extra)
            write_bytes(path, content.getvalue())
            return path
        outputs = ["probabilities", "next_memory"][: len(inputs)]
        names: Any = {"input_names": [*inputs], "output_names": outputs}
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # packages that are not needed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # of torch's own calls
            onnx: Any = torch.onnx.export(program, dynamo=True, verbose=False, **names)
        for name, text in metadata.items():
            onnx.model.metadata_props[f"pursuit.{name}"] = text
        write_bytes(path, onnx.model_proto.SerializeToString())
    return path


def metadata_of(policy: Any, memory: int = 0) -> dict[str, str]:
    """What another program needs to use an exported policy, with so many numbers of memory.

    Returns:
        "format" of this metadata; "version" of Pursuit; "task", the settings as JSON, as in
        replays, or of a small game its name, max_steps, players and number of states; "agent", its
        name or role; "observation", the encoding; "actions", a JSON list of their names in the
        order of the output; "memory", as JSON its shape, dtype, initial value and when it has that,
        or null; "play", as JSON whether the probabilities are a learned distribution, whether the
        policy plays a whole team, and its settings outside the network; "normalisation" and
        "output", sentences.
    """
    seat, form = policy.seat, {"shape": [memory], "dtype": "float32", "initial": 0.0}
    draws, team = getattr(policy, "learned", (True, seat.team))
    play = {name: getattr(seat, name, False) for name in ("mask_bumps", "min_probability")}
    return {
        "format": "1",
        "version": __version__,
        "task": json.dumps(seat.described),
        "agent": seat.agent,
        "observation": seat.encoding,
        "actions": json.dumps(seat.action_names),
        "memory": json.dumps({**form, "reset": RESET} if memory else None),
        "play": json.dumps({"distribution": draws, "team": team, **play}),
        "normalisation": "none is needed: the network scales the values of the encoding itself",
        "output": "probabilities, a softmax of logits or action values; of a table 1 or 0",
    }
