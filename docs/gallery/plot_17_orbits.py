"""
Periodic orbits and their families
==================================

A nonlinear mode of a dimer, and the family that it belongs to.
"""

import lmpchain
from lmpchain import orbits

level = {"gravity": 0.0, "top_load": 20.0}
dimer = lmpchain.Chain(grains=9, diameter=1e-2, material=["steel", "ptfe"] * 4 + ["steel"], **level)
orbit = orbits.normal_mode(dimer, 5, energy=1e-5)
print(f"period {1e6 * orbit.period:.2f} us, stable: {orbit.stable}")
picture = orbit.plot()

# %%
family = orbits.follow(orbit, "energy", 1e-3)
picture_of_family = family.plot()
