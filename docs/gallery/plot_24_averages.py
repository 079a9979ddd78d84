"""
Averages of a chaotic chain, against the microcanonical ensemble
================================================================

Thirty-eight beads between walls, struck at the top: where the beads are nobody can say after some
milliseconds, how the energy is shared out on average everybody.
"""

import numpy as np
from scipy.stats import beta

import lmpchain
from lmpchain.util.plotting import figure, legend, letter_panels

GRAINS = 38
chain = lmpchain.Chain(
    grains=GRAINS, material="steel", diameter=6e-3, gravity=0, top="wall", bottom="wall"
)
scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1.0), duration=0.2)
names = ["kinetic_energy", "equipartition", "force:10"]
average = lmpchain.averages(scene, names, time=0.2, tolerance=1e-3)
print(average.table())

# %%
# Momenta and displacements make the volume of phase space a product of powers of the energy, so
# that the share of the kinetic energy follows Beta's distribution.
share = beta(GRAINS / 2, GRAINS / (chain.exponent + 1))
for name, exact, value, interval in (
    ("mean", share.mean(), average.mean, average.interval),
    ("variance", share.var(), average.variance, average.variance_interval),
):
    unit = scene.energy if name == "mean" else scene.energy**2
    low, high = np.array(interval["kinetic_energy"]) / unit
    found = value["kinetic_energy"] / unit
    print(f"{name} of K/E: {found:.6f} ({low:.6f} to {high:.6f}), exactly {exact:.6f}")

# %%
# The average up to each time, the means of its batches, and the interval.
picture = figure(7.0, 6.0)
upper, lower = picture.subplots(2, 1)
average.plot(upper, of="kinetic_energy")
upper.axhline(share.mean() * scene.energy, color="k", ls=":", lw=1, label="microcanonical")
legend(upper, ncols=2)
average.plot(lower, of="equipartition")
lower.axhline(1.0, color="k", ls=":", lw=1, label="equipartition")
legend(lower, ncols=2)
letter_panels([upper, lower])
