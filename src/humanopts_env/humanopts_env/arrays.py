"""Array types, named by content; axes are documented with each array."""

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.intp]  # indices and counts
Rows = NDArray[np.float64]  # (N, F) features of N states, as ``Feature`` describes them
