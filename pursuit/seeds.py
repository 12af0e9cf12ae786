"""Seeds of environments: what they may be, and one where none is given."""

from __future__ import annotations

from typing import Any

import numpy as np

from pursuit.declared import whole


def checked_seed(seed: Any) -> int:
    """`seed` as an int, if it is a whole number from 0 to 2**64 - 1; ValueError otherwise."""
    return whole("seed", seed, 0, 2**64 - 1)


def some_seed() -> int:
    """A seed from the operating system."""
    return int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
