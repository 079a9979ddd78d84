"""
A striker on a precompressed chain
==================================

The load acts on the second bead; the first only touches and strikes, as a bead of its own would.

Daraio, Nesterenko, Herbold and Jin (Phys. Rev. E 73, 026610, 2006) pressed chains of PTFE and of
stainless steel by a magnet on the top bead and struck them by another body: at the same dynamic
force, solitary waves were up to twice as fast as without the load.
"""

import numpy as np
from matplotlib.ticker import LogLocator

import lmpchain
from lmpchain.measure import contact
from lmpchain.util.plotting import COLOURS, figure

BEADS = 60
DIAMETER = 4.76e-3


def strike(material, load, speed):
    """Return dynamic force in the chain, N, speed of the wave, m/s, and force on the wall, N."""
    chain = lmpchain.Chain(
        grains=BEADS,
        material=material,
        diameter=DIAMETER,
        gravity=0.0,
        top_load=load,
        load_grain=2,
        bottom="wall",
        bottom_material="steel",
    )
    slowest = {"ptfe": 80.0, "steel": 250.0}[material]
    scene = lmpchain.Scene(
        chain=chain,
        excitation=lmpchain.Impulse(velocity=speed, grain=1),
        duration=BEADS * DIAMETER / slowest,
        samples=4001,
    )
    t = lmpchain.simulate(scene, "native", 1e-6)
    force = contact.contacts(t, [20, 40, BEADS]).force
    # what the wall sends back is left out
    hit = force[:, 2].argmax()
    passes = force[:hit, :2].argmax(0)
    travelled = 20 * DIAMETER / np.ptp(t.time[passes])
    return force[passes[1], 1] - load, travelled, force[hit, 2]


# %%
# In both materials the speed doubles where waves are weak. Strong waves forget the load.
picture = figure(6.5, 4)
axes = picture.subplots()
names = {"ptfe": "PTFE", "steel": "steel"}
for (material, speeds), colour in zip(
    {"ptfe": [0.1, 0.3, 1.0, 2.0], "steel": [0.02, 0.1, 0.3, 1.0]}.items(),
    COLOURS.values(),
    strict=False,
):
    for load, style in ((0.0, "--"), (2.38, "-")):
        rows = np.array([strike(material, load, speed) for speed in speeds])
        label = f"{names[material]}, {load:g} N"
        axes.loglog(rows[:, 0], rows[:, 1], style, marker=".", color=colour, label=label)
        for (dynamic, travelled, wall), speed in zip(rows, speeds, strict=True):
            print(
                f"{material:5} {load:4g} N, struck at {speed:4g} m/s: {dynamic:6.3f} N in the chain"
                f" at {travelled:5.1f} m/s, {wall:6.2f} N on the wall"
            )
axes.set(xlabel="dynamic force in contact 40 (N)", ylabel="speed of the wave (m/s)")
# 500 rather than 5 × 10²
axes.yaxis.set(
    major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}", minor_formatter=""
)
axes.legend(frameon=False)
