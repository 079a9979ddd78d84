"""The type of arrays that hold physical quantities, and the precision of their numbers."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
EPSILON = float(np.finfo(float).eps)  # spacing of the doubles at 1
