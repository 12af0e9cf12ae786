"""The hidden layers of all networks, for every kind of features.

For "index" the first layer has two equivalent forms: an embedding bag that sums the rows selected
by the observation, and a matrix product with the one-hot vector of these rows. `first_layer_form`
selects the faster one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import nn

from pursuit.validation import check, raised
from train.networks.features import Features
from train.networks.planning import Planning
from train.settings.common import NETWORKS
from train.tensors import own_defaults


def first_layer_form(num_rows: int) -> str:
    """The faster form of the first layer, as measured by `tools/benchmarks/bench_learning.py`.

    The cost of the matrix product grows with the rows of the weight matrix. On two cores without
    hardware bfloat16 both forms are equally fast at about 300 rows, at widths of 128 and 256.
    """
    return "bag" if num_rows > 300 else "dense"


@dataclass(frozen=True)
class Hidden:
    """The configuration of two hidden layers.

    Attributes:
        width: units of each.
        activation: "relu" or "tanh".
        std: initial standard deviation of the first layer's weights for "index".
        form: of the first layer for "index": "bag", "dense", or "auto" for the faster one.
        bfloat16: matrix products run under autocast; parameters and outputs stay float32.
        recurrent: the recurrent cell after them, "gru"; None for none.
    """

    width: int = 128
    activation: str = "relu"
    std: float = 0.06
    form: str = "auto"
    bfloat16: bool = False
    recurrent: str | None = None


def one_hot_sum(rows: torch.Tensor, num_rows: int) -> torch.Tensor:
    """[..., num_rows]: the sum of one-hot vectors of rows [..., numbers]; `num_rows` is no row."""
    one_hot = torch.zeros(*rows.shape[:-1], num_rows + 1, device=rows.device)
    one_hot.scatter_add_(-1, rows, torch.ones((), device=rows.device).expand(rows.shape))
    return one_hot[..., :num_rows]


class IndexLayer(nn.Module):
    """A linear layer for "index": the sum of the rows that an observation selects, and a bias.

    Args:
        features: of kind "index".
        width: outputs.
        form: "bag" or "dense"; the same function of the same parameters.
        std: initial standard deviation of the weights.
    """

    rows: torch.Tensor

    def __init__(self, features: Features, width: int, form: str, std: float = 0.06) -> None:
        super().__init__()
        self.num_rows, self.form = features.num_rows, form
        self.register_buffer("rows", torch.from_numpy(features.rows), False)
        self.weight = nn.Parameter(torch.empty(self.num_rows + 1, width))
        self.bias = nn.Parameter(torch.zeros(width))
        nn.init.normal_(self.weight, std=std)
        with torch.no_grad():
            self.weight[self.num_rows] = 0.0

    def prepare(self, observation: torch.Tensor, learning: bool = True) -> torch.Tensor:
        """[..., numbers] the rows to sum; in the dense form [..., num_rows] their one-hot sum.

        Without `learning` always the rows.
        """
        rows = self.rows[observation.long()]
        return rows if self.form == "bag" or not learning else one_hot_sum(rows, self.num_rows)

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width]."""
        if prepared.is_floating_point():
            return nn.functional.linear(prepared, self.weight[: self.num_rows].T, self.bias)
        rows = prepared.reshape(-1, prepared.shape[-1])
        table: torch.Tensor = self.weight
        padding: int | None = self.num_rows
        if self.form == "dense" or torch.compiler.is_exporting():
            # A copy of the few rows with zeros in the last row takes a sixth of the time of
            # `padding_idx`.
            table, padding = nn.functional.pad(table[: self.num_rows], (0, 0, 0, 1)), None
        if torch.compiler.is_exporting():  # where `embedding_bag` becomes a loop
            summed = table[rows].sum(dim=1)
        else:
            summed = nn.functional.embedding_bag(rows, table, mode="sum", padding_idx=padding)
        return (summed + self.bias).reshape(*prepared.shape[:-1], -1)


class Flat(nn.Module):
    """A linear layer for any other observation, flattened and scaled to about [0, 1]."""

    scale: torch.Tensor

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        self.dims = len(features.shape)
        high = torch.as_tensor(features.high, dtype=torch.float32).reshape(-1)
        self.register_buffer("scale", 1.0 / high.clamp(min=1.0), False)
        self.linear = nn.Linear(len(high), width)

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., numbers of the observation] float32."""
        flat = observation.flatten(-self.dims) if self.dims > 1 else observation
        return flat.float() * self.scale

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width]."""
        return self.linear(prepared)


class Convolutions(nn.Module):
    """Two 3×3 convolutions over "planes", scaled to about [0, 1], then a linear layer.

    They have stride 2 from 5 × 5 on. Compared with stride 1 that gives 3 times as many frames per
    second on 5 × 5, 4 times on 7 × 7 and 7 times on 13 × 13 (12 planes, one core, forward and
    backward). Planes are the innermost dimension ("channels last").
    """

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        self.scale = 1.0 / max(float(np.max(features.high)), 1.0)
        planes, height, columns = features.shape
        stride = 2 if min(height, columns) >= 5 else 1
        for _ in range(2):
            height, columns = (-(-size // stride) for size in (height, columns))
        self.layers = nn.Sequential(
            nn.Conv2d(planes, 32, 3, stride, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, stride, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(32 * height * columns, width),
        )

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """The observation as float32, scaled to at most 1."""
        return observation.float() * self.scale if self.scale < 1.0 else observation.float()

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] from [..., planes, height, width]."""
        planes = prepared.reshape(-1, *prepared.shape[-3:])
        # `contiguous(memory_format=...)` is not available under `vmap`.
        planes = planes.movedim(-3, -1).contiguous().movedim(-1, -3)
        hidden: torch.Tensor = self.layers(planes)
        return hidden.reshape(*prepared.shape[:-3], hidden.shape[-1])


class Own(nn.Module):
    """A user-defined network from `NETWORKS`, from observations to `width` numbers.

    Passes without gradients are in evaluation mode: dropout and the statistics of batches belong
    to the updates, as actions are drawn and evaluated by one distribution.

    For "index" its input is int64 numbers, otherwise float32 scaled to about [-1, 1]:
    [batch, *shape].

    Raises:
        ValueError: not a module, it fails, or its output is not [batch, width].
    """

    def __init__(self, features: Features, width: int) -> None:
        super().__init__()
        self.shape, self.form, self.name = features.shape, torch.float32, features.network
        high = torch.as_tensor(features.high, dtype=torch.float32)
        self.register_buffer("scale", 1.0 / high.clamp(min=1.0), False)
        if features.kind == "index":
            self.form, self.scale = torch.int64, torch.ones((), dtype=torch.int64)
        factory = NETWORKS.get(features.network)
        example = torch.zeros(2, *self.shape, dtype=self.form)
        try:
            made = factory(features, width)
            output_shape: tuple[int, ...] = ()
            if isinstance(made, nn.Module):
                with torch.no_grad(), evaluation_mode(made):  # also initialises lazy layers
                    output_shape = tuple(made(example).shape)
        except Exception as error:  # of the user's code
            remedy = "; convolutions need --observation planes, dense layers one_hot"
            raise ValueError(
                f"network {features.network!r} failed for {self.form} of shape "
                f"{tuple(example.shape)} (observation {features.kind}): {error}"
                f"{remedy if len(self.shape) < 3 else ''}"
            ) from error
        check(isinstance(made, nn.Module), f"network {features.network!r} is not a torch.nn.Module")
        check(
            output_shape == (2, width),
            f"network {features.network!r} returned {output_shape} for 2 observations; return "
            f"[batch, width], here {(2, width)}",
        )
        self.network = made

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """[..., *shape]."""
        return observation.to(self.form) * self.scale

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] from [..., *shape]; ValueError if the network raises an exception."""
        batch, before = prepared.reshape(-1, *self.shape), prepared.dim() - len(self.shape)
        mode = nullcontext() if torch.is_grad_enabled() else evaluation_mode(self.network)
        try:
            with mode:
                hidden: torch.Tensor = self.network(batch)
            return hidden.reshape(*prepared.shape[:before], -1)
        except Exception as error:  # of the user's code
            raise ValueError(f"network {self.name!r} raised {raised(error)}; mend it") from error


FIRST_LAYERS: dict[str, type[Flat | Convolutions | Planning]] = {
    "planes": Convolutions,
    "grid": Planning,
    "flat": Flat,
}
"""The first layers by the kind of features, but for "index"."""


class Trunk(nn.Module):
    """Two hidden layers on any features, or a user-defined network; outputs are float32."""

    first: IndexLayer | Flat | Convolutions | Planning | Own

    def __init__(self, features: Features, hidden: Hidden) -> None:
        super().__init__()
        width = hidden.width
        self.autocast_bfloat16, self.dense = hidden.bfloat16, False
        if features.network:
            self.first, self.rest = Own(features, width), nn.Sequential()
            return
        if features.kind == "index":
            auto = hidden.form == "auto"
            form = first_layer_form(features.num_rows) if auto else hidden.form
            self.first = IndexLayer(features, width, form, hidden.std)
        else:
            self.first = FIRST_LAYERS[features.kind](features, width)
        second = head(width, width, 2.0**0.5)
        between = nn.Tanh if hidden.activation == "tanh" else nn.ReLU
        self.rest = nn.Sequential(between(), second, between())
        self.dense = isinstance(self.first, IndexLayer) and self.first.form == "dense"

    def prepare(self, observation: torch.Tensor) -> torch.Tensor:
        """The input of the first layer; without parameters, so computed once per rollout."""
        prepared = self.first.prepare(observation)
        # Zeros and ones are exact in bfloat16, which saves a cast in every pass.
        return prepared.bfloat16() if self.dense and self.autocast_bfloat16 else prepared

    def prepare_inference(self, observation: torch.Tensor) -> torch.Tensor:
        """As `prepare`, for passes without gradients: for the faster form of the first layer.

        The result is the same up to the order of summation.
        """
        if self.autocast_bfloat16 or not isinstance(self.first, IndexLayer):
            return self.prepare(observation)
        return self.first.prepare(observation, learning=False)

    def forward(self, prepared: torch.Tensor) -> torch.Tensor:
        """[..., width] float32, from `prepare` or `prepare_inference`."""
        with torch.autocast(prepared.device.type, torch.bfloat16, enabled=self.autocast_bfloat16):
            hidden: torch.Tensor = self.rest(self.first(prepared))
        return hidden.float()


class Network(Protocol):
    """What policies use of a module."""

    def modules(self) -> Iterator[nn.Module]:
        """It and all its parts."""

    def parameters(self) -> Iterator[nn.Parameter]:
        """All weights."""


@contextmanager
def evaluation_mode(network: Network, *others: str) -> Iterator[None]:
    """Evaluation mode of a network and all its parts, without `others`, attributes that are True;
    then each part has its own mode again."""
    # In their dictionaries: assignment to an attribute of a module takes ten times as long.
    parts = [vars(each) for each in network.modules()]
    switched = [(part, mode) for part in parts for mode in ("training", *others) if part.get(mode)]
    for part, mode in switched:
        part[mode] = False
    try:
        yield
    finally:
        for part, mode in switched:
            part[mode] = True


@contextmanager
def float32_inference(network: Network) -> Iterator[None]:
    """Forward passes in float32 and evaluation mode, also of a network that is trained in bfloat16.

    All policies use it, so that a policy in training acts as it does when loaded from its run.
    """
    with own_defaults(), torch.no_grad(), evaluation_mode(network, "autocast_bfloat16"):
        yield


def head(width: int, outputs: int, gain: float) -> nn.Linear:
    """A linear output layer with orthogonal weights of the given gain and zero bias."""
    layer = nn.Linear(width, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
