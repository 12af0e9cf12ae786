"""Features: what a network needs to know of the observations that it is given."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pursuit.observations.observations import Encoder
from pursuit.observations.own import is_ours

SEEN_AS: dict[str, Literal["planes", "grid", "flat"]] = {
    "auto": "planes",
    "convolutions": "planes",
    "planning": "grid",
    "mlp": "flat",
    "flat": "flat",
}
"""What planes are to our networks, by their names in the settings."""


@dataclass(frozen=True, eq=False)
class Features:
    """One agent's observation, as numbers.

    Attributes:
        kind: "index" (each number names a row of the first layer), "planes" (for convolutions),
            "grid" (planes to plan in) or "flat" (anything else).
        shape: of one observation.
        high: [*shape], the largest values.
        rows: [numbers] int64, of "index": the row that each number of an observation names; the
            last one is `num_rows`, which is no row. Empty for other kinds.
        num_rows: of the first layer on "index".
        network: a user's own that sees them, by its name; "" for ours.
    """

    kind: Literal["index", "planes", "grid", "flat"]
    shape: tuple[int, ...]
    high: NDArray[Any]
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    num_rows: int = 0
    network: str = ""


def features_of(encoder: Encoder, num_agents: int) -> Features:
    """The features of an encoding.

    Which goal is which means nothing, so on "index" all goals name the same rows: no network can
    tell one order of the goals from another.

    Args:
        encoder: of any encoding.
        num_agents: entities before the goals.
    """
    shape, high = tuple(encoder.shape), np.asarray(encoder.space.high)
    if not is_ours(encoder.encoding):  # a user's own, whose bounds may be anything
        largest = np.maximum(np.abs(encoder.space.low.astype(np.float64)), np.abs(high))
        bounds = np.where(np.isfinite(largest), largest, 1.0)
        return Features("planes" if len(shape) == 3 else "flat", shape, bounds)
    if encoder.encoding != "index":
        return Features("planes" if len(shape) == 3 else "flat", shape, high)
    cells, entities = encoder.num_cells, encoder.num_entities
    blocks = [min(entity, num_agents) for entity in range(entities)]
    blocks.append(num_agents + (entities > num_agents))  # of the goal that was just collected
    num_rows = (blocks[-1] + 1) * cells
    rows = (np.array(blocks)[:, None] * cells + np.arange(cells)).ravel()
    return Features("index", shape, high, np.append(rows, num_rows), num_rows)


def features_for(features: Features, network: str) -> Features:
    """The features as a network is given them, by its name in the settings."""
    if network not in SEEN_AS:
        return replace(features, network=network)
    return replace(features, kind=SEEN_AS[network]) if features.kind == "planes" else features
