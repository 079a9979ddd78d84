"""
Is the pulse a solitary wave?
=============================

A strike on a chain without load makes Nesterenko's pulse; its speed and shape against the exact
solitary wave.
"""

import lmpchain
from lmpchain.measure import fit

chain = lmpchain.Chain(grains=40, diameter=1e-3, gravity=0.0)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=0.1), duration=1e-4, samples=601
)
found = fit.fit_soliton(lmpchain.simulate(scene, "native"))
print(
    f"{found.amplitude:.5f} m/s high, {found.speed:.0f} grains/s fast, "
    f"{found.width:.3f} grains wide"
)
picture = found.plot()
