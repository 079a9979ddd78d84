"""
Energy and work
===============

Kinetic energy, contacts, gravity, load and drive; the drift is the change that no work explains.
"""

import numpy as np

import lmpchain
from lmpchain.measure import energy

chain = lmpchain.Chain(grains=40, diameter=1e-3)
scene = lmpchain.Scene(
    chain=chain, excitation=lmpchain.Impulse(velocity=1e-2), duration=1e-4, samples=401
)
ledger = energy.ledger(lmpchain.simulate(scene, tolerance=1e-9))
picture = ledger.plot()

# %%
print(f"drift {np.abs(ledger.drift).max() / ledger.total[0]:.0e} of the energy")
shares = energy.shares(lmpchain.simulate(scene))
print(f"grains 1 to 10 hold {shares.part(1, 10)[-1] / scene.energy:.0%} of it at the end")
