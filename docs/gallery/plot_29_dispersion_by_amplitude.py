"""
Dispersion by frequency and amplitude of the drive
==================================================

A long loaded chain is driven harmonically. The phase per grain is measured far more accurately than
a spectrum resolves it, so that the shift by amplitude shows.
"""

import numpy as np

import lmpchain
from lmpchain.measure import harmonic

chain = lmpchain.Chain(grains=700, material="steel", diameter=1e-2, gravity=0.0, top_load=20.0)
frequency = 0.6 * chain.band_edge / (2 * np.pi)
drive = lmpchain.Drive(amplitude=1e-9, frequency=frequency)
scene = lmpchain.Scene(chain=chain, excitation=drive, duration=70 / frequency)
found = lmpchain.dispersion(scene, frequency * np.array([0.9, 1.0, 1.1, 1.2]), [1e-9, 1e-7, 2e-7])
picture_of_dispersion = found.plot()

# %%
# The wave at one frequency and amplitude, grain by grain: phase lag less that of linear waves.
picture_of_wave = found.waves[1][2].plot()

# %%
# Apparent mass and loss factor of a short damped column on a shaker.
lossy = lmpchain.Damping(viscoelastic=4e-6)
column = lmpchain.Chain(
    grains=8,
    material="steel",
    diameter=1e-2,
    gravity=0.0,
    top_load=20.0,
    top="wall",
    bottom="wall",
    damping=lossy,
)
shaker = lmpchain.Drive(grain=0, amplitude=1e-7, frequency=0.1 * column.band_edge / np.pi)
shaken = lmpchain.Scene(
    chain=column, excitation=shaker, duration=150 / shaker.frequency, samples=3601
)
point = harmonic.drive_point(lmpchain.simulate(shaken, "native"))
print(f"apparent mass {point.apparent_mass:.5g} ± {point.apparent_mass_error:.1g} kg")
print(f"loss factor {point.loss_factor:.5f} ± {point.loss_factor_error:.1g}")
