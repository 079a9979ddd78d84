"""
Speed against accuracy
======================

Every engine and integrator at ever shorter steps, in eight seconds; give it a minute for a smooth
chart.
"""

import lmpchain

chain = lmpchain.Chain(grains=12, diameter=1e-3)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=1e-5, samples=2
)
found = lmpchain.work_precision(scene, 8.0)
picture = found.plot()
