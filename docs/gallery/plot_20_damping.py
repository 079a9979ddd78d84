"""
Dissipation
===========

How a pulse decays in a column with viscous contacts, and how two spheres rebound.
"""

import numpy as np

import lmpchain
from lmpchain.theory import restitution
from lmpchain.util.plotting import COLOURS, figure

chain = lmpchain.Chain(grains=100, diameter=1e-3, gravity=0.0, top_load=0.1)
strike = lmpchain.Impulse(velocity=1e-2)
scene = lmpchain.Scene(chain=chain, excitation=strike, duration=1.3e-4, samples=401)
picture = figure(6.5, 4)
axes = picture.subplots()
for viscosity, colour in zip([0.0, 1e-8, 1e-7], COLOURS.values(), strict=False):
    damped = chain.replace(damping={"viscoelastic": viscosity})
    t = lmpchain.simulate(scene.replace(chain=damped), "native", 1e-6)
    peak = t.velocity.max(0)
    label = f"A = {1e9 * viscosity:g} ns"
    # the front has passed these
    axes.plot(t.grains[:80], 1e3 * peak[:80], color=colour, label=label)
axes.set(xlabel="grain number, from the top", ylabel="peak velocity (mm/s)", ylim=(0, None))
axes.legend(frameon=False)

# %%
# What leaving damping out would change, at most about, of the last of them:
print(t.provenance["damping"])

# %%
# The restitution of two steel balls of 10 mm falls with their speed, by :math:`A v^{1/5}`:
speed = np.geomspace(1e-3, 10, 40)
picture_of_rebound = figure(6.5, 4)
plane = picture_of_rebound.subplots()
for viscosity, colour in zip([1e-7, 1e-6, 3e-6], COLOURS.values(), strict=False):
    rebound = restitution.coefficient(speed, viscosity, "steel", 1e-2)
    plane.semilogx(speed, rebound, color=colour, label=f"A = {1e6 * viscosity:g} µs")
plane.set(xlabel="relative velocity before the collision (m/s)", ylabel="restitution", ylim=(0, 1))
plane.legend(frameon=False)
