"""The properties of an observation that a network is built from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.observations.custom import is_builtin, without_id
from pursuit.observations.observations import Encoder, has_bits

SEEN_AS: dict[str, Literal["planes", "grid", "flat"]] = {
    "auto": "planes",
    "convolutions": "planes",
    "planning": "grid",
    "mlp": "flat",
    "flat": "flat",
}
"""The kind of features that built-in networks make of planes, by network name."""


@dataclass(frozen=True, eq=False)
class Features:
    """The form of one agent's observation.

    Attributes:
        kind: "index" (numbers select rows of the first layer), "planes" (for convolutions), "grid"
            (planes for planning) or "flat" (anything else).
        shape: of one observation.
        high: [*shape], the largest values.
        rows: [numbers] int64, for "index": the row that each number of an observation selects;
            `num_rows` selects none. Empty for other kinds.
        num_rows: rows of the first layer for "index".
        network: name of a user-defined network; "" for built-in ones.
    """

    kind: Literal["index", "planes", "grid", "flat"]
    shape: tuple[int, ...]
    high: NDArray[Any] = field(repr=False)
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False)
    num_rows: int = 0
    network: str = ""


def dtype_of(encoding: str) -> str | None:
    """The dtype of the observations of learners and policies; None for that of the encoding.

    That of planes and windows is uint8, in a quarter of the memory; networks see the same numbers.
    """
    return "uint8" if has_bits(encoding) and without_id(encoding) != "one_hot" else None


def observed(view: Any, encoding: str) -> NDArray[Any]:
    """[games, *shape]: what the agent of a `GameView` observes, in `dtype_of` the encoding."""
    dtype = dtype_of(encoding)
    return view.observe(encoding, *([] if dtype is None else [dtype]))


def features_of(encoder: Encoder, num_agents: int) -> Features:
    """The features of an encoding.

    Goals are interchangeable, so for "index" all goals share the same rows.

    Args:
        encoder: of any encoding.
        num_agents: number of agents, which precede the goals.
    """
    shape, high = tuple(encoder.shape), np.asarray(encoder.space.high)
    if not is_builtin(encoder.encoding):  # user-defined: its bounds may be infinite
        largest = np.maximum(np.abs(encoder.space.low.astype(np.float64)), np.abs(high))
        high = np.where(np.isfinite(largest), largest, 1.0)
    if not is_builtin(encoder.encoding) or without_id(encoder.encoding) != "index":
        return Features("planes" if len(shape) == 3 else "flat", shape, high)
    cells, entities = encoder.num_cells, encoder.num_entities
    blocks = [min(entity, num_agents) for entity in range(entities)]
    blocks.append(num_agents + (entities > num_agents))  # the goal collected last
    num_rows = (blocks[-1] + 1) * cells
    rows = (np.array(blocks)[:, None] * cells + np.arange(cells)).ravel()
    members = int(high[-1]) - len(rows)  # of "index+id": rows of their own, before the padding
    ids = num_rows + np.arange(members)
    num_rows += members
    return Features("index", shape, high, np.concatenate([rows, [num_rows], ids]), num_rows)


def features_between(low: NDArray[Any], high: NDArray[Any], network: str) -> Features:
    """The features, for a network by name, of numbers between these ends [*shape]."""
    largest = np.maximum(np.maximum(np.abs(low), np.abs(high)).astype(np.float64), 1e-6)
    kind: Literal["planes", "flat"] = "planes" if low.ndim == 3 else "flat"
    return features_for(Features(kind, low.shape, largest), network)


def features_for(features: Features, network: str) -> Features:
    """The features for a network, by its name in the settings."""
    if network not in SEEN_AS:
        return replace(features, network=network)
    return replace(features, kind=SEEN_AS[network]) if features.kind == "planes" else features
