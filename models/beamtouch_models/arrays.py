"""The array types of the package. Docstrings state shapes, as (rows, columns), and units."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
"""Deflections and answers as a model's graph takes and gives them."""
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
