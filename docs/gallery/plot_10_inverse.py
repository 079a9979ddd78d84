"""
From a measured trace to a number of the scene
==============================================

The velocity of grain 5 was measured; how fast was the strike?
"""

import lmpchain
from lmpchain.measure import fit

chain = lmpchain.Chain(grains=12, diameter=1e-3)
seen = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=8e-4), duration=2e-5, samples=41
)
guess = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=2e-5)

trace = fit.Trace.of(lmpchain.simulate(seen, "native", tolerance=1e-9), grains=[5])
found = fit.fit_parameter(trace, guess, "velocity", lmpchain.simulate)
print(f"{found.value:.4e} +- {found.error:.0e} m/s")
picture = found.plot()
