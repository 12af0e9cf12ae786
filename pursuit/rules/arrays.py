"""Names of the types of arrays, by their dtypes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""An array of any dtype."""
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Reals = NDArray[np.float64]
Words = NDArray[np.uint64]
Flags = NDArray[np.bool_]
