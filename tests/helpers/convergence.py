"""Orders of convergence and powers of laws, as slopes of logarithms."""

from typing import Any

import numpy as np


def slope(x: Any, y: Any) -> float:
    """Return the slope of ln y over ln x."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
