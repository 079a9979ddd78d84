"""
Live: a shock
=============

A piston moves into a loaded chain. Without damping a train of solitary waves spreads out, a
dispersive shock; viscous contacts turn it into a steady one.
"""

import lmpchain

chain = lmpchain.Chain(
    grains=120,
    material="steel",
    diameter=9.5e-3,
    gravity=0.0,
    top_load=10.0,
    top="wall",
    bottom="wall",
    damping=lmpchain.Damping(viscoelastic=2e-6),
)
piston = lmpchain.Drive(shape="piston", velocity=0.07, rise=1e-4, grain=0)
scene = lmpchain.Scene(chain=chain, excitation=piston, duration=1.6e-3, samples=241)
picture = lmpchain.simulate(scene, "native", 1e-5).plot()

# %%
# The same as a live figure, by ``lmpchain.explore(live, "shock.html")``:
live = {
    "scene": scene,
    "over": {
        "chain.damping.viscoelastic": [0.0, 1e-6, 2e-6, 5e-6, 1e-5],
        "excitation.velocity": [0.01, 0.03, 0.07, 0.2, 0.5],
    },
    "tolerance": 1e-5,
}
