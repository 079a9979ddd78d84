"""
Speed against accuracy
======================

Every engine and integrator at ever shorter steps, in two seconds; give it a minute for a smooth chart.
"""

import lmpchain

chain = lmpchain.Chain(grains=30, diameter=1e-3)
scene = lmpchain.Scene(chain=chain, excitation=lmpchain.Impulse(velocity=1e-3), duration=3e-5, samples=2)
found = lmpchain.work_precision(scene, 2.0)
picture = found.plot()
