"""
Live: a breather
================

A chain of light and heavy beads has a band gap. Light beads in the middle are displaced to and fro
in turn, as in the mode at the edge of the gap. Under a large load that is a packet of linear waves,
which spreads; under a smaller one the same motion is nonlinear, its frequency falls into the gap,
and it stays where it is.
"""

import numpy as np

import lmpchain

place = np.arange(1, 82)
light = place % 2 == 0
sign = np.where(place // 2 % 2 == 0, 1.0, -1.0)
displacement = np.where(light, 8e-7 * sign / np.cosh((place - 41) / 3), 0.0)
chain = lmpchain.Chain(
    grains=81,
    material=["steel", *["aluminium", "steel"] * 40],
    diameter=19.05e-3,
    gravity=0.0,
    top_load=5.0,
)
scene = lmpchain.Scene(
    chain=chain,
    excitation=lmpchain.Profile(displacement=displacement),
    duration=4e-3,
    samples=241,
)


def share(load: float) -> float:
    """Return the share of the kinetic energy that the 15 beads in the middle have at the end."""
    run = lmpchain.simulate(scene.replace(chain=chain.replace(top_load=load)), "native", 1e-4)
    energy = (chain.masses * run.velocity[-40:] ** 2).mean(0)
    return energy[33:48].sum() / energy.sum()


print(f"at 5 N {share(5.0):.0%} of the energy stays, at 100 N {share(100.0):.0%}")
picture = lmpchain.simulate(scene, "native", 1e-4).plot()

# %%
# The same as a live figure, by ``lmpchain.explore(live, "breather.html")``:
live = {
    "scene": scene,
    "over": {"chain.top_load": [5.0, 10.0, 20.0, 50.0, 100.0, 1000.0]},
    "tolerance": 1e-4,
}
