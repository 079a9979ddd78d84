"""
What an impurity lets through
=============================

One grain of twice the diameter in a uniform chain under load.
"""

import numpy as np

import lmpchain
from lmpchain.theory import scattering

level = {"gravity": 0.0, "top_load": 1.0}
odd = lmpchain.Chain(grains=9, diameter=1e-3, **level, impurity=[{"grain": 5, "diameter": 2e-3}])
edge = 2 / odd.time_scale  # rad/s, of the leads
picture = scattering.transmission(odd, edge * np.linspace(0.01, 0.99, 99)).plot()
