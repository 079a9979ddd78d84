"""
Live: a packet on an impurity
=============================

A packet of linear waves meets one bead of another size: a heavy one throws most of it back, one
like its neighbours lets it pass.
"""

import lmpchain

chain = lmpchain.Chain(
    grains=160,
    diameter=1e-3,
    gravity=0.0,
    top_load=1.0,
    top="wall",
    bottom="wall",
    impurity=[lmpchain.Impurity(grain=105, diameter=2e-3)],
)
packet = lmpchain.Packet(frequency=3e5, width=8, grain=52, amplitude=1e-12)
scene = lmpchain.Scene(chain=chain, excitation=packet, duration=9e-5, samples=241)
picture = lmpchain.simulate(scene, "native", 1e-6).plot()

# %%
# The same as a live figure, by ``lmpchain.explore(live, "packet.html")``:
live = {
    "scene": scene,
    "over": {"chain.impurity.0.diameter": [0.5e-3, 0.7e-3, 1e-3, 1.3e-3, 1.6e-3, 2e-3, 3e-3]},
}
