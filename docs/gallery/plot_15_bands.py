"""
Bands, gaps and modes in a gap
==============================

The dispersion diagram of a chain that repeats a cell.
"""

import numpy as np

import lmpchain
from lmpchain.theory import bands

level = {"gravity": 0.0, "top_load": 20.0}
dimer = lmpchain.Chain(grains=2, material=["steel", "ptfe"], diameter=1e-2, **level)
found = bands.branches(dimer, np.linspace(-np.pi, np.pi, 201))
print("gap:", (found.gaps / (2 * np.pi)).round(), "Hz")
picture = found.plot()

# %%
# A light grain in a uniform chain has a mode above the band, over a grain or two.
uniform = lmpchain.Chain(grains=41, diameter=1e-2, **level)
light = uniform.replace(impurity=[{"grain": 20, "diameter": 7e-3}])
picture_of_mode = bands.gap_modes(light, uniform.replace(grains=2)).plot()

# %%
# With damping, waves of all frequencies are attenuated; in the gap they are without it, too.
damped = dimer.replace(damping={"viscoelastic": 1e-7})
picture_of_waves = bands.waves(damped, np.linspace(1e2, 6e4, 400)).plot()
