"""The type of the arrays that hold physical quantities."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
