"""
From a measured trace to a number of the scene
==============================================

The velocity of grain 5 was measured, with noise of 2 µm/s; how fast was the strike?
"""

import numpy as np

import lmpchain
from lmpchain.measure import fit

chain = lmpchain.Chain(grains=12, diameter=1e-3)
seen = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=8e-4), duration=4e-5, samples=81
)
guess = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=4e-5)

t = lmpchain.simulate(seen, "native", tolerance=1e-9)
noise = np.random.default_rng(1).normal(0.0, 2e-6, t.time.size)
trace = fit.Trace(t.time, 5, t.velocity[:, 4] + noise)
found = fit.fit_parameter(trace, guess, "velocity", lmpchain.simulate)
print(f"{found.value:.4e} +- {found.error:.0e} m/s")
picture = found.plot()
